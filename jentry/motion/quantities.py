"""Derived quantities of a flight: energy, heat rate, load factor, downrange."""

import jax.numpy as jnp

from .._interpolation import clamp
from .._math import root, sincos
from ..fields import Scalar
from ..units import standard_gravity
from ..world.planet import Planet
from .forces import AirData
from .state import EntryState


def energy(planet: Planet, state: EntryState) -> Scalar:
    """Energy per unit mass in the planet-relative frame, V^2/2 + potential, J/kg."""
    radius = planet.radius + state.altitude
    return 0.5 * state.velocity * state.velocity + planet.gravity.potential_at(
        radius, state.latitude
    )


def load_factor(air: AirData) -> Scalar:
    """Total aerodynamic acceleration in units of 9.80665 m/s2."""
    return root(air.lift * air.lift + air.drag * air.drag) / standard_gravity


def convective_heat_rate(
    density: Scalar,
    velocity: Scalar,
    nose_radius: Scalar,
    coefficient: Scalar,
    exponent: int | float = 3,
) -> Scalar:
    """Heat rate at the stagnation point, W/m2, by Sutton and Graves.

    `coefficient` is that of the planet's gas, kg^0.5/m: 1.7415e-4 for air, 1.9027e-4
    for Mars. Some published studies use powers of the velocity other than 3.

    Reference: K. Sutton, R. A. Graves, NASA TR R-376, 1971.
    """
    return coefficient * jnp.sqrt(density / nose_radius) * velocity**exponent


def detra_kemp_riddell_heat_rate(
    density: Scalar,
    velocity: Scalar,
    nose_radius: Scalar,
    surface_density: Scalar,
    circular_velocity: Scalar,
) -> Scalar:
    """Convective heat rate at the stagnation point, W/m2, with the 3.15 power of speed.

    The constant is 1.1037e8 W m^-1.5, for air (sea-level density 1.225 kg/m3, circular
    velocity 7925 m/s in the source).

    Reference: R. W. Detra, N. H. Kemp, F. R. Riddell, Jet Propulsion 27(12), 1957.
    """
    ratio = jnp.sqrt(density / surface_density)
    return (
        1.1037e8
        / jnp.sqrt(nose_radius)
        * ratio
        * (velocity / circular_velocity) ** 3.15
    )


def _direction(longitude: Scalar, latitude: Scalar) -> tuple:
    sin_longitude, cos_longitude = sincos(longitude)
    sin_latitude, cos_latitude = sincos(latitude)
    return cos_latitude * cos_longitude, cos_latitude * sin_longitude, sin_latitude


def direction_to(
    longitude: Scalar, latitude: Scalar, state: EntryState
) -> tuple[Scalar, Scalar, Scalar]:
    """Unit vector from the centre of the planet to a place, in axes of the vehicle.

    Its components are ahead, along the heading over the ground, to the right, and up.
    """
    sin_there, cos_there = sincos(latitude)
    sin_here, cos_here = sincos(state.latitude)
    sin_between, cos_between = sincos(longitude - state.longitude)
    sin_heading, cos_heading = sincos(state.heading)
    east = cos_there * sin_between
    north = sin_there * cos_here - cos_there * sin_here * cos_between
    up = sin_there * sin_here + cos_there * cos_here * cos_between
    ahead = east * sin_heading + north * cos_heading
    return ahead, east * cos_heading - north * sin_heading, up


def arc_to(ahead: Scalar, right: Scalar, up: Scalar) -> Scalar:
    """Angle of the great circle from the vehicle to a place, rad, by its `direction_to`."""
    return jnp.arctan2(jnp.sqrt(ahead * ahead + right * right), up)


def ground_track(
    planet: Planet, origin: EntryState, state: EntryState
) -> tuple[Scalar, Scalar]:
    """Downrange and crossrange from the origin, m, as arcs on the sphere's surface.

    Downrange is counted along the great circle through the origin in the direction of its
    heading. Crossrange is the distance from that circle, positive to the left. From an
    origin on the equator with heading east they are longitude and latitude times the
    radius.
    """
    place = _direction(state.longitude - origin.longitude, state.latitude)
    ahead, left, up = _in_axes_of(origin, *place)
    downrange = planet.radius * jnp.arctan2(ahead, up)
    crossrange = planet.radius * jnp.arcsin(left)
    return downrange, crossrange


def course_in_axes(origin: EntryState, state: EntryState) -> tuple[Scalar, Scalar]:
    """Unit vector along the course over the ground, in axes of an origin.

    Its components are ahead, along the heading of the origin, and to the left, normal to
    the great circle of that heading.
    """
    sin_between, cos_between = sincos(state.longitude - origin.longitude)
    sin_latitude, cos_latitude = sincos(state.latitude)
    east, north = sincos(state.heading)
    x = -east * sin_between - north * sin_latitude * cos_between
    y = east * cos_between - north * sin_latitude * sin_between
    ahead, left, _ = _in_axes_of(origin, x, y, north * cos_latitude)
    return ahead, left


def _in_axes_of(
    origin: EntryState, x: Scalar, y: Scalar, z: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """A vector in axes of an origin: ahead, along its heading, to the left, and up.

    The axis x points from the centre of the planet to the equator at the longitude of the
    origin, and z to the north pole.
    """
    sin_latitude, cos_latitude = sincos(origin.latitude)
    sin_heading, cos_heading = sincos(origin.heading)
    up = x * cos_latitude + z * sin_latitude
    north = z * cos_latitude - x * sin_latitude
    ahead = y * sin_heading + north * cos_heading
    return ahead, north * sin_heading - y * cos_heading, up


def from_ground_track(
    planet: Planet, origin: EntryState, downrange: Scalar, crossrange: Scalar
) -> tuple[Scalar, Scalar]:
    """Longitude and latitude, rad, at a downrange and crossrange, m, of `ground_track`."""
    sin_along, cos_along = sincos(downrange / planet.radius)
    left, cos_across = sincos(crossrange / planet.radius)
    up, ahead = cos_across * cos_along, cos_across * sin_along
    sin_latitude, cos_latitude = sincos(origin.latitude)
    sin_heading, cos_heading = sincos(origin.heading)
    north = ahead * cos_heading + left * sin_heading
    x = up * cos_latitude - north * sin_latitude
    y = ahead * sin_heading - left * cos_heading
    z = up * sin_latitude + north * cos_latitude
    # Rounding may make z a little larger than 1 at a pole.
    latitude = jnp.arcsin(clamp(z, -1.0, 1.0))
    return origin.longitude + jnp.arctan2(y, x), latitude
