"""The great circle from start to target, and the position of a vehicle relative to it."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from .._math import sincos
from ..fields import QUARTER, Scalar, scalar
from ..motion.state import EntryState


Direction = tuple[Scalar, Scalar, Scalar]

_LONG = 1.4
"""rad; a longer track has its middle on the equator of its coordinates."""


_LONGEST = 2.8
"""rad"""


class TrackPosition(eqx.Module):
    """Place and horizontal direction of flight relative to a track."""

    along: Scalar
    """Angle along the track, rad; latitude on the rotated globe"""
    cross: Scalar
    """Angle off the track, rad, positive to the right; longitude on the rotated globe"""
    cos_heading: Scalar
    """Cosine of the heading from the direction of the track, clockwise"""
    sin_heading: Scalar


class Track(eqx.Module):
    """Curvilinear coordinates about the great circle from one point to another.

    The coordinates are latitude and longitude on a globe that is rotated such that the
    track is its prime meridian, northwards from the equator. A track of more than 80
    degrees has its middle on the equator. The coordinates are therefore regular along the
    whole track, also over a pole and at any heading, up to 160 degrees of arc. For a track
    from the equator due north they are latitude and longitude themselves.
    """

    start_longitude: Scalar = scalar(unit="rad")
    start_latitude: Scalar = scalar(unit="rad", range=QUARTER)
    target_longitude: Scalar = scalar(unit="rad")
    target_latitude: Scalar = scalar(unit="rad", range=QUARTER)

    def __check_init__(self):
        angles = jax.tree.leaves(self)
        if len(angles) < 4 or any(isinstance(x, Tracer | str) for x in angles):
            return
        with jax.ensure_compile_time_eval():
            length = float(self.length())
        if not 1e-9 < length < _LONGEST:
            raise ValueError(
                f"the track is {math.degrees(length):g} deg long: start and target must "
                f"be apart, by {math.degrees(_LONGEST):g} deg at most"
            )

    def length(self) -> Scalar:
        """Angle from start to target, rad."""
        north, out, _ = self._axes_at_start()
        target = _upwards(self.target_longitude, self.target_latitude)
        return jnp.arctan2(_dot(target, north), _dot(target, out))

    def position(self, state: EntryState) -> TrackPosition:
        """Position of a state along and across the track."""
        north, out, east = self._axes()
        place = _upwards(state.longitude, state.latitude)
        sin_along, x, y = (_dot(place, axis) for axis in (north, out, east))
        cos_along = jnp.sqrt(x * x + y * y)
        cos_cross, sin_cross = x / cos_along, y / cos_along
        heading = _horizontally(state.longitude, state.latitude, state.heading)
        to_north, outwards, to_east = (
            _dot(heading, axis) for axis in (north, out, east)
        )
        return TrackPosition(
            along=jnp.arctan2(sin_along, cos_along),
            cross=jnp.arctan2(y, x),
            cos_heading=cos_along * to_north
            - sin_along * (cos_cross * outwards + sin_cross * to_east),
            sin_heading=cos_cross * to_east - sin_cross * outwards,
        )

    def to_go(self, state: EntryState) -> Scalar:
        """Sine of the angle to the plane across the track through the target.

        It is positive before the target, up to half of the globe away.
        """
        north, out, _ = self._axes_at_start()
        target = _upwards(self.target_longitude, self.target_latitude)
        cos_length, sin_length = _dot(target, out), _dot(target, north)
        place = _upwards(state.longitude, state.latitude)
        return sin_length * _dot(place, out) - cos_length * _dot(place, north)

    def _axes_at_start(self) -> tuple[Direction, Direction, Direction]:
        """Unit vectors along the track, upwards, and to the right, at the start."""
        up = _upwards(self.start_longitude, self.start_latitude)
        target = _upwards(self.target_longitude, self.target_latitude)
        right = _cross(target, up)
        per_length = 1.0 / jnp.sqrt(_dot(right, right))
        right = right[0] * per_length, right[1] * per_length, right[2] * per_length
        return _cross(up, right), up, right

    def _axes(self) -> tuple[Direction, Direction, Direction]:
        """Axes of the rotated globe: to the pole, to longitude and latitude 0, and east."""
        north, out, east = self._axes_at_start()
        length = self.length()
        sine, cosine = sincos(jnp.where(length > _LONG, 0.5 * length, 0.0))
        return (
            _turned(north, out, cosine, -sine),
            _turned(out, north, cosine, sine),
            east,
        )


def _upwards(longitude: Scalar, latitude: Scalar) -> Direction:
    sin_longitude, cos_longitude = sincos(longitude)
    sin_latitude, cos_latitude = sincos(latitude)
    return cos_latitude * cos_longitude, cos_latitude * sin_longitude, sin_latitude


def _horizontally(longitude: Scalar, latitude: Scalar, heading: Scalar) -> Direction:
    sin_longitude, cos_longitude = sincos(longitude)
    sin_latitude, cos_latitude = sincos(latitude)
    sin_heading, cos_heading = sincos(heading)
    return (
        -cos_heading * sin_latitude * cos_longitude - sin_heading * sin_longitude,
        -cos_heading * sin_latitude * sin_longitude + sin_heading * cos_longitude,
        cos_heading * cos_latitude,
    )


def _turned(a: Direction, b: Direction, cosine: Scalar, sine: Scalar) -> Direction:
    return (
        cosine * a[0] + sine * b[0],
        cosine * a[1] + sine * b[1],
        cosine * a[2] + sine * b[2],
    )


def _dot(a: Direction, b: Direction) -> Scalar:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Direction, b: Direction) -> Direction:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
