"""RLV, numerical predictor-corrector: to a point, through the attitude that lags."""

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
"""To a point straight ahead: the paper's law, which has no such aim, flies about as far"""


def guided() -> Scenario:
    """At the angle of attack of the plan over the velocity, with an attitude of 5 rad/s.

    A reversal takes half a minute here, over which the lift goes through upwards: the
    prediction flies it, and the one that comes next, before it begins. It turns the bank by
    the limits of the attitude, and takes the angle of attack to be flown at once. The bank
    at the end is chosen.
    """
    table = plan().quantities
    assert isinstance(table, QuinticTable)
    law = PredictorCorrector(
        model=model(),
        shape=LinearBankShape(
            end=END_VELOCITY, final=45.0 * degree, largest=LARGEST_BANK
        ),
        end=GuidedEnd(velocity=END_VELOCITY, ceiling=130.0 * km),
        lateral=PredictedCrossrange(factor=10.0, foresees=True),
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
