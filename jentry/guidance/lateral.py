"""Steer across the entry plane: predicted crossrange, and when to reverse the bank."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._math import sincos
from .._types import Scalar, scalar
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..world.planet import Planet


class LateralCorridor(eqx.Module):
    """Half the width within which a predicted crossrange is left alone.

    It narrows with the velocity, as the lift that is left to correct it does.
    """

    floor: Scalar = scalar(unit="m", positive=True)
    """At rest"""
    widening: Scalar = scalar(0.0, unit="s")
    """m of half width for each m/s of velocity"""

    def half_width(self, velocity: Scalar) -> Scalar:
        """m"""
        return self.floor + self.widening * velocity


def reverse_bank(sign: Scalar, crossrange: Scalar, half_width: Scalar) -> Scalar:
    """Sign of the bank for a predicted crossrange miss (m, positive to the left).

    Inside the corridor the sign stays; outside it turns back: positive, to the right, if
    the miss is to the left. A discrete choice, and as such without derivative.
    """
    back = jnp.where(crossrange > 0.0, 1.0, -1.0)
    chosen = jnp.where(jnp.abs(crossrange) > half_width, back, sign)
    return lax.stop_gradient(chosen)


def predicted_crossrange(
    planet: Planet, origin: EntryState, state: EntryState, distance: Scalar
) -> Scalar:
    """Crossrange where the great circle now flown leads after a distance, m.

    To first order in the crossrange, which is small beside the planet's radius. Signed
    and counted from the origin as in `ground_track`.
    """
    sin_heading, cos_heading = sincos(state.heading)
    _, cos_latitude = sincos(state.latitude)

    def crossrange(longitude, latitude):
        here = eqx.tree_at(
            lambda s: (s.longitude, s.latitude), state, (longitude, latitude)
        )
        return ground_track(planet, origin, here)[1]

    along_heading = sin_heading / cos_latitude, cos_heading
    now, slope = jax.jvp(crossrange, (state.longitude, state.latitude), along_heading)
    sine, cosine = sincos(distance / planet.radius)
    return now * cosine + slope * sine
