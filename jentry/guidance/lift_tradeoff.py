"""The lift within its limits that comes nearest to two required components.

A law that tracks a ground track requires two components of the lift: `above`, in the
vertical plane, and `right`, across it. With the lift between two bounds and the bank
within a limit to either side, the feasible lift vectors form a sector of a ring. The lift
L and the bank s are those in the sector that minimise

    eta (L cos s - above)^2 + (1 - eta) (L sin s - right)^2,

equation (54) of S. Bharadwaj, A. V. Rao, K. D. Mease, "Entry Trajectory Tracking Law via
Feedback Linearization", Journal of Guidance, Control, and Dynamics 21(5), 1998.

All candidates for the minimum are evaluated, without a branch: the inside, the two arcs
and the two straight edges with their corners.
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
    """A specific lift and its bank."""

    lift: Scalar
    """m/s2"""
    cos_bank: Scalar
    sin_bank: Scalar


class LiftBounds(eqx.Module):
    """Feasible lift vectors: a sector of a ring."""

    least: Scalar
    """Smallest specific lift, m/s2, positive"""
    largest: Scalar
    """Largest specific lift, m/s2"""
    largest_bank: Scalar
    """Largest bank to either side, rad, below half a turn"""


class AbstractTradeoff(eqx.Module):
    """Rule for the compromise between two components of the lift if both are infeasible."""

    @abstractmethod
    def nearest(self, above: Scalar, right: Scalar, bounds: LiftBounds) -> Lift:
        """The lift within bounds that is nearest to two components (m/s2)."""


class EqualTradeoff(AbstractTradeoff):
    """Both components have the same weight, eta = 0.5: the nearest point of the sector."""

    def nearest(self, above: Scalar, right: Scalar, bounds: LiftBounds) -> Lift:
        least, largest = bounds.least, bounds.largest
        sin_most, cos_most = sincos(bounds.largest_bank)
        total, cosine, sine = _polar(above, right)
        inside = cosine >= cos_most
        # Beyond the limit of the bank the edge on the same side is nearer.
        sine_there = jnp.where(right < 0.0, -sin_most, sin_most)
        along = above * cos_most + right * sine_there
        return Lift(
            jnp.clip(jnp.where(inside, total, along), least, largest),
            jnp.where(inside, cosine, cos_most),
            jnp.where(inside, sine, sine_there),
        )


class WeightedTradeoff(AbstractTradeoff):
    """The vertical component has the weight eta and the horizontal one 1 - eta."""

    eta: Scalar = scalar(range=(0.001, 0.999))
    """Weight of the component in the vertical plane. At 0 and at 1 one of the components
    would have no weight, and the nearest lift would not be unique"""

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
"""Steps of Newton's method on a convex function that is at most one at the start"""
_TINY = 1e-12
"""Smallest magnitude of a component in units of the lift; an exact zero has no sign"""


def _stationary(
    above: Scalar, right: Scalar, up: Scalar, across: Scalar
) -> list[tuple[Scalar, Scalar]]:
    """Cosine and sine at stationary distances of the unit circle to a point, as weighted.

    The largest distance is left out. With the multiplier m of cos^2 + sin^2 = 1 the
    solutions are cos = up above / (up + m) and sin = across right / (across + m). For m
    beyond both poles the sum of their squares falls as m grows; where it is one is the
    nearest point. Between the poles the sum is convex. It is one at two places or at none,
    one on each side of its minimum. Newton's method starts where one of the squares alone
    is one, and from there it converges from one side. Whatever the result, its direction
    is feasible.
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
        # In a loop, whose result is one number for all later uses: near a pole two separate
        # computations of it would round to different directions.
        m = lax.stop_gradient(newton(excess, lax.stop_gradient(start), _STEPS).x)
        value, slope = excess(m)
        slope = lax.stop_gradient(jnp.where(slope == 0.0, 1.0, slope))
        # The derivative of the implicit function; the value is not changed.
        step = value / slope
        m = m - (step - lax.stop_gradient(step))
        first, second = up + m, across + m
        # A search without a result may have diverged.
        size = jnp.maximum(jnp.abs(first), jnp.abs(second))
        size = jnp.where(size == 0.0, 1.0, size)
        first, second = first / size, second / size
        side = jnp.where(first * second < 0.0, -1.0, 1.0)
        cosine, sine = side * up * above * second, side * across * right * first
        return _polar(cosine, sine)[1:]

    cosines, sines = map(jnp.asarray, jax.vmap(direction)(jnp.stack(starts)))
    return [(cosines[k], sines[k]) for k in range(len(starts))]


def _polar(above: Scalar, right: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Length, cosine and sine; straight up for zero length."""
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
