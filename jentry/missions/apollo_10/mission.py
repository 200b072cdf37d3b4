"""The mission Apollo 10: its laws, a case, a world and its dispersions."""

from ...units import degree, foot, hour, km
from ..inertial import Errors, Inertial, satellite_sensors
from ..mission import Mission
from ..npcg_toolbox import through_us_1976
from . import flight_program, neural_law
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import guided, skip, unlimited


NAVIGATION = Inertial(
    Errors(
        position=1.5 * km / 3.0,
        velocity=3.0 / 3.0,
        tilt=0.5 / 60.0 * degree,
        bias=0.003 * foot / 3.0,
        drift=0.03 * degree / hour,
        velocity_random_walk=1e-3,
    ),
    decided=(),
    usual=everything,
    sensors=satellite_sensors,
)
"""Attitude: half a minute of arc, one sigma, for the alignment of the inertial unit
of the command module (Apollo Data Priority Coordination, memorandum 69-PA-T-34A, 25
February 1969). Bias: 0.003 ft/s2, above which the compensation was to be updated
(memorandum 69-PA-T-72A, 6 May 1969); we read it as three sigma. The other numbers
are chosen; scale error, misalignment and random walk of the attitude are those of
`Errors`. The instruments of the capsule were on a stable platform; here they are
fixed to the capsule. The flight ends at an actual altitude, chosen as that of a
barometric switch"""


MISSION = Mission(
    name="apollo-10",
    title="Apollo 10 capsule from the Moon, numerical predictor-corrector",
    source='Szelc, "Entry Postflight Analysis", Apollo 10 Mission Report, Supplement 10, '
    "as in the NPCG Toolbox of Lee, Lee and Wie",
    laws={
        "predictor-corrector": guided,
        "unlimited": unlimited,
        "apollo": flight_program.guided,
        "apollo-steered": flight_program.steered,
        "neural": neural_law.neural,
    },
    cases={"skip": skip},
    worlds={
        "us-1976": through_us_1976,
        "inertial": NAVIGATION.world,
        "aided": NAVIGATION.aided,
    },
    former_variants={
        "skip": "predictor-corrector case skip",
        "us-1976": "predictor-corrector world us-1976",
    },
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
        "knowledge": NAVIGATION.knowledge,
        "everything-and-knowledge": NAVIGATION.usual_and_knowledge,
    },
    gains=("guidance.shape.final", "guidance.limits.frequency"),
    law_trainings={"neural": neural_law.training},
)
