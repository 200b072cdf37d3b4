"""The classical Runge-Kutta method, for flights and for predictions on board."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from ._batching import side_by_side
from ._trace_modes import stages_are_written_out
from .fields import Scalar


Y = TypeVar("Y", bound=PyTree)
Slope = Callable[[Scalar, Y], Y]
"""dy/dx as a function of the independent variable x and of y"""


def runge_kutta_step(slope: Slope, x: Scalar, y: Y, step: Scalar | float) -> Y:
    """y after one step of the classical fourth-order method from x to x + step.

    Each stage is added to the sum and is not stored. The stages are a loop: unrolled they
    compile more slowly, and reverse mode takes four times as long on a CPU. For a GPU see
    `stages_written_out`.
    """

    # In a loop no common subexpressions can be merged with the recomputed stages.
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def stage(carry, place_and_weight):
        k, total = carry
        place, weight = place_and_weight
        at = jax.tree.map(lambda y, k: y + place * step * k, y, k)
        k = slope(x + place * step, at)
        total = jax.tree.map(lambda s, k: s + weight * step * k, total, k)
        return (k, total), None

    places = jnp.array([0.0, 0.5, 0.5, 1.0])
    weights = jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0
    start = side_by_side((jax.tree.map(jnp.zeros_like, y), y))
    y = start[1]
    unroll = 4 if stages_are_written_out() else 1
    (_, after), _ = lax.scan(stage, start, (places, weights), unroll=unroll)
    return after


def runge_kutta(
    slope: Slope,
    start: Scalar | float,
    end: Scalar | float,
    y: Y,
    steps: int,
    after: Callable[[Y], Y] = lambda y: y,
) -> Y:
    """y at the end, integrated from the start in a number of equal steps.

    `after` is applied to y after each step.
    """
    step = (end - start) / steps

    def advance(y, index):
        return after(runge_kutta_step(slope, start + step * index, y, step)), None

    return lax.scan(advance, y, jnp.arange(steps, dtype=float))[0]
