"""Newton's method with safeguards: a fixed number of steps, which stay within bounds."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ._batching import side_by_side
from .fields import Flag, Scalar


Point = Scalar | Float[Array, " 2"]
"""One unknown, or two unknowns"""
Slope = Scalar | Float[Array, "2 2"]
"""Derivative of one value, or of each of two values (rows) in each unknown (columns)"""
Bound = Scalar | float | None
ValueAndSlope = Callable[[Point], tuple[Point, Slope]]


class Root(NamedTuple):
    """Result of Newton's method."""

    x: Point
    value: Point
    """Value of the function where the last step began"""
    step: Point
    """The last step: small if the method has converged, infinite if no step was possible"""
    known: Flag
    """Whether the function and its derivative were finite wherever they were evaluated"""


def newton(
    value_and_slope: ValueAndSlope,
    x: Point,
    steps: int,
    *,
    lower: Bound = None,
    upper: Bound = None,
    largest_step: Bound = None,
    falls: bool = False,
    unroll: bool = False,
    nan_where_lost: bool = False,
) -> Root:
    """Search a zero of a function of one or two unknowns.

    The number of steps is fixed, and no step leaves the bounds: a search for a zero beyond
    a bound ends at the bound. If the function is not finite, or its slope is zero, x does
    not change; with `falls`, a slope of zero is no hindrance. The derivative of the result
    is that of the steps. From a zero that is not differentiated, `stop_gradient(x)`, one
    step has the first derivative of the implicit function, and two steps have the first
    three.

    **Arguments:**

    - `value_and_slope`: value and slope of the function, such as `by_jvp(function)`.
    - `x`: initial value.
    - `steps`: number of steps.
    - `lower`, `upper`: bounds on each unknown.
    - `largest_step`: bound on each step of each unknown.
    - `falls`: the function of one unknown is known to fall from a positive value at the
      lower bound to a negative one at the upper bound. The bounds then close in on the
      zero. A step that would leave them, or that begins where the slope is zero, goes to
      the middle between them.
    - `unroll`: unroll the steps instead of compiling a loop.
    - `nan_where_lost`: x becomes NaN, and remains so, where otherwise it would not change.
      This is for an inner loop, which then carries only x.
    """
    if falls and nan_where_lost:
        raise ValueError("falls=True has bounds that close in: it is not lost")
    if falls and (lower is None or upper is None or jnp.ndim(x) != 0):
        raise ValueError("falls=True needs one unknown with a lower and an upper bound")

    def improve(carry, _):
        (x, _, _, known), low, high = carry
        value, slope = value_and_slope(x)
        if nan_where_lost:
            # A slope of zero gives an infinite step; an infinite slope gives a zero step.
            step = -solve(slope, value) + 0.0 * jnp.sum(slope)
            step = jnp.where(jnp.isfinite(step), step, jnp.nan)
        else:
            finite = _is_finite(value) & _is_finite(slope)
            usable = finite & (_determinant(slope) != 0.0)
            known = known & finite
            # Replaced before and after the division, so that no derivative is NaN.
            at = jnp.where(usable, value, jnp.zeros_like(value))
            step = -solve(jnp.where(usable, slope, _identity(slope)), at)
        if largest_step is not None:
            step = _within(step, -largest_step, largest_step)
        moved = x + step
        if falls:
            # Its sign says where the zero is, even where the function is flat.
            flat = finite & (_determinant(slope) == 0.0) & (value != 0.0)
            at, usable = jnp.where(flat, value, at), usable | flat
            low, high = jnp.where(at > 0.0, x, low), jnp.where(at < 0.0, x, high)
            inside = (moved >= low) & (moved <= high) & ~flat
            moved = jnp.where(inside, moved, 0.5 * (low + high))
        moved = _within(moved, lower, upper)
        step = moved - x
        if not nan_where_lost:
            moved, step = jnp.where(usable, moved, x), jnp.where(usable, step, jnp.inf)
        return (Root(moved, value, step, known), low, high), None

    known = _is_finite(x)
    first = Root(x, jnp.full_like(x, jnp.inf), jnp.full_like(x, jnp.inf), known)
    start = side_by_side((first, _like(lower, x), _like(upper, x)))
    (found, _, _), _ = lax.scan(improve, start, length=steps, unroll=unroll)
    if nan_where_lost:
        found = found._replace(known=_is_finite(found.x))
    return found


def by_jvp(function: Callable[[Point], Point]) -> ValueAndSlope:
    """Value and slope of a function, by forward-mode derivatives."""

    def value_and_slope(x: Point) -> tuple[Point, Slope]:
        if jnp.ndim(x) == 0:
            return jax.jvp(function, (x,), (jnp.ones_like(x),))
        values, columns = jax.vmap(lambda t: jax.jvp(function, (x,), (t,)))(jnp.eye(2))
        return values[0], columns.T

    return value_and_slope


def solve(slope: Slope, right: Point) -> Point:
    """Solution of one linear equation, or of two by Cramer's rule."""
    if jnp.ndim(slope) == 0:
        return right / slope
    (a, b), (c, d) = jnp.asarray(slope)
    e, f = jnp.asarray(right)
    return jnp.stack([d * e - b * f, a * f - c * e]) / _determinant(slope)


def _is_finite(x: Point | Slope) -> Flag:
    # A reduction of a scalar would prevent the fusion of the operations around it.
    return jnp.isfinite(x if jnp.ndim(x) == 0 else jnp.sum(x))


def _determinant(slope: Slope) -> Scalar:
    if jnp.ndim(slope) == 0:
        return slope
    (a, b), (c, d) = jnp.asarray(slope)
    return a * d - b * c


def _within(x: Point, low: Bound, high: Bound) -> Array:
    # `jnp.clip` has derivative one half if x is at an end.
    if low is not None:
        x = jnp.where(x < low, low, x)
    return jnp.asarray(x if high is None else jnp.where(x > high, high, x))


def _identity(slope: Slope) -> Array:
    return jnp.ones_like(slope) if jnp.ndim(slope) == 0 else jnp.eye(2)


def _like(bound: Bound, x: Point) -> Array:
    return jnp.zeros_like(x) if bound is None else jnp.zeros_like(x) + bound
