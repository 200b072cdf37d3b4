"""States and measurements for tests of lateral logic."""

import equinox as eqx
import jax.numpy as jnp
from helpers import mars_entry

from jentry.motion import EntryState
from jentry.onboard import Measurement
from jentry.units import degree


ORIGIN = eqx.tree_at(
    lambda s: (s.longitude, s.latitude, s.heading),
    mars_entry(),
    tuple(jnp.asarray(x * degree) for x in (20.0, 35.0, 60.0)),
)


def after(planet, state, distance):
    """The point at a distance along the great circle: the textbook formula."""
    angle = distance / planet.radius
    latitude = jnp.arcsin(
        jnp.sin(state.latitude) * jnp.cos(angle)
        + jnp.cos(state.latitude) * jnp.sin(angle) * jnp.cos(state.heading)
    )
    longitude = state.longitude + jnp.arctan2(
        jnp.sin(state.heading) * jnp.sin(angle) * jnp.cos(state.latitude),
        jnp.cos(angle) - jnp.sin(state.latitude) * jnp.sin(latitude),
    )
    return eqx.tree_at(
        lambda s: (s.longitude, s.latitude), state, (longitude, latitude)
    )


def headed(state: EntryState, angle):
    return eqx.tree_at(lambda s: s.heading, state, state.heading + angle)


TIME = jnp.asarray(3.0)


def seen(state: EntryState) -> Measurement:
    one = jnp.asarray(1.0)
    return Measurement(state, one, one, 0.0 * one, 0.0 * one)
