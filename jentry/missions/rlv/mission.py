"""The mission RLV: both laws of the paper, with attitudes of several bandwidths."""

import math

from ...plots.campaign import HISTORIES, overview
from ...units import km
from ..inertial import SHUTTLE_TILT, Errors, Inertial, Sensors, doubt, shuttle_sensors
from ..mission import Mission, PublishedValue
from . import crossings, figures, predictor_corrector
from .dispersions import atmosphere, table_1, table_1_estimated_angle, table_1_noise
from .scenario import (
    attitude_3,
    attitude_8,
    lag_inverted,
    lag_inverted_fast,
    model,
    modulation,
    modulation_fast_observer,
    noise,
    shuttle,
    shuttle_as_flown,
    shuttle_quarter,
)


def _sensors(cycle: float) -> Sensors:
    """The share of the density is that of its trend at 80 km, where it is 25 % at 3 sigma;
    that of waves is small beside it."""
    share = math.hypot(0.25 / 3.0, doubt(table_1(), "drag"))
    return shuttle_sensors(model(), share, 1300.0, cycle)


NAVIGATION = Inertial(
    Errors(position=1.0 * km / 3.0, velocity=1.0 / 3.0, tilt=SHUTTLE_TILT),
    decided=("velocity",),
    usual=table_1,
    sensors=_sensors,
)
"""Attitude of the Space Shuttle at its entry. Position and velocity are chosen. The
instruments are those of `Errors`. The guided flight ends at the velocity that the vehicle
believes"""


MISSION = Mission(
    name="rlv",
    title="RLV, angle-of-attack modulation with a disturbance observer",
    source='Zhang, Li and Zhang, "Angle-of-Attack Modulation in Trajectory Tracking for a '
    'Reusable Launch Vehicle"',
    laws={
        "modulation": modulation,
        "modulation-fast-observer": modulation_fast_observer,
        "lag-inverted": lag_inverted,
        "lag-inverted-fast": lag_inverted_fast,
        "shuttle": shuttle,
        "shuttle-quarter": shuttle_quarter,
        "shuttle-as-flown": shuttle_as_flown,
        "predictor-corrector": predictor_corrector.guided,
        "bank-alone": crossings.bank_alone,
        "state-drag-tracking": crossings.state_drag_tracking,
        "observer-drag-tracking": crossings.observer_drag_tracking,
        "pseudospectral": crossings.pseudospectral,
        "pseudospectral-with-range": crossings.pseudospectral_with_range,
        "feedback-linearization": crossings.feedback_linearization,
    },
    worlds={
        "attitude-3": attitude_3,
        "attitude-8": attitude_8,
        "noise": noise,
        "inertial": NAVIGATION.world,
        "aided": NAVIGATION.aided,
    },
    former_variants={
        "r5": "modulation",
        "a8": "modulation-fast-observer world attitude-8",
        "hard": "lag-inverted world attitude-3",
        "hard-noise": "lag-inverted world attitude-3 world noise",
        "quick-noise": "lag-inverted-fast world attitude-3 world noise",
    },
    dispersions={
        "table-1": table_1,
        "table-1-noise": table_1_noise,
        "table-1-estimated-angle": table_1_estimated_angle,
        "atmosphere": atmosphere,
        "knowledge": NAVIGATION.knowledge,
        "table-1-and-knowledge": NAVIGATION.usual_and_knowledge,
    },
    gains=(
        # `scheduled_at` is left out: it multiplies two of these.
        "guidance.angle_of_attack.gains.frequency",
        "guidance.angle_of_attack.gains.damping",
        "guidance.angle_of_attack.gains.observer_pole",
        "guidance.angle_of_attack.gains.bank_deviation",
        "guidance.angle_of_attack.gains.bank_rate",
        "guidance.bank.law.gains",
        "guidance.bank.law.observer",
    ),
    tuned_for=("drag_deviation=4e-4", "angle_of_attack_deviation=10deg"),
    modes_faster_than=0.2,
    published=(
        PublishedValue(
            "largest drag error",
            2e-3,
            "1",
            lambda v: float(v["peak_drag_deviation"].max()),
        ),
    ),
    published_note="less than about this by its text of figure 9, in units of gravity; "
    "neither its gains nor its attitude are printed",
    published_law="modulation",
    published_dispersions="table-1",
    published_runs=500,
    figures={
        **HISTORIES,
        "overview": overview,
        "deviations": figures.deviations,
        "flown": figures.flown,
    },
)
