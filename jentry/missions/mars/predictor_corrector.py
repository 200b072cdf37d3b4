"""Mars lander, numerical predictor-corrector, in the plane and in three dimensions.

The entry, the target and the dispersions of `drag_tracking`. What is chosen says so.
"""

import dataclasses

import equinox as eqx

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import ConstantBankShape
from ...guidance.lateral import AbstractLateralLogic, FixedSide, PredictedCrossrange
from ...guidance.predictor_corrector import GuidedEnd, PredictorCorrector
from ...motion.dynamics import AbstractDynamics, EntryDynamics, EquatorialDynamics
from ...onboard.model import OnboardModel
from ...units import km
from .drag_tracking import entry


def _guided(dynamics: AbstractDynamics, lateral: AbstractLateralLogic) -> Scenario:
    start = entry()
    target = start.target
    law = PredictorCorrector(
        model=OnboardModel(start.planet, start.vehicle),
        shape=ConstantBankShape(),
        end=GuidedEnd(target.velocity, target.altitude, ceiling=135.0 * km),
        origin=start.initial_state,
        downrange=target.downrange,
        crossrange=target.crossrange,
        altitude=target.altitude,
        lateral=lateral,
        in_space=dynamics.has_crossrange,
    )
    guided = eqx.tree_at(lambda s: s.guidance, start, law)
    return dataclasses.replace(guided, dynamics=dynamics)


def in_plane() -> Scenario:
    """A constant bank to the end, corrected every 2 s, in the vertical plane."""
    return _guided(EquatorialDynamics(), FixedSide())


def three_dimensional() -> Scenario:
    """The same in three dimensions, with reversals as predicted."""
    return _guided(EntryDynamics(), PredictedCrossrange())
