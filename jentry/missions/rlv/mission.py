"""The mission RLV: both laws with attitudes of several bandwidths."""

from ..mission import Mission
from .dispersions import atmosphere, table_1, table_1_estimated_angle
from .scenario import a8, hard, r5, shuttle, shuttle_quarter


MISSION = Mission(
    name="rlv",
    title="RLV, angle-of-attack modulation with a disturbance observer",
    source='Zhang, Li and Zhang, "Angle-of-Attack Modulation in Trajectory Tracking for a '
    'Reusable Launch Vehicle"',
    variants={
        "r5": r5,
        "a8": a8,
        "hard": hard,
        "shuttle": shuttle,
        "shuttle-quarter": shuttle_quarter,
    },
    dispersions={
        "table-1": table_1,
        "table-1-estimated-angle": table_1_estimated_angle,
        "atmosphere": atmosphere,
    },
    gains=("guidance.angle_of_attack.gains",),
)
