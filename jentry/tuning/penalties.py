"""Penalties: what a scenario is not to be, beside what its flights are to do."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..analysis.damping import Damping
from ..analysis.local_derivatives import QUICKLY
from ..fields import Scalar, scalar
from ..flight.scenario import Scenario
from .parameters import Free, Parameters


Penalty = Callable[[Scenario], Any]
"""A number of the nominal scenario of a point, which is added to the loss of its flights:
differentiable by JAX in the tuned numbers, in forward mode"""


class DampingBelow(eqx.Module):
    """Mean, over points of the flight, of the square of how far damping falls short.

    At each point it is the least damped mode that counts, and what lacks is in units of
    the damping that is wanted. Tracking errors hide a lost margin: a loop that hardly
    damps tracks the nominal flight as well as another.

        damping = Damping.of(scenario, points=40, faster_than=0.1)
        tune(..., penalty=DampingBelow(damping, least=0.3))
    """

    damping: Damping
    least: Scalar = scalar(0.3, positive=True)
    weight: Scalar = scalar(1.0, positive=True)
    """In units of the loss: the penalty of a loop without any damping"""

    def __call__(self, scenario: Scenario) -> Scalar:
        worst = jnp.min(self.damping(scenario), axis=1)
        lacks = jax.nn.relu(1.0 - worst / self.least)
        return self.weight * jnp.mean(lacks * lacks)


@eqx.filter_jit(compiler_options=QUICKLY)  # pyright: ignore[reportCallIssue]
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
