"""The mission Apollo 10: its variants and its dispersions."""

from ..mission import Mission
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import guided, skip, unlimited, us_1976


MISSION = Mission(
    name="apollo-10",
    title="Apollo 10 capsule from the Moon, numerical predictor-corrector",
    source='Szelc, "Entry Postflight Analysis", Apollo 10 Mission Report, Supplement 10, '
    "as in the NPCG Toolbox of Lee, Lee and Wie",
    variants={
        "predictor-corrector": guided,
        "skip": skip,
        "unlimited": unlimited,
        "us-1976": us_1976,
    },
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
    },
    gains=("guidance.shape.final", "guidance.limits.frequency"),
)
