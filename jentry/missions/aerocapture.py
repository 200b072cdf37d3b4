"""What the aerocapture missions share: ends of a flight, and the least increment."""

from ..flight.termination import (
    AltitudeBelow,
    CapturedAbove,
    EscapedAbove,
    Outcome,
    Termination,
)
from ..motion.index import TimeIndex
from ..planning.flight_constraints import Constraint
from ..planning.flight_problem import AtEnd, FlightProblem, FreeControl
from ..units import degree, km


def ends(exit_altitude: float, time_limit: float) -> Termination:
    """Ends of an aerocapture: captured, escaped or crashed.

    **Arguments:**

    - `exit_altitude`: altitude at which the vehicle has left the air, m.
    - `time_limit`: s.
    """
    return Termination(
        {
            "captured": CapturedAbove(altitude=exit_altitude),
            "escaped": EscapedAbove(altitude=exit_altitude),
            "ground": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED),
        },
        time_limit=time_limit,
    )


def highest_periapsis(apoapsis: float, scale: float = 1000.0 * km) -> FlightProblem:
    """The highest periapsis at the apoapsis of the target, with a free bank to one side.

    The one burn that is left is then the smallest. It is the floor for laws that fly to an
    orbit without an inclination. The velocity increment itself has a corner where the
    apoapsis is met, which a search by gradients does not pass. Nodes and start are our own.

    **Arguments:**

    - `apoapsis`: altitude of the apoapsis of the target, m.
    - `scale`: error of this altitude that counts as large, m.
    """
    return FlightProblem(
        objective=AtEnd("periapsis_altitude"),
        bank=FreeControl(60.0 * degree, 0.0, 180.0 * degree),
        constraints={
            "apoapsis": Constraint(
                AtEnd("apoapsis_altitude"), equals=apoapsis, scale=scale
            )
        },
        nodes=12,
        index=TimeIndex(),
    )
