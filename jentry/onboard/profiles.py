"""Profiles: smooth functions of one index, such as drag over energy."""

import functools
from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from .._interpolation import clamp, interval
from .._math import horner
from ..fields import Count, Scalar, Vector, scalar, table


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


class JoinedProfile(AbstractProfile):
    """Profiles one after another; where two meet the value may jump.

    Beyond the first and the last end it has the values there.
    """

    parts: tuple[AbstractProfile, ...]
    """Profiles, each between two of the ends"""
    ends: Vector = table(increasing=True)
    """Ends of the parts, shape (parts + 1,). At an end the part that begins there counts"""

    def __check_init__(self):
        if not self.parts or self.ends.shape != (len(self.parts) + 1,):
            raise ValueError(
                f"ends has shape {self.ends.shape}: {len(self.parts)} parts have one end "
                "more than there are parts"
            )

    def part(self, index: Scalar) -> Count:
        """Number of the part that counts at an index, from 0."""
        return interval(self.ends, index)

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        first, last = self.ends[0], self.ends[-1]
        inside = (index >= first) & (index <= last)
        at = jnp.where(index > last, last, jnp.where(index < first, first, index))
        chosen = self.parts[0].with_derivatives(at)
        for end, part in zip(self.ends[1:-1], self.parts[1:], strict=True):
            later = part.with_derivatives(at)
            chosen = tuple(
                jnp.where(index >= end, b, a)
                for a, b in zip(chosen, later, strict=True)
            )
        value, slope, bend = chosen
        return value, jnp.where(inside, slope, 0.0), jnp.where(inside, bend, 0.0)


class QuinticTable(eqx.Module):
    """Several quantities over one index, by quintic Hermite interpolation.

    The interpolation is twice continuously differentiable. `quintic_table` makes a table
    from nodes. Beyond the grid each quantity continues as the parabola with the value and
    derivatives at the end. The interval is found once for all quantities. Quantities that
    are not used cost nothing.

    Node k of n lies at the share (k / n)^`power` of the way from the first to the last.
    With a power of 1 the nodes are evenly spaced. With a power of 2 the first nodes are
    close together. This suits the energy, which hardly changes at the beginning of an
    entry while the drag grows by orders of magnitude.
    """

    coefficients: dict[str, Float[Array, "intervals 6"]]
    """Coefficients by quantity and interval, over the interval's coordinate in [0, 1],
    highest power first"""
    start: Scalar = scalar()
    spacing: Scalar = scalar()
    """Mean distance of the nodes; negative where the index falls along the flight"""
    power: int = eqx.field(default=1, static=True)

    def __check_init__(self):
        if self.power not in _POWERS:
            raise ValueError(f"power is {self.power}: it must be one of {_POWERS}")

    def with_derivatives(
        self, index: Scalar
    ) -> dict[str, tuple[Scalar, Scalar, Scalar]]:
        """Value, first and second derivative of each quantity, by name."""
        some = next(iter(self.coefficients.values()))
        place = _place(some.shape[0], self.start, self.spacing, self.power, index)
        return {
            name: _read(coefficients, *place)
            for name, coefficients in self.coefficients.items()
        }

    def profile(self, name: str) -> "QuinticProfile":
        """One of the quantities.

        **Raises:** `ValueError` for an unknown name.
        """
        if name not in self.coefficients:
            raise ValueError(
                f"there is no {name!r} in the table: it has {', '.join(self.coefficients)}"
            )
        return QuinticProfile(
            self.coefficients[name], self.start, self.spacing, self.power
        )


class QuinticProfile(AbstractProfile):
    """One quantity of a `QuinticTable`."""

    coefficients: Float[Array, "intervals 6"] = table()
    """Coefficients by interval, over its coordinate in [0, 1], highest power first"""
    start: Scalar = scalar()
    spacing: Scalar = scalar()
    """Mean distance of the nodes; negative where the index falls along the flight"""
    power: int = eqx.field(default=1, static=True)

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        intervals = self.coefficients.shape[0]
        place = _place(intervals, self.start, self.spacing, self.power, index)
        return _read(self.coefficients, *place)


_POWERS = 1, 2
"""Powers whose inverses cost little: none, and a square root"""


def _shares(intervals: int, power: int, number: Array) -> Array:
    """Place of a node between the first and the last, in units of the mean spacing."""
    return intervals * (number / intervals) ** power


def _place(
    intervals: int, start: Scalar, spacing: Scalar, power: int, index: Scalar
) -> tuple[Count, Scalar, Scalar, Scalar]:
    """Interval of an index, place in it, distance beyond the grid, one over its width.

    Place and distance are in units of the width of the interval.
    """
    per_spacing = 1.0 / spacing
    position = (index - start) * per_spacing
    inside = clamp(position, 0.0, float(intervals))
    if power == 1:
        interval = jnp.clip(jnp.floor(inside), 0, intervals - 1)
        x, beyond = inside - interval, position - inside
        return interval.astype(jnp.int32), x, beyond, per_spacing
    root = jnp.sqrt(lax.stop_gradient(inside) / intervals)
    interval = jnp.clip(jnp.floor(root * intervals), 0, intervals - 1)
    here = _shares(intervals, power, interval)
    per_width = 1.0 / (_shares(intervals, power, interval + 1.0) - here)
    x, beyond = (inside - here) * per_width, (position - inside) * per_width
    return interval.astype(jnp.int32), x, beyond, per_spacing * per_width


