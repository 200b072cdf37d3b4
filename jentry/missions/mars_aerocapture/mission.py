"""The mission Mars aerocapture: its law and its dispersions."""

from ...planning.flight_problem import FlightProblem
from ..aerocapture import highest_periapsis
from ..mission import Mission
from .air_with_waves import everything_in_random_air, random_air
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import APOAPSIS, free_plane, guided


def least_increment() -> FlightProblem:
    """The highest periapsis at the apoapsis of the target, for the case `free-plane`."""
    return highest_periapsis(APOAPSIS)


MISSION = Mission(
    name="mars-aerocapture",
    title="Orbiter captured by the air of Mars, numerical predictor-corrector",
    source='Gelly and Vernis, "Neural Networks as a Guidance Solution for Soft-Landing and '
    'Aerocapture", AIAA 2009-5664; law of Lu and others, JGCD 38(4), 2015',
    laws={"predictor-corrector": guided},
    cases={"free-plane": free_plane},
    worlds={"random-air": random_air},
    problems={"least-increment": least_increment},
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
        "random-air": everything_in_random_air,
    },
    gains=("guidance.exit_bank", "guidance.first_bank"),
)
