"""Steer across the entry plane: predicted crossrange, and when to reverse the bank."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..world.planet import Planet
from .switching import AbstractSwitching, Sharp


class LateralCorridor(eqx.Module):
    """Where a predicted crossrange is left alone: |crossrange| < floor + widening V^2.

    It narrows along the flight as what one bank can still change does, so that the
    reversals spread over the flight: a wide corridor has few, a low floor ends close.
    """

    floor: Scalar = scalar(unit="m", positive=True)
    widening: Scalar = scalar(0.0, unit="s2/m")

    def half_width(self, velocity: Scalar) -> Scalar:
        """m"""
        return self.floor + self.widening * velocity * velocity


def reverse_bank(
    sign: Scalar,
    crossrange: Scalar,
    half_width: Scalar,
    switching: AbstractSwitching = Sharp(),
) -> Scalar:
    """Sign of the bank for a predicted crossrange miss (m, positive to the left).

    Inside the corridor the sign stays. Outside it turns back: to the right, which is
    positive, if the miss is to the left. A discrete choice, and so without derivative,
    unless the switching is `Smooth` or `SmoothReversals`; then the sign takes values
    between the two.
    """
    turning_back = jnp.where(crossrange > 0.0, 1.0, -1.0)
    return switching.reversed(sign, turning_back, jnp.abs(crossrange) - half_width)


def predicted_crossrange(
    planet: Planet, origin: EntryState, state: EntryState, distance: Scalar
) -> Scalar:
    """Crossrange after a distance (m) along the great circle that is flown now, m.

    Counted from the origin as in `ground_track`; to first order in the crossrange, which
    is small beside the planet's radius.
    """
    sin_heading, cos_heading = sincos(state.heading)
    _, cos_latitude = sincos(state.latitude)

    def crossrange(longitude, latitude):
        here = eqx.tree_at(
            lambda s: (s.longitude, s.latitude), state, (longitude, latitude)
        )
        return ground_track(planet, origin, here)[1]

    ahead = sin_heading / cos_latitude, cos_heading
    now, slope = jax.jvp(crossrange, (state.longitude, state.latitude), ahead)
    sine, cosine = sincos(distance / planet.radius)
    return now * cosine + slope * sine
