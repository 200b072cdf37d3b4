"""Mars lander under the law of another paper: a regulator about the planned flight.

Modulation of the angle of attack and feedback linearization do not suit this vehicle, whose
coefficients do not depend on the angle of attack: the first has nothing to command, and the
second commands the magnitude of the lift.
"""

import dataclasses

import jax.numpy as jnp

from ..._computed_once import computed_once
from ..._programs import cached
from ...flight.scenario import Scenario
from ...flight.termination import Termination, VelocityBelow
from ...guidance.aim import TargetOfScenario
from ...guidance.open_loop import BankProfile
from ...guidance.pseudospectral_tracking import (
    DeviationWeights,
    Regulator,
    StoredGainTracking,
    plan_gains,
)
from ...onboard.longitudinal import LongitudinalModel, LongitudinalReference
from ...onboard.model import OnboardModel
from ...onboard.profiles import PolynomialProfile
from ...planning.longitudinal_flight import as_longitudinal
from ...planning.reference_flight import ReferenceFlight
from .drag_tracking import END_VELOCITY, entry, lander, mars, reference, to_the_place


def _flown(scenario: Scenario) -> LongitudinalReference:
    return as_longitudinal(ReferenceFlight.of(scenario))


@computed_once
def longitudinal_reference() -> LongitudinalReference:
    """The flight under the planned bank, over time."""
    ends = {"velocity": VelocityBelow(velocity=END_VELOCITY)}
    flown = dataclasses.replace(
        entry(),
        guidance=BankProfile(reference().cos_bank),
        termination=Termination(ends, time_limit=600.0),
    )
    return cached(_flown)(flown)


def _regulated(**weights) -> Scenario:
    level = PolynomialProfile(
        jnp.zeros(1)
    )  # No coefficient depends on the angle of attack.
    model = LongitudinalModel(OnboardModel(mars(), lander()), level)
    regulator = Regulator(model, longitudinal_reference(), **weights)
    law = StoredGainTracking(regulator, cached(plan_gains)(regulator))
    return dataclasses.replace(entry(), guidance=law)


def pseudospectral() -> Scenario:
    """Lee, Cho and Yan's regulator, with the weights of the X-33."""
    return _regulated()


def pseudospectral_with_range() -> Scenario:
    """The regulator with the downrange as a fourth state, with weights of the X-33."""
    regulated = _regulated(
        underway=DeviationWeights(downrange=1.0),
        at_end=DeviationWeights(*4 * [3e4]),
        aim=TargetOfScenario(),
    )
    return to_the_place(regulated)
