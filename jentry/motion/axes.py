"""Axes in which vectors are resolved: of a velocity, of a place, and of the planet."""

import functools
import operator
from typing import NamedTuple

import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar
from .state import EntryState


Components = tuple[Scalar, Scalar, Scalar]

SineCosine = tuple[Scalar, Scalar]
"""Sine and cosine of an angle"""


class VelocityAxes(NamedTuple):
    """Axes along a velocity, above it in its vertical plane, and to its right."""

    sin_path: Scalar
    cos_path: Scalar
    sin_heading: Scalar
    cos_heading: Scalar

    @classmethod
    def of(cls, state: EntryState) -> "VelocityAxes":
        """The axes of the velocity relative to the planet."""
        return cls(*sincos(state.flight_path_angle), *sincos(state.heading))

    @classmethod
    def along(cls, east: Scalar, north: Scalar, up: Scalar) -> "VelocityAxes":
        """The axes of a velocity with these components, m/s."""
        ground = jnp.sqrt(east * east + north * north)
        speed = jnp.sqrt(east * east + north * north + up * up)
        return cls(up / speed, ground / speed, east / ground, north / ground)

    def to_local(self, along: Scalar, above: Scalar, right: Scalar) -> Components:
        """Components to the east, north and up of a vector in these axes."""
        ahead = along * self.cos_path - above * self.sin_path
        return (
            ahead * self.sin_heading + right * self.cos_heading,
            ahead * self.cos_heading - right * self.sin_heading,
            along * self.sin_path + above * self.cos_path,
        )

    def from_local(self, east: Scalar, north: Scalar, up: Scalar) -> Components:
        """Components along, above and to the right of the velocity: the inverse."""
        ahead = east * self.sin_heading + north * self.cos_heading
        return (
            ahead * self.cos_path + up * self.sin_path,
            up * self.cos_path - ahead * self.sin_path,
            east * self.cos_heading - north * self.sin_heading,
        )


class LocalAxes(NamedTuple):
    """Axes to the east, to the north and up at a place.

    The axes of the planet turn with it: the first points from its centre to longitude zero
    on the equator, the third to the north pole.
    """

    sin_longitude: Scalar
    cos_longitude: Scalar
    sin_latitude: Scalar
    cos_latitude: Scalar

    @classmethod
    def of(cls, state: EntryState) -> "LocalAxes":
        """The axes at the place of a state."""
        return cls(*sincos(state.longitude), *sincos(state.latitude))

    def to_planet(self, east: Scalar, north: Scalar, up: Scalar) -> Components:
        """Components in the axes of the planet of a vector in these axes."""
        outward = up * self.cos_latitude - north * self.sin_latitude
        return (
            outward * self.cos_longitude - east * self.sin_longitude,
            outward * self.sin_longitude + east * self.cos_longitude,
            up * self.sin_latitude + north * self.cos_latitude,
        )

    def from_planet(self, x: Scalar, y: Scalar, z: Scalar) -> Components:
        """Components to the east, north and up: the inverse."""
        outward = x * self.cos_longitude + y * self.sin_longitude
        return (
            y * self.cos_longitude - x * self.sin_longitude,
            z * self.cos_latitude - outward * self.sin_latitude,
            z * self.sin_latitude + outward * self.cos_latitude,
        )


def dot(a: Components, b: Components) -> Scalar:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def scaled(factor: Scalar | float, a: Components) -> Components:
    """A vector times a number."""
    return factor * a[0], factor * a[1], factor * a[2]


def total(*vectors: Components) -> Components:
    """Sum of vectors."""
    x, y, z = (
        functools.reduce(operator.add, each) for each in zip(*vectors, strict=True)
    )
    return x, y, z


def cross(a: Components, b: Components) -> Components:
    """Vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
