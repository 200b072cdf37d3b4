"""Geodetic coordinates of a state over an ellipsoid, and the state that has them."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .._math import sincos
from ..fields import QUARTER, Scalar, check_values, scalar
from ..world.planet import Planet
from ..world.shape import Sphere
from .state import EntryState


class GeodeticState(eqx.Module):
    """A state whose altitude, latitude and angles refer to the shape of the planet.

    Up is along the normal of the ellipsoid, as in most published initial conditions. The
    velocity is relative to the planet, as that of `EntryState`.
    """

    altitude: Scalar = scalar(unit="m")
    """Geodetic altitude"""
    longitude: Scalar = scalar(unit="rad")
    latitude: Scalar = scalar(unit="rad", range=QUARTER)
    """Geodetic latitude"""
    velocity: Scalar = scalar(unit="m/s")
    flight_path_angle: Scalar = scalar(unit="rad", range=QUARTER)
    """Angle of the velocity above the plane that is normal to the ellipsoid's normal"""
    heading: Scalar = scalar(unit="rad")
    """Clockwise from north, in that plane"""


def geodetic_position(planet: Planet, state: EntryState) -> tuple[Scalar, Scalar]:
    """Geodetic altitude (m) and latitude (rad); on a sphere those of the state."""
    if isinstance(planet.shape, Sphere):
        return state.altitude, state.latitude
    return planet.shape.geodetic(planet.radius + state.altitude, state.latitude)


def to_geodetic(planet: Planet, state: EntryState) -> GeodeticState:
    """Geodetic coordinates of a state.

    The angles have no derivative in vertical flight, where no heading exists.
    """
    altitude, latitude = geodetic_position(planet, state)
    path, heading = _tilted(state, latitude - state.latitude)
    return GeodeticState(
        altitude, state.longitude, latitude, state.velocity, path, heading
    )


def from_geodetic(planet: Planet, geodetic: GeodeticState) -> EntryState:
    """The state with geodetic coordinates: the inverse of `to_geodetic`.

    **Raises:** `ValueError` for a number that is not finite or beyond its range, such as a
    latitude in degrees.

    start = from_geodetic(
        planet,
        GeodeticState(120e3, 0.0, 0.5, 7500.0, -1.5 * degree, 80.0 * degree),
    )
    """
    for field in dataclasses.fields(geodetic):
        value = getattr(geodetic, field.name)
        if not isinstance(value, Tracer):
            check_values(f"geodetic.{field.name}", np.asarray(value), field.metadata)
    altitude, latitude = geodetic.altitude, geodetic.latitude
    if not isinstance(planet.shape, Sphere):
        radius, latitude = planet.shape.geocentric(altitude, latitude)
        altitude = radius - planet.radius
    path, heading = _tilted(geodetic, latitude - geodetic.latitude)
    return EntryState(
        altitude, geodetic.longitude, latitude, geodetic.velocity, path, heading
    )


def _tilted(state: EntryState | GeodeticState, tilt: Scalar) -> tuple[Scalar, Scalar]:
    """Flight-path angle and heading after up has been tilted to the north, rad.

    The heading is that nearest to the heading of the state.
    """
    sin_path, cos_path = sincos(state.flight_path_angle)
    sin_heading, cos_heading = sincos(state.heading)
    sine, cosine = sincos(tilt)
    east, north = cos_path * sin_heading, cos_path * cos_heading
    north, up = north * cosine - sin_path * sine, sin_path * cosine + north * sine
    turn = jnp.arctan2(
        east * cos_heading - north * sin_heading,
        north * cos_heading + east * sin_heading,
    )
    level = jnp.sqrt(east * east + north * north)
    return jnp.arctan2(up, level), state.heading + turn
