"""The mission Neptune aerocapture: its law and its dispersions."""

from ...planning.flight_problem import FlightProblem
from ...units import km
from ..aerocapture import highest_periapsis
from ..mission import Mission
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import APOAPSIS, guided


def least_increment() -> FlightProblem:
    """The highest periapsis at the apoapsis of the target, with a free bank."""
    return highest_periapsis(APOAPSIS, scale=1e5 * km)


MISSION = Mission(
    name="neptune-aerocapture",
    title="Orbiter captured by the air of Neptune, numerical predictor-corrector",
    source='AMAT, example 11; Girija and others, "Feasibility and Performance Analysis of '
    'Neptune Aerocapture Using Heritage Blunt-Body Aeroshells", JSR 57(6), 2020; law of Lu '
    "and others, JGCD 38(4), 2015",
    laws={"predictor-corrector": guided},
    problems={"least-increment": least_increment},
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
    },
    gains=("guidance.exit_bank", "guidance.first_bank"),
)
