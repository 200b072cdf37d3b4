"""The mission Apollo 10: its laws, a case, a world and its dispersions."""

from ..mission import Mission
from ..npcg_toolbox import through_us_1976
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import guided, skip, unlimited


MISSION = Mission(
    name="apollo-10",
    title="Apollo 10 capsule from the Moon, numerical predictor-corrector",
    source='Szelc, "Entry Postflight Analysis", Apollo 10 Mission Report, Supplement 10, '
    "as in the NPCG Toolbox of Lee, Lee and Wie",
    laws={"predictor-corrector": guided, "unlimited": unlimited},
    cases={"skip": skip},
    worlds={"us-1976": through_us_1976},
    former_variants={
        "skip": "predictor-corrector case skip",
        "us-1976": "predictor-corrector world us-1976",
    },
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
    },
    gains=("guidance.shape.final", "guidance.limits.frequency"),
)
