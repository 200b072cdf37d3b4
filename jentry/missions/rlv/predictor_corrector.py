"""RLV, numerical predictor-corrector to a point, with the lag of the attitude."""

import dataclasses

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import LinearBankShape
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import PredictedCrossrange
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.index import VelocityIndex
from ...onboard.profiles import QuinticTable
from ...onboard.turning import BankTurning
from ...units import degree, km
from .scenario import (
    END_VELOCITY,
    LARGEST_BANK,
    TURN_ACCELERATION,
    TURN_RATE,
    entry,
    model,
    plan,
)


RANGE = 7400.0 * km
"""Range to a target straight ahead; the paper's law has no target and about this range"""


def guided() -> Scenario:
    """Predictor-corrector at the planned angle of attack, with an attitude of 5 rad/s.

    The angle of attack is that of the plan over the velocity. A bank reversal takes half a
    minute, during which the lift passes through upwards. The prediction includes this
    reversal and the next one before they begin. It turns the bank within the limits of the
    attitude, and neglects the lag of the angle of attack. The bank at the end is chosen.
    """
    table = plan().quantities
    assert isinstance(table, QuinticTable)
    law = PredictorCorrector(
        model=model(),
        shape=LinearBankShape(
            end=END_VELOCITY, final=45.0 * degree, largest=LARGEST_BANK
        ),
        end=GuidedEnd(velocity=END_VELOCITY, ceiling=130.0 * km),
        lateral=PredictedCrossrange(factor=10.0, predicts_reversals=True),
        angle_of_attack=table.profile("angle_of_attack"),
        turning=BankTurning(TURN_RATE, TURN_ACCELERATION),
        index=VelocityIndex(),
        in_space=False,
        step=5.0,
        steps=400,
    )
    scenario = entry(law, 5.0)
    target = dataclasses.replace(
        scenario.target, downrange=RANGE, origin=scenario.initial_state
    )
    return dataclasses.replace(scenario, target=target)
