"""Derivatives of the mean of many flights, by central differences with the same draws.

The outputs of a flight may jump as a parameter varies: a law with a guidance cycle decides
one cycle later, or needs one more cycle to the end. Between its jumps a flight has an exact
derivative, which does not contain the jumps. The mean of these derivatives is therefore not
the derivative of the mean: with jumps of size J at places of density p it lacks the mean of
J p. (The draws spread the places of the jumps, so that the mean is smooth although no
flight is.) With the step h, the loss L and fixed draws,

    (L(x + h) - L(x - h)) / 2h  =  d/dx of the mean of L over [x - h, x + h].

This holds exactly, with jumps included. Two errors remain as an estimate of the derivative
at x: the curvature within the step, of order h^2, and the sampling error of the draws,
which with jumps is of order sqrt(J^2 p / h runs). Its standard error is the standard error
of the mean of the contributions of the flights to the difference.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..parameters.parameters import Free
from .batch_gradients import Loss, loss_and_weights, where_finite


@dataclasses.dataclass(frozen=True)
class Differences:
    """Gradient of a loss by central differences."""

    gradient: Free
    error: float
    """Standard error: the root of the summed squares of the errors of all components"""
    failed: int
    """Largest number of flights that a difference leaves out because they are not finite
    on both of its sides"""
    shares: dict[str, float]
    """Share of the flights that change with each parameter, by address"""


Fly = Callable[[Free], tuple[Any, np.ndarray]]
"""Function of a point: outputs of all flights, and which of the flights are finite"""


@dataclasses.dataclass(frozen=True)
class Slope:
    """Central difference of a loss along a direction, divided by the step."""

    value: float
    error: float
    """Standard error; zero for a single flight"""
    flights: int
    """Number of flights that are finite on both sides. Only these are used"""
    changed: float
    """Share of these flights that contribute to the difference"""


def slope_along(
    fly: Fly, loss: Loss, free: Free, direction: Free, step: float
) -> Slope:
    """Central difference of the loss of the flights that are finite on both sides.

    **Arguments:**

    - `step`: half of the width of the difference, in units of `direction`.
    """
    sides, finite = [], []
    for signed in (step, -step):
        moved = {a: x + signed * direction[a] for a, x in free.items()}
        outputs, counts = fly(moved)
        sides.append(outputs)
        finite.append(counts)
    both = finite[0] & finite[1]
    count = int(both.sum())
    if not count:
        return Slope(0.0, 0.0, 0, 0.0)
    change, each = _difference(loss, *(where_finite(x, both) for x in sides))
    error = np.sqrt(count * np.var(each, ddof=1)) if count > 1 else 0.0
    changed = float(np.mean(each != 0.0))
    return Slope(change / (2.0 * step), float(error) / (2.0 * step), count, changed)


def gradient_by_differences(
    fly: Fly, runs: int, loss: Loss, free: Free, step: float
) -> Differences:
    """Gradient of a loss by one central difference for each free number.

    **Arguments:**

    - `runs`: number of runs that can contribute.
    - `step`: half of the width of each difference, in free numbers.
    """
    gradient, errors, failed, found = {}, [], 0, {}
    nothing = jax.tree.map(jnp.zeros_like, free)
    for address, here in free.items():
        slopes, shares = np.zeros(here.shape), [0.0]
        for place in np.ndindex(here.shape):
            along = nothing | {address: nothing[address].at[place].set(1.0)}
            slope = slope_along(fly, loss, free, along, step)
            slopes[place] = slope.value
            errors.append(slope.error)
            shares.append(slope.changed)
            failed = max(failed, runs - slope.flights)
        gradient[address], found[address] = jnp.asarray(slopes), max(shares)
    return Differences(gradient, float(np.linalg.norm(errors)), failed, found)


def _difference(loss: Loss, ahead: Any, behind: Any) -> tuple[float, np.ndarray]:
    """Difference of the loss, and the contribution of each flight to it.

    The contribution follows from the trapezoidal rule between the two sides: the mean of
    the derivatives of the loss with respect to an output on both sides, times the
    difference of the output.
    """
    ends = [loss_and_weights(loss, side) for side in (ahead, behind)]

    def added(up, down, x, y):
        each = 0.5 * (up + down) * (x - y)
        return jnp.sum(each.reshape(len(each), -1), axis=1)

    moving = [eqx.filter(side, eqx.is_inexact_array) for side in (ahead, behind)]
    parts = jax.tree.map(added, ends[0][1], ends[1][1], *moving)
    each = np.sum([np.asarray(x) for x in jax.tree.leaves(parts)], axis=0)
    return float(ends[0][0] - ends[1][0]), each
