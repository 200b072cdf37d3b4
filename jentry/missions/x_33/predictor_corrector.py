"""X-33, numerical predictor-corrector to the end of the reference, which is not tracked."""

import dataclasses

import equinox as eqx

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import TwoEndedBankShape
from ...guidance.cycle import FixedCycle
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import FixedSide, PredictedCrossrange
from ...guidance.path_limits import PathLimits
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.index import VelocityIndex
from ...units import degree
from .airframe import ScheduledAngleOfAttack
from .scenario import LAST_VELOCITY, glide, model


STEP = 0.5
"""Length of a step, s; the bank is smooth within a guidance cycle"""
CYCLE = 2.0
"""Guidance cycle, s"""
LONGEST = 2000.0
"""Largest duration of a prediction, s"""


def _guided(
    free: Scenario,
    limits: PathLimits | None = None,
    largest_bank: float = 80.0 * degree,
    prediction_step: float = 5.0,
) -> Scenario:
    law = PredictorCorrector(
        model=model().onboard,
        shape=TwoEndedBankShape(
            end=LAST_VELOCITY, final=45.0 * degree, largest=largest_bank
        ),
        end=GuidedEnd(velocity=LAST_VELOCITY),
        lateral=FixedSide(),
        angle_of_attack=ScheduledAngleOfAttack(),
        limits=limits,
        predicts_limits=limits is not None,
        index=VelocityIndex(),
        cycle=FixedCycle(CYCLE),
        in_space=False,
        step=prediction_step,
        steps=round(LONGEST / prediction_step),
    )
    guided = eqx.tree_at(lambda s: s.guidance, free, law)
    return dataclasses.replace(guided, step=STEP)


def guided() -> Scenario:
    """Predictor-corrector, down to the velocity at the end of the reference.

    Both ends of the bank are free, so that the end altitude is reached as well.
    """
    return _guided(glide())


def limited() -> Scenario:
    """Predictor-corrector within the corridor, with a larger limit of the bank.

    The limits of heat rate and load make a steep entry pull up. The prediction includes
    this, in steps of a guidance cycle: the limits bound the bank there as in flight.

    Corrections are smaller, since the slopes jump where a limit becomes active. With
    largest corrections of 0.3, one flight of 800 in dispersed air reached the limit of the
    equilibrium glide. There the numbers of the bank had no effect any more, and the flight
    ended 1.8 km short.
    """
    scenario = _guided(
        glide(),
        limits=PathLimits(0.1),
        largest_bank=120.0 * degree,
        prediction_step=CYCLE,
    )
    return eqx.tree_at(lambda s: s.guidance.largest_step, scenario, 0.1)


def in_space(scenario: Scenario) -> Scenario:
    """The scenario with predicted bank reversals in place of a bank to one side."""
    lateral = PredictedCrossrange(factor=5.0)
    return eqx.tree_at(lambda s: s.guidance.lateral, scenario, lateral)
