"""The lift within its limits that comes nearest to what two objectives ask for.

A law that tracks a ground track asks for two components of the lift: `above`, in the
vertical plane, and `right`, across it. With the lift between two bounds and the bank
within a limit to either side, what can be flown is a sector of a ring, and the lift L and
the bank s in it are those with the smallest

    eta (L cos s - above)^2 + (1 - eta) (L sin s - right)^2,

equation (54) of S. Bharadwaj, A. V. Rao, K. D. Mease, "Entry Trajectory Tracking Law via
Feedback Linearization", Journal of Guidance, Control, and Dynamics 21(5), 1998.

All places where the smallest value can lie are looked at, without a branch: the inside,
the two arcs and the two straight edges with their corners.
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._math import sincos
from .._newton import newton
from ..fields import Flag, Scalar, scalar


class Lift(eqx.Module):
    """A specific lift, and the bank at which it is flown."""

    lift: Scalar
    """m/s2"""
    cos_bank: Scalar
    sin_bank: Scalar


class LiftBounds(eqx.Module):
    """What can be flown: a ring sector."""

    least: Scalar
    """Smallest specific lift, m/s2, positive"""
    largest: Scalar
    """Largest specific lift, m/s2"""
    largest_bank: Scalar
    """To either side, rad, below half a turn"""


class AbstractTradeoff(eqx.Module):
    """Which of two components of the lift is given up where not both can be flown."""

    @abstractmethod
    def nearest(self, above: Scalar, right: Scalar, bounds: LiftBounds) -> Lift:
        """The lift within bounds that is nearest to two components, m/s2."""


class EqualTradeoff(AbstractTradeoff):
    """Both components count the same, eta = 0.5: the nearest point of a ring sector."""

    def nearest(self, above: Scalar, right: Scalar, bounds: LiftBounds) -> Lift:
        least, largest = bounds.least, bounds.largest
        sin_most, cos_most = sincos(bounds.largest_bank)
        total, cosine, sine = _polar(above, right)
        inside = cosine >= cos_most
        # Beyond the limit of the bank the edge on the same side is the nearer one.
        sine_there = jnp.where(right < 0.0, -sin_most, sin_most)
        along = above * cos_most + right * sine_there
        return Lift(
            jnp.clip(jnp.where(inside, total, along), least, largest),
            jnp.where(inside, cosine, cos_most),
            jnp.where(inside, sine, sine_there),
        )


class WeightedTradeoff(AbstractTradeoff):
    """The vertical component counts eta and the horizontal one 1 - eta."""

    eta: Scalar = scalar(range=(0.001, 0.999))
    """Weight of the component in the vertical plane. At 0 and at 1 one of the components
    would not count at all, and there would be no nearest lift"""

    def nearest(self, above: Scalar, right: Scalar, bounds: LiftBounds) -> Lift:
        least, largest = bounds.least, bounds.largest
        up, across = self.eta, 1.0 - self.eta
        sin_most, cos_most = sincos(bounds.largest_bank)

        def cost(flown: Lift) -> Scalar:
            missed_above = flown.lift * flown.cos_bank - above
            missed_right = flown.lift * flown.sin_bank - right
            return up * missed_above**2 + across * missed_right**2

        def edge(sine: Scalar) -> Lift:
            wanted = up * above * cos_most + across * right * sine
            lift = wanted / (up * cos_most**2 + across * sine**2)
            return Lift(jnp.clip(lift, least, largest), cos_most, sine)

        best = edge(jnp.where(right < 0.0, -sin_most, sin_most))
        total, cosine, sine = _polar(above, right)
        others = [Lift(total, cosine, sine)]
        for lift in (least, largest):
            others += [
                Lift(lift, *direction)
                for direction in _stationary(above / lift, right / lift, up, across)
            ]
        for other in others:
            allowed = (other.lift >= least) & (other.lift <= largest)
            allowed &= other.cos_bank >= cos_most
            best = _select(allowed & (cost(other) < cost(best)), other, best)
        return best


_STEPS = 12
"""Of Newton's method on a convex function that is at most one where it begins"""
_TINY = 1e-12
"""Of components in units of the lift; an exact zero has no side"""


def _stationary(
    above: Scalar, right: Scalar, up: Scalar, across: Scalar
) -> list[tuple[Scalar, Scalar]]:
    """Cosine and sine where the distance of a unit circle to a point is stationary.

    Not where it is largest. With the multiplier m of cos^2 + sin^2 = 1 these are cos =
    up above / (up + m) and sin = across right / (across + m), and the sum of their
    squares falls to one as m grows beyond both poles: the nearest point. Between the
    poles it is convex, and is one at two places or at none, each on a side of its
    minimum. Newton's method begins where one of the squares is one already: from there
    it comes nearer from one side. Whatever it ends at, its direction can be flown.
    """
    above = jnp.where(jnp.abs(above) < _TINY, _TINY, above)
    right = jnp.where(jnp.abs(right) < _TINY, _TINY, right)

    def excess(m: Scalar) -> tuple[Scalar, Scalar]:
        cosine, sine = up * above / (up + m), across * right / (across + m)
        slope = cosine**2 / (up + m) + sine**2 / (across + m)
        return cosine**2 + sine**2 - 1.0, -2.0 * slope

    size_above, size_right = jnp.abs(above), jnp.abs(right)
    up_is_less = up < across
    less, more = jnp.minimum(up, across), jnp.maximum(up, across)
    at_less = jnp.where(up_is_less, size_above, size_right)
    at_more = jnp.where(up_is_less, size_right, size_above)
    starts = [
        jnp.maximum(less * (at_less - 1.0), more * (at_more - 1.0)),
        more * (at_more - 1.0),
        -less * (at_less + 1.0),
    ]

    def direction(start: Scalar) -> tuple[Scalar, Scalar]:
        # In a loop, whose result is one number for all that is made of it: near a pole
        # two computations of it would round to different directions.
        m = lax.stop_gradient(newton(excess, lax.stop_gradient(start), _STEPS).x)
        value, slope = excess(m)
        slope = lax.stop_gradient(jnp.where(slope == 0.0, 1.0, slope))
        # The derivative of the implicit function; its value moves nothing.
        step = value / slope
        m = m - (step - lax.stop_gradient(step))
        first, second = up + m, across + m
        # A search that found nothing may have gone anywhere.
        size = jnp.maximum(jnp.abs(first), jnp.abs(second))
        size = jnp.where(size == 0.0, 1.0, size)
        first, second = first / size, second / size
        side = jnp.where(first * second < 0.0, -1.0, 1.0)
        cosine, sine = side * up * above * second, side * across * right * first
        return _polar(cosine, sine)[1:]

    cosines, sines = map(jnp.asarray, jax.vmap(direction)(jnp.stack(starts)))
    return [(cosines[k], sines[k]) for k in range(len(starts))]


def _polar(above: Scalar, right: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Length, cosine and sine; straight up for a length of zero."""
    square = above * above + right * right
    nothing = square == 0.0
    total = jnp.sqrt(jnp.where(nothing, 1.0, square))
    cosine = jnp.where(nothing, 1.0, above / total)
    return jnp.where(nothing, 0.0, total), cosine, right / total


def _select(condition: Flag, chosen: Lift, otherwise: Lift) -> Lift:
    return Lift(
        jnp.where(condition, chosen.lift, otherwise.lift),
        jnp.where(condition, chosen.cos_bank, otherwise.cos_bank),
        jnp.where(condition, chosen.sin_bank, otherwise.sin_bank),
    )
