"""Penalties: functions of the nominal scenario that tuning adds to the loss."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._programs import cached
from ..analysis.damping import Damping
from ..analysis.local_derivatives import QUICKLY
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..parameters.parameters import Free, Parameters


Penalty = Callable[[Scenario], Any]
"""Function of the nominal scenario of a point that returns one number. The number is added
to the loss of the flights. JAX differentiates it in the tuned numbers, in forward mode"""


class DampingBelow(eqx.Module):
    """Penalty for a damping ratio below a required least value, anywhere along the flight.

    It is `weight` times the square of the shortfall of the smallest damping ratio, as a
    share of the required value. Tracking errors do not show a lost margin: a poorly damped
    loop tracks the nominal flight as well as a well damped loop. Modes that are slower than
    `damping.faster_than` do not count, including modes that become slower during tuning.

        damping = Damping.of(scenario, points=40, faster_than=0.1)
        tune(..., penalty=DampingBelow(damping, least=0.3))
    """

    damping: Damping
    least: float = eqx.field(default=0.3, static=True)
    weight: float = eqx.field(default=100.0, static=True)
    """Penalty of a loop without damping, in units of the loss"""

    def __check_init__(self):
        if not 0.0 < self.least <= 1.0:
            raise ValueError(f"least is {self.least}: it must be above 0, at most 1")
        if not self.weight > 0.0:
            raise ValueError(f"weight is {self.weight}: it must be positive")

    def __call__(self, scenario: Scenario) -> Scalar:
        lacks = jax.nn.relu(1.0 - self.damping.least(scenario) / self.least)
        return self.weight * lacks * lacks


@functools.partial(cached, compiler_options=QUICKLY)
def penalty_and_slopes(
    penalty: Penalty, parameters: Parameters, free: Free
) -> tuple[Scalar, Free]:
    """Penalty of the scenario at a point, and its derivatives in the free numbers."""

    def value(free: Free) -> tuple[Scalar, Scalar]:
        found = jnp.asarray(penalty(parameters.scenario(free)))
        if found.shape != ():
            raise ValueError(
                f"the penalty has shape {found.shape}: it must be a single number"
            )
        return found, found

    slopes, found = jax.jacfwd(value, has_aux=True)(free)
    return found, slopes
