"""Loss and gradient of a batch of flights at one point, by either of two methods."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..flight.scenario import Scenario, check
from ..parameters.parameters import Free, Parameters, scenario_at
from .batch_gradients import (
    FORWARD_UP_TO,
    Loss,
    Problem,
    batch_gradient,
    batch_outputs,
    loss_and_weights,
    put_back,
    where_finite,
)
from .differences import gradient_by_differences


Surrogate = Callable[[Scenario], Scenario]
"""From a scenario to a smoother one, whose gradient is followed in place of that of the
exact law, such as `smooth_switching`"""

Inputs = dict[str, Any]
"""By address, each of shape (runs,)"""


class Evaluation(eqx.Module):
    """What is known of one point."""

    loss: float
    """Of the exact law, over the draws that are the same for all points"""
    followed: float
    """Of the law and the draws of the gradient: the same, unless these are others"""
    gradient: Free
    failed: int
    """Flights of the exact law that are not finite, and that the loss leaves out"""
    gradients_failed: int
    """Flights whose gradient is left out: not finite, or of outputs whose derivatives are
    beyond all measure; by differences, flights that are not finite on both sides"""
    gradient_shares: dict[str, float]
    """Share of the flights that the loss looks at to which each parameter matters"""
    gradient_error: float = np.nan
    """Standard error of a gradient by differences"""


class AutomaticDifferentiation(eqx.Module):
    """The mean of the exact derivatives of the flights, each between its jumps."""

    forward: bool | None = eqx.field(default=None, static=True)
    """Forward or reverse mode; by the number of parameters if not given"""
    surrogate: Surrogate | None = eqx.field(default=None, static=True)

    def __call__(
        self, problem: Problem, loss: Loss, free: Free, inputs: Inputs
    ) -> Evaluation:
        """Loss and gradient at a point, over these runs."""
        value, weights, failed = batch_loss(problem, loss, free, inputs)
        count = sum(x.size for x in free.values())
        forward = count <= FORWARD_UP_TO if self.forward is None else self.forward
        found = batch_gradient(problem, free, inputs, weights, forward)
        counted = max(int(found.counted), 1)
        shares = {a: int(n) / counted for a, n in found.moved.items()}
        left_out = int(found.failed)
        return Evaluation(value, value, found.total, failed, left_out, shares)

    def batches(self, parameters: int) -> int:
        """How often every run is flown, a flight with its derivatives counting once."""
        return 1


class CentralDifferences(eqx.Module):
    """Differences of the loss with the same draws, number by number, to both sides.

    They are exact for the loss averaged over the interval, jumps of the flights included,
    and come with a standard error, `Entry.gradient_error`. A step in which hardly a flight
    jumps tells little.
    """

    step: float = eqx.field(default=0.02, static=True)
    """In free numbers: 0.02 is 2 % of a positive number"""
    surrogate: Surrogate | None = eqx.field(default=None, static=True)

    def __check_init__(self):
        if not 0.0 < self.step < 1.0:
            raise ValueError(
                f"the step of the differences is {self.step}: it must be between 0 and "
                "1; 0.02 is 2 % of a positive number"
            )

    def __call__(
        self, problem: Problem, loss: Loss, free: Free, inputs: Inputs
    ) -> Evaluation:
        """Loss and gradient at a point, over these runs."""
        value, _, failed = batch_loss(problem, loss, free, inputs)
        fly = lambda free: fly_at(problem, free, inputs)
        found = gradient_by_differences(fly, _count(inputs), loss, free, self.step)
        return Evaluation(
            value,
            value,
            found.gradient,
            failed,
            max(found.failed - failed, 0),
            found.shares,
            found.error,
        )

    def batches(self, parameters: int) -> int:
        """How often every run is flown: at the point, and beside it for each number."""
        return 1 + 2 * parameters


GradientMethod = AutomaticDifferentiation | CentralDifferences
"""How the gradient of a loss is found"""


def batch_loss(
    problem: Problem, loss: Loss, free: Free, inputs: Inputs
) -> tuple[float, Any, int]:
    """Loss of the finite runs, its derivative to all outputs, and how many are not."""
    outputs, finite = fly_at(problem, free, inputs)
    failed = len(finite) - int(finite.sum())
    if not finite.any():
        nothing = eqx.filter(outputs, eqx.is_inexact_array)
        return np.inf, jax.tree.map(jnp.zeros_like, nothing), failed
    value, weights = loss_and_weights(loss, where_finite(outputs, finite))
    return float(value), put_back(weights, finite), failed


def fly_at(problem: Problem, free: Free, inputs: Inputs) -> tuple[Any, np.ndarray]:
    """Outputs of every run at a point, and which of them are finite.

    None is where the scenario that is built there has a number that cannot be flown.
    """
    assert isinstance(problem.parameters, Parameters)
    parameters = problem.parameters
    scenario = scenario_at(parameters, parameters.values(free))
    outputs, finite = batch_outputs(problem.simulation, scenario, inputs)
    try:
        check(scenario)
    except ValueError:
        finite = np.zeros_like(finite)
    return outputs, finite


def _count(inputs: Inputs) -> int:
    return len(next(iter(inputs.values())))
