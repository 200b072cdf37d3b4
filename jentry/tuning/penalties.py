"""Penalties: what a scenario is not to be, beside what its flights are to do."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._programs import kept
from ..analysis.damping import Damping
from ..analysis.local_derivatives import QUICKLY
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..parameters.parameters import Free, Parameters


Penalty = Callable[[Scenario], Any]
"""A number of the nominal scenario of a point, which is added to the loss of its flights:
differentiable by JAX in the tuned numbers, in forward mode"""


class DampingBelow(eqx.Module):
    """Square of how far the least damped mode falls short, of all points of the flight.

    What lacks is in units of the damping that is wanted. Tracking errors hide a lost
    margin: a loop that hardly damps tracks the nominal flight as well as another. Modes
    that are slower than `damping.faster_than` do not count, also those that become so.

        damping = Damping.of(scenario, points=40, faster_than=0.1)
        tune(..., penalty=DampingBelow(damping, least=0.3))
    """

    damping: Damping
    least: float = eqx.field(default=0.3, static=True)
    weight: float = eqx.field(default=100.0, static=True)
    """In units of the loss: the penalty of a loop without any damping"""

    def __check_init__(self):
        if not 0.0 < self.least <= 1.0:
            raise ValueError(f"least is {self.least}: it must be above 0, at most 1")
        if not self.weight > 0.0:
            raise ValueError(f"weight is {self.weight}: it must be positive")

    def __call__(self, scenario: Scenario) -> Scalar:
        lacks = jax.nn.relu(1.0 - self.damping.least(scenario) / self.least)
        return self.weight * lacks * lacks


@functools.partial(kept, compiler_options=QUICKLY)
def penalty_and_slopes(
    penalty: Penalty, parameters: Parameters, free: Free
) -> tuple[Scalar, Free]:
    """Of the scenario at a point, over the free numbers."""

    def value(free: Free) -> tuple[Scalar, Scalar]:
        found = jnp.asarray(penalty(parameters.scenario(free)))
        if found.shape != ():
            raise ValueError(
                f"the penalty has shape {found.shape}: it must be a single number"
            )
        return found, found

    slopes, found = jax.jacfwd(value, has_aux=True)(free)
    return found, slopes
