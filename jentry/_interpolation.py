"""Smooth interpolation in tables: monotone cubics over one or two variables.

Slopes are computed from the values at each call, so that a table is a leaf like any
other number: it can be dispersed, tuned and differentiated. Under `vmap` over flights
that share a table the slopes are computed once, not once for each flight.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from .fields import Scalar, Vector


def check_grid(name: str, grid: Array) -> None:
    """Refuse a grid that is not a list of at least two increasing numbers.

    The order is checked if the numbers are known, that is outside of `jit`.
    """
    if grid.ndim != 1 or grid.shape[0] < 2:
        raise ValueError(
            f"{name} has shape {grid.shape}: expected one axis with two or more values"
        )
    if isinstance(grid, Tracer):
        return
    steps = np.diff(np.asarray(grid))
    if not np.all(steps > 0.0):
        worst = int(np.argmin(steps > 0.0))
        raise ValueError(
            f"{name} must increase: value {worst + 1} is {float(grid[worst])!r} and "
            f"the next one {float(grid[worst + 1])!r}"
        )


def clamp(x: Scalar, low: Scalar | float, high: Scalar | float) -> Scalar:
    """x clamped to two ends, with derivative one at the ends and zero beyond.

    `jnp.clip` has derivative one half if x is at an end.
    """
    return jnp.where(x < low, low, jnp.where(x > high, high, x))


def interval(grid: Vector, x: Scalar) -> Int[Array, ""]:
    """Number of the interval that contains x; beyond the ends the first or last one."""
    number = jnp.searchsorted(grid[1:-1], x, side="right", method="scan_unrolled")
    return number.astype(int)


def _end_slope(width, next_width, secant, next_secant):
    """Slope at an end from three points, limited so that the cubic does not overshoot."""
    slope = (2.0 * width + next_width) * secant - width * next_secant
    slope = slope / (width + next_width)
    turns = secant * next_secant <= 0.0
    slope = jnp.where(
        turns & (jnp.abs(slope) > 3.0 * jnp.abs(secant)), 3.0 * secant, slope
    )
    return jnp.where(slope * secant > 0.0, slope, 0.0)


def monotone_slopes(
    grid: Vector, values: Float[Array, " n *trailing"]
) -> Float[Array, " n *trailing"]:
    """Slopes at the grid points along the first axis, for a cubic without overshoot.

    A slope is the weighted harmonic mean of the two adjacent secants if they have one sign,
    and zero at a turning point. It is exact for straight lines, and of second order
    otherwise.

    Reference: Fritsch and Butland, "A method for constructing local monotone piecewise
    cubic interpolants", SIAM J. Sci. Stat. Comput. 5(2), 1984, equation (5).
    """
    widths = jnp.diff(grid).reshape((-1,) + (1,) * (values.ndim - 1))
    secants = jnp.diff(values, axis=0) / widths
    if grid.shape[0] == 2:
        return jnp.concatenate([secants, secants])
    left, right = secants[:-1], secants[1:]
    left_weight = widths[:-1] + 2.0 * widths[1:]
    right_weight = 2.0 * widths[:-1] + widths[1:]
    same_sign = left * right > 0.0
    divisor = left_weight * right + right_weight * left
    mean = (left_weight + right_weight) * left * right
    inner = jnp.where(same_sign, mean / jnp.where(same_sign, divisor, 1.0), 0.0)
    first = _end_slope(widths[0], widths[1], secants[0], secants[1])
    last = _end_slope(widths[-1], widths[-2], secants[-1], secants[-2])
    return jnp.concatenate([first[None], inner, last[None]])


def hermite(width, fraction, left, right, left_slope, right_slope):
    """Cubic between two points from values and slopes, `fraction` from 0 to 1."""
    rise = right - left
    start = width * left_slope
    end = width * right_slope
    square = 3.0 * rise - 2.0 * start - end
    cube = start + end - 2.0 * rise
    return left + fraction * (start + fraction * (square + fraction * cube))


def interpolate(
    grid: Vector, values: Float[Array, " n *trailing"], x: Scalar
) -> Float[Array, " *trailing"]:
    """Monotone cubic through the values along the first axis, once differentiable.

    Beyond the ends it continues as a straight line with the slope at the end.
    """
    slopes = monotone_slopes(grid, values)
    inside = clamp(x, grid[0], grid[-1])
    i = interval(grid, inside)
    width = grid[i + 1] - grid[i]
    fraction = (inside - grid[i]) / width
    value = hermite(width, fraction, values[i], values[i + 1], slopes[i], slopes[i + 1])
    end_slope = jnp.where(x < grid[0], slopes[0], slopes[-1])
    return value + end_slope * (x - inside)


def interpolate_surface(
    x_grid: Float[Array, " n"],
    y_grid: Float[Array, " m"],
    values: Float[Array, " n m *trailing"],
    x: Scalar,
    y: Scalar,
) -> Float[Array, " *trailing"]:
    """Bicubic surface through a table over two variables, once differentiable.

    It is monotone along the lines of the grid. Beyond an edge it is constant, and its
    gradient across the edge is zero.
    """
    x_slopes = monotone_slopes(x_grid, values)
    y_slopes = _slopes_along_second_axis(y_grid, values)
    twist = _slopes_along_second_axis(y_grid, x_slopes)
    corners = jnp.stack([values, x_slopes, y_slopes, twist])

    x = clamp(x, x_grid[0], x_grid[-1])
    y = clamp(y, y_grid[0], y_grid[-1])
    i, j = interval(x_grid, x), interval(y_grid, y)
    sizes = (4, 2, 2, *values.shape[2:])
    starts = (0, i, j, *(0 for _ in values.shape[2:]))
    value, x_slope, y_slope, twist = jax.lax.dynamic_slice(corners, starts, sizes)

    width = y_grid[j + 1] - y_grid[j]
    fraction = (y - y_grid[j]) / width
    left, right = hermite(
        width, fraction, value[:, 0], value[:, 1], y_slope[:, 0], y_slope[:, 1]
    )
    left_slope, right_slope = hermite(
        width, fraction, x_slope[:, 0], x_slope[:, 1], twist[:, 0], twist[:, 1]
    )
    width = x_grid[i + 1] - x_grid[i]
    fraction = (x - x_grid[i]) / width
    return hermite(width, fraction, left, right, left_slope, right_slope)


def _slopes_along_second_axis(grid, values):
    return jnp.swapaxes(monotone_slopes(grid, jnp.swapaxes(values, 0, 1)), 0, 1)
