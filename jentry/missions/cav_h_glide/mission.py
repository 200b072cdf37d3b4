"""The mission CAV-H glide: its laws, its worlds and its dispersions."""

from ...plots import GLIDE
from ..mission import Mission
from ..npcg_toolbox import through_us_1976
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import (
    at_rest,
    guided,
    two_ended,
    undamped,
    undamped_unlimited,
)


MISSION = Mission(
    name="cav-h-glide",
    title="CAV-H glider to a point, numerical predictor-corrector",
    source='Lu, Forbes and Baldwin, "Gliding Guidance of High L/D Hypersonic Vehicles", '
    "AIAA 2013-4648, as in the NPCG Toolbox of Lee, Lee and Wie",
    laws={
        "predictor-corrector": guided,
        "two-ended": two_ended,
        "undamped": undamped,
        "undamped-unlimited": undamped_unlimited,
    },
    worlds={"us-1976": through_us_1976, "at-rest": at_rest},
    former_variants={
        name: f"predictor-corrector world {name}" for name in ("us-1976", "at-rest")
    },
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
    },
    gains=("guidance.shape.final", "guidance.damping.ratio"),
    figures=GLIDE,
)
