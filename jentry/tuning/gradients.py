"""Loss and gradient of many flights at one point, by one of two methods."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..flight.scenario import Scenario
from ..flight.scenario_checks import check
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
"""Function from a scenario to a smoother one, such as `smooth_switching`. The gradient of
the smoother scenario replaces the gradient of the exact law"""

Inputs = dict[str, Any]
"""Dispersed leaves by address, each of shape (runs,)"""


class Evaluation(eqx.Module):
    """Loss, gradient and counts of flights at one point."""

    loss: float
    """Loss of the exact law, over draws that are the same for all points"""
    followed: float
    """Followed loss: the loss with the law and the draws of the gradient. It equals `loss`
    unless a surrogate or fresh draws are used"""
    gradient: Free
    failed: int
    """Number of flights of the exact law that are not finite. The loss leaves them out"""
    gradients_failed: int
    """Number of flights that only the gradient leaves out. With automatic differentiation
    their gradient is not finite or they diverge; with differences they are not finite on
    both sides"""
    gradient_shares: dict[str, float]
    """Share of the flights in the loss on which each parameter has an effect"""
    gradient_error: float = np.nan
    """Standard error of a gradient by differences; NaN for automatic differentiation"""


class AutomaticDifferentiation(eqx.Module):
    """Mean of the exact derivatives of the flights, which do not contain their jumps."""

    forward: bool | None = eqx.field(default=None, static=True)
    """Whether to use forward mode or reverse mode; None chooses by the number of
    parameters"""
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
        """How often each run is flown. A flight with its derivatives counts once."""
        return 1


class CentralDifferences(eqx.Module):
    """Gradient by central differences of the loss, with the same draws on both sides.

    There is one difference for each free number. It is exact for the loss averaged over
    the interval, including the jumps of the flights. `Entry.gradient_error` is its standard
    error. If few flights jump within a step, the estimate is poor.
    """

    step: float = eqx.field(default=0.02, static=True)
    """Step to each side, in free numbers: 0.02 is 2 % of a positive number"""
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
        """How often each run is flown: once at the point, and twice for each number."""
        return 1 + 2 * parameters


GradientMethod = AutomaticDifferentiation | CentralDifferences
"""Method by which the gradient of a loss is computed"""


def batch_loss(
    problem: Problem, loss: Loss, free: Free, inputs: Inputs
) -> tuple[float, Any, int]:
    """Loss of the finite runs, its derivatives, and the number of runs that are not finite.

    The derivatives are with respect to the outputs of all runs.
    """
    outputs, finite = fly_at(problem, free, inputs)
    failed = len(finite) - int(finite.sum())
    if not finite.any():
        nothing = eqx.filter(outputs, eqx.is_inexact_array)
        return np.inf, jax.tree.map(jnp.zeros_like, nothing), failed
    value, weights = loss_and_weights(loss, where_finite(outputs, finite))
    return float(value), put_back(weights, finite), failed


def fly_at(problem: Problem, free: Free, inputs: Inputs) -> tuple[Any, np.ndarray]:
    """Outputs of every run at a point, and which of them are finite.

    No run is finite if the scenario at that point has a number that cannot be flown.
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
