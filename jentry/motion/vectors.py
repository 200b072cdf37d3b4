"""Position and velocity as vectors, which no pole, vertical or rest makes singular."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from .._math import root, sincos
from ..fields import Flag, Scalar
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ..world.wind import StillAir
from .axes import Components, LocalAxes, VelocityAxes, cross, dot, scaled, total
from .forces import air_data, wind_at
from .state import Controls, EntryState


_ROUNDINGS = 32.0
"""Number of roundings; a vector that is shorter, relative to those from which it was
computed, has no direction"""


class VectorState(eqx.Module):
    """Position and planet-relative velocity as vectors, or their time derivative.

    The components of vectors are along axes that turn with the planet. The first axis
    points from its centre to longitude zero on the equator, the third to the north pole.

    The last three fields change only from step to step, see `renewed`. They say how many
    whole turns longitude and heading have made, and replace a direction that does not
    exist: the longitude at a pole, and the heading in vertical flight and at rest.
    """

    altitude: Scalar
    """Altitude above the sphere, m"""
    up: Components
    """Direction of the position; its length is constant, and has no meaning"""
    velocity: Components
    """Velocity relative to the rotating planet, m/s"""
    right: Components
    """Horizontal unit vector to the right of the flight at the start of the step"""
    longitude: Scalar
    """Longitude at the start of the step, rad, not limited to a turn"""
    heading: Scalar
    """Heading at the start of the step, rad, not limited to a turn"""

    @classmethod
    def of(cls, state: EntryState) -> "VectorState":
        """The vectors of a state, which may lie at a pole, in the vertical or at rest."""
        place, course = LocalAxes.of(state), VelocityAxes.of(state)
        none, one = jnp.zeros_like(state.velocity), jnp.ones_like(state.velocity)
        return cls(
            altitude=state.altitude,
            up=place.to_planet(none, none, one),
            velocity=place.to_planet(*course.to_local(state.velocity, none, none)),
            right=place.to_planet(*course.to_local(none, none, one)),
            longitude=state.longitude,
            heading=state.heading,
        )

    @property
    def entry_state(self) -> EntryState:
        """The state with altitude and angles.

        Longitude and heading are those nearest to the ones at the start of the step, so
        that they count whole turns as the integrated angles do. At rest the flight-path
        angle is zero.
        """
        place = self.place
        east, north, climb = place.from_planet(*self.velocity)
        ground = root(east * east + north * north)
        speed = root(dot(self.velocity, self.velocity))
        # In vertical flight ahead is where it was.
        ahead = _is_longer(ground, speed)
        to_east, to_north, _ = place.from_planet(*self.right)
        heading = jnp.arctan2(
            jnp.where(ahead, east, -to_north), jnp.where(ahead, north, to_east)
        )
        longitude = jnp.arctan2(place.sin_longitude, place.cos_longitude)
        return EntryState(
            altitude=self.altitude,
            longitude=_nearest(longitude, self.longitude),
            latitude=jnp.arctan2(place.sin_latitude, place.cos_latitude),
            velocity=speed,
            flight_path_angle=jnp.arctan2(climb, jnp.where(speed > 0.0, ground, 1.0)),
            heading=_nearest(heading, self.heading),
        )

    @property
    def place(self) -> LocalAxes:
        """The axes to the east, to the north and up."""
        x, y, z = self.up
        out, length = root(x * x + y * y), jnp.sqrt(dot(self.up, self.up))
        sine, cosine = sincos(self.longitude)
        known = _is_longer(out, length)
        per_out = 1.0 / jnp.where(known, out, 1.0)
        per_length = 1.0 / length
        return LocalAxes(
            sin_longitude=jnp.where(known, y * per_out, sine),
            cos_longitude=jnp.where(known, x * per_out, cosine),
            sin_latitude=z * per_length,
            cos_latitude=out * per_length,
        )

    def renewed(self) -> "VectorState":
        """The vectors after a step, with the directions from which the next one starts."""
        state = self.entry_state
        right = _to_the_right(self.velocity, state.velocity, self.up, self.right)
        return dataclasses.replace(
            self, right=right, longitude=state.longitude, heading=state.heading
        )


def vector_rates(
    planet: Planet, vehicle: Vehicle, state: VectorState, controls: Controls
) -> VectorState:
    """Time derivative of vectors: Newton's law in axes that turn with the planet.

    These are the equations of `entry_dynamics` without their singular points. In flight
    exactly along the vertical through the air, the bank counts from the plane of the
    flight before.
    """
    length = jnp.sqrt(dot(state.up, state.up))
    up = scaled(1.0 / length, state.up)
    velocity, entry = state.velocity, state.entry_state
    radius = planet.radius + state.altitude
    climb = dot(velocity, up)
    level = total(velocity, scaled(-climb, up))

    over_air, wind = velocity, wind_at(planet, entry)
    if not isinstance(wind, StillAir):
        drift = state.place.to_planet(*wind.velocity(state.altitude))
        over_air = total(velocity, scaled(-1.0, drift))
    airspeed = root(dot(over_air, over_air))
    air = air_data(planet, vehicle, entry, controls.angle_of_attack, airspeed)
    ahead = scaled(1.0 / jnp.where(airspeed > 0.0, airspeed, 1.0), over_air)
    right = _to_the_right(over_air, airspeed, up, state.right)
    above = cross(right, ahead)

    gravity, north = planet.gravity.components(radius, entry.latitude)
    x, y, z = up
    rotation = planet.rotation_rate
    centrifugal = rotation * rotation * radius
    coriolis = 2.0 * rotation
    east_rate, north_rate, _ = velocity
    none = jnp.zeros_like(climb)
    forces = [
        scaled(-air.drag, ahead),
        scaled(air.lift * controls.cos_bank, above),
        scaled(air.lift * controls.sin_bank, right),
        scaled(-gravity, up),
        (
            coriolis * north_rate + centrifugal * x,
            centrifugal * y - coriolis * east_rate,
            none,
        ),
    ]
    if north is not None:
        out = state.place.cos_latitude
        share = north / jnp.where(out > 0.0, out, 1.0)
        forces.append(scaled(share, (-z * x, -z * y, 1.0 - z * z)))
    return VectorState(
        altitude=climb,
        up=scaled(length / radius, level),
        velocity=total(*forces),
        right=(none, none, none),
        longitude=none,
        heading=none,
    )


def _to_the_right(
    velocity: Components, speed: Scalar, up: Components, otherwise: Components
) -> Components:
    """Horizontal unit vector to the right of a velocity; `otherwise` if it is vertical.

    `speed` is the length of the velocity, and `up` has a length near one.
    """
    right = cross(velocity, up)
    size = root(dot(right, right))
    known = _is_longer(size, speed)
    x, y, z = scaled(1.0 / jnp.where(known, size, 1.0), right)
    return (
        jnp.where(known, x, otherwise[0]),
        jnp.where(known, y, otherwise[1]),
        jnp.where(known, z, otherwise[2]),
    )


def _is_longer(length: Scalar, whole: Scalar) -> Flag:
    """Whether a part of a vector is longer than the rounding of the whole."""
    return length > _ROUNDINGS * float(jnp.finfo(jnp.result_type(length)).eps) * whole


def _nearest(angle: Scalar, other: Scalar) -> Scalar:
    """The angle, changed by whole turns, that is nearest to another one, rad."""
    turn = 2.0 * jnp.pi
    return angle + turn * jnp.round((other - angle) / turn)
