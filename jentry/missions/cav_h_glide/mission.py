"""The mission CAV-H glide: its laws, its worlds and its dispersions."""

from ...onboard.model import OnboardModel
from ...plots import GLIDE
from ...units import degree
from ..inertial import Errors, Inertial, Sensors, doubt, drag_altitude
from ..mission import Mission
from ..npcg_toolbox import through_us_1976
from .dispersions import air_and_vehicle, entry_errors, everything
from .scenario import (
    at_rest,
    earth,
    glider,
    guided,
    two_ended,
    undamped,
    undamped_unlimited,
)


def _sensors(cycle: float) -> Sensors:
    """The altitude from drag, as that of the Space Shuttle in its radio blackout (NASA
    CR-141765, 1974); that the glider receives no radio until its end is chosen."""
    share = doubt(everything(), "density", "drag", "mass")
    known = OnboardModel(earth(), glider())
    return {"drag": drag_altitude(known, share, lasting=2000.0, cycle=cycle)}


NAVIGATION = Inertial(
    Errors(position=30.0 / 3.0, velocity=0.1 / 3.0, tilt=0.02 * degree / 3.0),
    decided=("energy",),
    usual=everything,
    sensors=_sensors,
)
"""No navigation of this glider is published. Knowledge is chosen: the booster receives
navigation satellites and sees stars until it releases the glider. The instruments are those
of `Errors`. The guided flight ends at the energy that the vehicle believes"""


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
    worlds={
        "us-1976": through_us_1976,
        "at-rest": at_rest,
        "inertial": NAVIGATION.world,
        "aided": NAVIGATION.aided,
    },
    former_variants={
        name: f"predictor-corrector world {name}" for name in ("us-1976", "at-rest")
    },
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
        "knowledge": NAVIGATION.knowledge,
        "everything-and-knowledge": NAVIGATION.usual_and_knowledge,
    },
    gains=("guidance.shape.final", "guidance.damping.ratio"),
    figures=GLIDE,
)
