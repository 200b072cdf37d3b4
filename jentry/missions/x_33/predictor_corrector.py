"""X-33, numerical predictor-corrector: to the end of the reference, without tracking it."""

import dataclasses

import equinox as eqx

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import TwoEndedBankShape
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import AbstractLateralLogic, FixedSide, PredictedCrossrange
from ...guidance.path_limits import PathLimits
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.index import VelocityIndex
from ...units import degree
from .airframe import ScheduledAngleOfAttack
from .scenario import LAST_VELOCITY, glide, glide_in_space, model, reference, start


STEP = 0.5
"""s; the bank is smooth within a guidance cycle"""


def _guided(
    free: Scenario,
    lateral: AbstractLateralLogic = FixedSide(),
    limits: PathLimits | None = None,
    largest_bank: float = 80.0 * degree,
) -> Scenario:
    of = reference()
    law = PredictorCorrector(
        model=model().onboard,
        shape=TwoEndedBankShape(
            end=LAST_VELOCITY, final=45.0 * degree, largest=largest_bank
        ),
        end=GuidedEnd(velocity=LAST_VELOCITY),
        origin=start(of),
        downrange=of.end.downrange,
        crossrange=0.0,
        altitude=of.end.altitude,
        lateral=lateral,
        angle_of_attack=ScheduledAngleOfAttack(),
        limits=limits,
        index=VelocityIndex(),
        in_space=False,
        step=5.0,
        steps=400,
    )
    guided = eqx.tree_at(lambda s: s.guidance, free, law)
    return dataclasses.replace(guided, step=STEP)


def in_plane() -> Scenario:
    """In the vertical plane, down to the velocity at the end of the reference.

    Both ends of the bank are free, so that the altitude there is met as well.
    """
    return _guided(glide())


def limited() -> Scenario:
    """The same within the corridor, for which the bank may be larger.

    A steep entry that is kept from heat and load pulls up and comes down too far away: this
    is what the corridor costs.
    """
    return _guided(glide(), limits=PathLimits(0.1), largest_bank=120.0 * degree)


def in_space() -> Scenario:
    """The same in three dimensions, to the point straight ahead."""
    return _guided(glide_in_space(), lateral=PredictedCrossrange(factor=5.0))
