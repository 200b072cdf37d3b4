"""Cubic splines, such as a bank over the energy: through knots, or of B-splines."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interpolation import clamp, interval
from .._math import derivatives_along
from ..fields import Scalar, Vector, table
from .profiles import AbstractProfile


class CubicSpline(AbstractProfile):
    """Cubic spline through knots, twice continuously differentiable; see `cubic_spline`.

    The first and the last cubic continue beyond the end knots.
    """

    knots: Vector = table(increasing=True)
    """Shape (n,)"""
    values: Vector = table()
    """Values at the knots, shape (n,)"""
    curvatures: Vector = table()
    """Second derivatives at the knots, shape (n,)"""

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        x, y, m = self.knots, self.values, self.curvatures
        # A sum of comparisons instead of a search: knots are few.
        piece = jnp.sum(index >= x[1:-1])
        x0, x1, y0, y1 = x[piece], x[piece + 1], y[piece], y[piece + 1]
        m0, m1 = m[piece], m[piece + 1]
        width = x1 - x0
        a, b = (x1 - index) / width, (index - x0) / width
        sixth = width / 6.0
        value = a * y0 + b * y1 + ((a**3 - a) * m0 + (b**3 - b) * m1) * (width * sixth)
        first = (y1 - y0) / width + (
            (3.0 * b**2 - 1.0) * m1 - (3.0 * a**2 - 1.0) * m0
        ) * sixth
        return value, first, a * m0 + b * m1


def cubic_spline(knots: Vector, values: Vector) -> CubicSpline:
    """Spline whose third derivative is continuous at the second and the last but one knot.

    With this end condition ("not-a-knot") values of a cubic give that cubic. The spline is
    differentiable in knots and values.

    **Raises:** `ValueError` for fewer than four knots, or for a different number of values.
    """
    x, y = jnp.asarray(knots, float), jnp.asarray(values, float)
    if x.ndim != 1 or x.shape[0] < 4 or x.shape != y.shape:
        raise ValueError(
            f"the spline has knots of shape {x.shape} and values of shape {y.shape}: "
            "expected (n,) of both, with n of 4 or more"
        )
    return CubicSpline(x, y, _bends(x, y))


@jax.jit
def _bends(x: Vector, y: Vector) -> Vector:
    """Second derivatives at the knots. Compiled, since it has some forty operations."""
    n, h = x.shape[0], jnp.diff(x)
    slopes = jnp.diff(y) / h
    inside = jnp.arange(1, n - 1)
    system = jnp.zeros((n, n))
    system = system.at[inside, inside - 1].set(h[:-1])
    system = system.at[inside, inside].set(2.0 * (h[:-1] + h[1:]))
    system = system.at[inside, inside + 1].set(h[1:])
    system = system.at[0, :3].set(jnp.stack([-h[1], h[0] + h[1], -h[0]]))
    system = system.at[-1, -3:].set(jnp.stack([-h[-1], h[-2] + h[-1], -h[-2]]))
    right = jnp.zeros(n).at[inside].set(6.0 * jnp.diff(slopes))
    return jnp.linalg.solve(system, right)


class BSpline(AbstractProfile):
    """Cubic B-spline, twice continuously differentiable and linear in its coefficients.

    Each coefficient acts on at most four neighbouring cubics. The value lies between the
    least and the largest coefficient, so bounds of the coefficients are bounds of the
    profile. The first and the last coefficient are the values at the ends; beyond the ends
    the profile is constant.

        BSpline(jnp.full(40, 0.3), jnp.linspace(last_energy, first_energy, 38))

    Reference: C. de Boor, "A Practical Guide to Splines", 2001, chapters IX and X.
    """

    coefficients: Vector = table()
    """Shape (n,)"""
    breakpoints: Vector = table(increasing=True)
    """Points at which the cubics join, with both ends, shape (n - 2,)"""

    def __check_init__(self):
        coefficients, breakpoints = self.coefficients.shape, self.breakpoints.shape
        if len(breakpoints) != 1 or breakpoints[0] < 2:
            raise ValueError(f"breakpoints has shape {breakpoints}: two are the least")
        if coefficients != (breakpoints[0] + 2,):
            raise ValueError(
                f"coefficients has shape {coefficients}: {breakpoints[0]} breakpoints "
                f"have {breakpoints[0] + 2}"
            )

    @property
    def nodes(self) -> Float[Array, " n"]:
        """Places of the coefficients, shape (n,): with these values as coefficients the
        profile equals the index."""
        knots = _clamped(self.breakpoints)
        return (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return derivatives_along(jnp.ones_like, self._value, index)

    def _value(self, index: Scalar) -> Scalar:
        ends = self.breakpoints[0], self.breakpoints[-1]
        x, knots = clamp(index, *ends), _clamped(self.breakpoints)
        piece = interval(self.breakpoints, x)
        near = [knots[piece + j] for j in range(1, 7)]
        values = [self.coefficients[piece + j] for j in range(4)]
        for width in (3, 2, 1):  # de Boor's recursion: between knots closer to x
            values = [
                low + (x - start) / (end - start) * (high - low)
                for low, high, start, end in zip(
                    values[:-1],
                    values[1:],
                    near[3 - width : 3],
                    near[3 : 3 + width],
                    strict=True,
                )
            ]
        return values[0]


def _clamped(breakpoints: Vector) -> Float[Array, " knots"]:
    """Knots: the breakpoints, with each end four times."""
    first, last = breakpoints[:1], breakpoints[-1:]
    return jnp.concatenate([first, first, first, breakpoints, last, last, last])
