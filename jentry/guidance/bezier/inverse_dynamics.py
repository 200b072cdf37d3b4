"""Accelerations that a path requires: the equations of motion solved for the forces.

Source: Zhou, Rahman and Chen 2014, equations (14) to (22), corrected. The latitude and
longitude of the paper are the coordinates of a track here.
"""

import equinox as eqx
import jax.numpy as jnp

from ..._math import sincos
from ...fields import Scalar
from ...motion.state import EntryState
from ...onboard.track import TrackPosition
from ...world.planet import Planet
from .curve import PathPoint


class Directions(eqx.Module):
    """Direction of the velocity at a point of a path."""

    cos_path: Scalar
    """Cosine of the flight-path angle; `sin_path` is its sine"""
    tan_path: Scalar
    cos_heading: Scalar
    """Cosine of the heading from the track; `sin_heading` is its sine"""
    tan_heading: Scalar


class Acceleration(eqx.Module):
    """Specific force normal to the velocity, m/s2."""

    vertical: Scalar
    """Upwards, in the vertical plane of the velocity"""
    lateral: Scalar
    """To the right"""


def path_point(planet: Planet, place: TrackPosition, state: EntryState) -> PathPoint:
    """Point and tangent of the path of a vehicle in this state, equations (14), (15)."""
    sin_path, cos_path = sincos(state.flight_path_angle)
    _, cos_along = sincos(place.along)
    per_cos_heading = 1.0 / place.cos_heading
    return PathPoint(
        along=place.along,
        altitude=state.altitude,
        cross=place.cross,
        altitude_slope=(planet.radius + state.altitude)
        * (sin_path / cos_path)
        * per_cos_heading,
        cross_slope=place.sin_heading * per_cos_heading / cos_along,
    )


def directions(planet: Planet, point: PathPoint) -> Directions:
    """Direction of the velocity along a path, from equations (14) and (15)."""
    _, cos_along = sincos(point.along)
    tan_heading = point.cross_slope * cos_along
    cos_heading = 1.0 / jnp.sqrt(1.0 + tan_heading * tan_heading)
    tan_path = point.altitude_slope * cos_heading / (planet.radius + point.altitude)
    return Directions(
        cos_path=1.0 / jnp.sqrt(1.0 + tan_path * tan_path),
        tan_path=tan_path,
        cos_heading=cos_heading,
        tan_heading=tan_heading,
    )


def seconds_per_radian(radius: Scalar, velocity: Scalar, towards: Directions) -> Scalar:
    """Derivative of the time with respect to the angle along the track, s/rad."""
    return radius / (velocity * towards.cos_path * towards.cos_heading)


def required_acceleration(
    planet: Planet,
    point: PathPoint,
    second_slopes: tuple[Scalar, Scalar],
    velocity: Scalar,
) -> Acceleration:
    """Acceleration to fly a curve at a velocity (m/s): equations (19) to (22), corrected.

    **Arguments:**

    - `second_slopes`: second derivatives of altitude (m/rad2) and cross-track angle (1/rad)
      over the angle along the track.
    """
    rise, drift = point.altitude_slope, point.cross_slope
    bend, aside = second_slopes
    at = directions(planet, point)
    sin_along, cos_along = sincos(point.along)
    radius = planet.radius + point.altitude
    # (22) and (21): rates of heading and flight-path angle along the track.
    turn = at.cos_heading**2 * (aside * cos_along - drift * sin_along)
    pitch = (
        at.cos_path**2
        * at.cos_heading
        * (bend - rise * (turn * at.tan_heading + rise / radius))
        / radius
    )
    square = velocity * velocity / radius
    gravity = planet.gravity.acceleration(radius)
    return Acceleration(
        vertical=pitch * square * at.cos_path * at.cos_heading
        + (gravity - square) * at.cos_path,
        lateral=(turn - at.tan_heading * sin_along / cos_along)
        * square
        * at.cos_path**2
        * at.cos_heading,
    )