@jax.custom_jvp
def _quintic(x: Scalar, *c: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Polynomial of degree five with both derivatives; coefficients from the highest power.

    Its derivative is defined explicitly, since most of it is computed already. The tangents
    of a flight that tracks a table take a tenth less time, its reverse gradient a thirtieth
    less (`benchmarks/gradient.py`).
    """
    return (
        horner(c, x),
        horner([5.0 * c[0], 4.0 * c[1], 3.0 * c[2], 2.0 * c[3], c[4]], x),
        horner([20.0 * c[0], 12.0 * c[1], 6.0 * c[2], 2.0 * c[3]], x),
    )


@functools.partial(_quintic.defjvp, symbolic_zeros=True)
def _quintic_jvp(primals, tangents):
    (x, *c), (x_rate, *c_rates) = primals, tangents
    values = _quintic(x, *c)
    slopes = *values[1:], horner([60.0 * c[0], 24.0 * c[1], 6.0 * c[2]], x)
    # A zero tangent must not be multiplied: the product would not be left out.
    p, p1, p2 = (jnp.zeros_like(value) for value in values)
    if not isinstance(x_rate, SymbolicZero):
        p, p1, p2 = (slope * x_rate for slope in slopes)
    if not all(isinstance(rate, SymbolicZero) for rate in c_rates):
        c_rates = [
            jnp.zeros_like(a) if isinstance(rate, SymbolicZero) else rate
            for a, rate in zip(c, c_rates, strict=True)
        ]
        q, q1, q2 = _quintic(x, *c_rates)
        p, p1, p2 = p + q, p1 + q1, p2 + q2
    return values, (p, p1, p2)


def _read(
    coefficients: Float[Array, "intervals 6"],
    interval: Count,
    x: Scalar,
    beyond: Scalar,
    per_width: Scalar,
) -> tuple[Scalar, Scalar, Scalar]:
    # A gather for each column keeps the flights of a batch adjacent in memory.
    c = [column.at[interval].get(mode="clip") for column in coefficients.T]
    p, p1, p2 = _quintic(x, *c)
    p = p + beyond * (p1 + 0.5 * beyond * p2)
    p1 = p1 + beyond * p2
    return p, p1 * per_width, p2 * (per_width * per_width)


Nodes = tuple[Float[Array, " nodes"], Float[Array, " nodes"], Float[Array, " nodes"]]
"""Value, first and second derivative of a quantity at every node"""


def grid(
    start: Scalar, end: Scalar, intervals: int, power: int = 1
) -> Float[Array, " nodes"]:
    """Nodes of a `QuinticTable` from the first to the last."""
    if power == 1:
        return jnp.linspace(start, end, intervals + 1)
    shares = _shares(intervals, power, jnp.arange(intervals + 1.0)) / intervals
    return start + (end - start) * shares


def quintic_table(
    nodes: Float[Array, " nodes"], quantities: dict[str, Nodes], power: int = 1
) -> QuinticTable:
    """Table through exact nodes, which are those of `grid` with the same power."""
    intervals = nodes.shape[0] - 1
    if power == 1:
        spacing = widths = nodes[1] - nodes[0]
    else:
        spacing = (nodes[-1] - nodes[0]) / intervals
        numbers = jnp.arange(intervals + 1.0)
        widths = spacing * jnp.diff(_shares(intervals, power, numbers))
    coefficients = {
        name: _coefficients(widths, *values) for name, values in quantities.items()
    }
    return QuinticTable(coefficients, nodes[0], spacing, power)


def quintic_profile(
    start: Scalar,
    spacing: Scalar,
    value: Float[Array, " nodes"],
    first: Float[Array, " nodes"],
    second: Float[Array, " nodes"],
) -> QuinticProfile:
    """Profile through exact nodes, each with its two derivatives, on a uniform grid."""
    widths = jnp.asarray(spacing)
    coefficients = _coefficients(widths, value, first, second)
    return QuinticProfile(coefficients, start, spacing)


def _coefficients(
    widths: Array,
    value: Float[Array, " nodes"],
    first: Float[Array, " nodes"],
    second: Float[Array, " nodes"],
) -> Float[Array, "intervals 6"]:
    """Coefficients of the intervals; `widths` is one for all, or one for each."""
    p, d, s = value[:-1], first[:-1] * widths, second[:-1] * widths * widths
    d_end, s_end = first[1:] * widths, second[1:] * widths * widths
    rise = value[1:] - p - d - 0.5 * s
    slope = d_end - d - s
    bend = s_end - s
    coefficients = [
        6.0 * rise - 3.0 * slope + 0.5 * bend,
        -15.0 * rise + 7.0 * slope - bend,
        10.0 * rise - 4.0 * slope + 0.5 * bend,
        0.5 * s,
        d,
        p,
    ]
    return jnp.stack(coefficients, axis=1)
