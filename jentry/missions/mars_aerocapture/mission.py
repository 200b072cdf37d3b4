"""The mission Mars aerocapture: its law and its dispersions."""

from ...motion.index import TimeIndex
from ...planning.flight_constraints import Constraint
from ...planning.flight_problem import AtEnd, FlightProblem, FreeControl
from ...units import degree, km
from ..mission import Mission
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import APOAPSIS, free_plane, guided


def least_increment() -> FlightProblem:
    """The highest periapsis at the apoapsis of the target, with a free bank to one side.

    The one burn that is left is then the smallest. It is the floor for laws in the case
    `free-plane`. The velocity increment itself has a corner where the apoapsis is met,
    which a search by gradients does not pass. Nodes and start are our own.
    """
    return FlightProblem(
        objective=AtEnd("periapsis_altitude"),
        bank=FreeControl(60.0 * degree, 0.0, 180.0 * degree),
        constraints={
            "apoapsis": Constraint(
                AtEnd("apoapsis_altitude"), equals=APOAPSIS, scale=1000.0 * km
            )
        },
        nodes=12,
        index=TimeIndex(),
    )


MISSION = Mission(
    name="mars-aerocapture",
    title="Orbiter captured by the air of Mars, numerical predictor-corrector",
    source='Gelly and Vernis, "Neural Networks as a Guidance Solution for Soft-Landing and '
    'Aerocapture", AIAA 2009-5664; law of Lu and others, JGCD 38(4), 2015',
    laws={"predictor-corrector": guided},
    cases={"free-plane": free_plane},
    problems={"least-increment": least_increment},
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
    },
    gains=("guidance.exit_bank", "guidance.first_bank"),
)
