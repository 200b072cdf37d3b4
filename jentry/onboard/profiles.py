"""Profiles: smooth functions of one index, such as drag over energy."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interpolation import clamp
from .._math import horner
from ..fields import Scalar, Vector, scalar, table


class AbstractProfile(eqx.Module):
    """A twice differentiable function of one variable."""

    @abstractmethod
    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Value, first and second derivative, consistent with each other to rounding."""

    def __call__(self, index: Scalar) -> Scalar:
        return self.with_derivatives(index)[0]


class PolynomialProfile(AbstractProfile):
    """Polynomial in (index - origin) / span, lowest power first."""

    coefficients: Vector = table()
    origin: Scalar = scalar(0.0)
    span: Scalar = scalar(1.0)

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        def value(x):
            return horner(list(self.coefficients)[::-1], (x - self.origin) / self.span)

        def first(x):
            return jax.jvp(value, (x,), (jnp.ones_like(x),))

        (p, p1), (_, p2) = jax.jvp(first, (index,), (jnp.ones_like(index),))
        return p, p1, p2


class QuinticProfile(AbstractProfile):
    """Quintic Hermite interpolation on a uniform grid: twice continuously differentiable.

    Made from nodes by `quintic_profile`. Beyond the grid it goes on as the parabola with
    the same value and derivatives as at the end.
    """

    coefficients: Float[Array, "intervals 6"] = table()
    """Of each interval, over its own coordinate in [0, 1], highest power first"""
    start: Scalar = scalar()
    spacing: Scalar = scalar()
    """Negative where the index falls along the flight"""

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        intervals = self.coefficients.shape[0]
        per_spacing = 1.0 / self.spacing
        position = (index - self.start) * per_spacing
        inside = clamp(position, 0.0, float(intervals))
        interval = jnp.clip(jnp.floor(inside), 0, intervals - 1)
        x = inside - interval
        place = interval.astype(jnp.int32)
        # A gather for each column keeps the flights of a batch next to each other.
        columns = self.coefficients.T
        c = [column.at[place].get(mode="clip") for column in columns]
        p = horner(c, x)
        p1 = horner([5.0 * c[0], 4.0 * c[1], 3.0 * c[2], 2.0 * c[3], c[4]], x)
        p2 = horner([20.0 * c[0], 12.0 * c[1], 6.0 * c[2], 2.0 * c[3]], x)
        beyond = position - inside
        p = p + beyond * (p1 + 0.5 * beyond * p2)
        p1 = p1 + beyond * p2
        return p, p1 * per_spacing, p2 * (per_spacing * per_spacing)


def quintic_profile(
    start: Scalar,
    spacing: Scalar,
    value: Float[Array, " nodes"],
    first: Float[Array, " nodes"],
    second: Float[Array, " nodes"],
) -> QuinticProfile:
    """Profile through exact nodes, each with its two derivatives, on a uniform grid."""
    p, d, s = value, first * spacing, second * spacing * spacing
    rise = p[1:] - p[:-1] - d[:-1] - 0.5 * s[:-1]
    slope = d[1:] - d[:-1] - s[:-1]
    bend = s[1:] - s[:-1]
    coefficients = [
        6.0 * rise - 3.0 * slope + 0.5 * bend,
        -15.0 * rise + 7.0 * slope - bend,
        10.0 * rise - 4.0 * slope + 0.5 * bend,
        0.5 * s[:-1],
        d[:-1],
        p[:-1],
    ]
    return QuinticProfile(jnp.stack(coefficients, axis=1), start, spacing)
