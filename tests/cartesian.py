"""An independent twin of the equations of motion: vectors instead of angles.

Position and velocity in the frame that turns with the planet, x through the meridian of
longitude zero on the equator, z through the north pole: three numbers each, or three rows
of them, of as many vehicles. Written from Newton's law alone, in numpy, without anything
of `jentry.motion`.
"""

import jax.numpy as jnp
import numpy as np


def norm(vector, xp=np):
    return xp.sqrt((vector * vector).sum(axis=0))


def cross(one, other, xp=np):
    """As numpy's own, with which tests of reference solutions take 1.7 times as long."""
    (a, b, c), (x, y, z) = one, other
    return xp.array([b * z - c * y, c * x - a * z, a * y - b * x])


def local_axes(position, xp=np):
    """Unit vectors to east, north and up."""
    up = position / norm(position, xp)
    east = xp.stack([-up[1], up[0], 0.0 * up[0]])
    east = east / norm(east, xp)
    return east, cross(up, east, xp), up


def from_entry_state(radius, state, xp=jnp):
    """Position (m) and velocity (m/s) of a state over a sphere of a radius (m)."""
    cos_latitude, distance = xp.cos(state.latitude), radius + state.altitude
    up = xp.stack(
        [
            cos_latitude * xp.cos(state.longitude),
            cos_latitude * xp.sin(state.longitude),
            xp.sin(state.latitude),
        ]
    )
    east, north, up = local_axes(up, xp)
    level = xp.sin(state.heading) * east + xp.cos(state.heading) * north
    path = state.flight_path_angle
    velocity = state.velocity * (xp.cos(path) * level + xp.sin(path) * up)
    return distance * up, velocity


def to_angles(radius, position, velocity):
    """Altitude, longitude, latitude, velocity, flight-path angle and heading."""
    east, north, up = local_axes(position)
    distance, speed = norm(position), norm(velocity)
    return (
        distance - radius,
        np.arctan2(position[1], position[0]),
        np.arcsin(position[2] / distance),
        speed,
        np.arcsin(velocity @ up / speed),
        np.arctan2(velocity @ east, velocity @ north),
    )


def acceleration(
    position,
    velocity,
    *,
    gravitational_parameter,
    rotation_rate,
    wind,
    drag,
    lift,
    bank_angle,
):
    """Rate of the velocity in the turning frame, m/s2.

    `wind` is towards east, north and up (m/s); `drag(airspeed)` and `lift(airspeed)` are
    specific forces (m/s2). The lift lies in the vertical plane of the velocity over the
    air and turns to the right of it with the bank angle (rad).
    """
    distance = norm(position)
    over_air = velocity - np.tensordot(wind, np.array(local_axes(position)), 1)
    airspeed = norm(over_air)
    # At rest in the air there is no force, in no direction.
    ahead, up = over_air / np.maximum(airspeed, 1e-300), position / distance
    right = cross(ahead, up)
    force = -drag(airspeed) * ahead
    if lift is not None:
        right = right / norm(right)
        above = cross(right, ahead)
        turned = np.cos(bank_angle) * above + np.sin(bank_angle) * right
        force = force + lift(airspeed) * turned
    spin = np.array([0.0, 0.0, rotation_rate])
    gravity = -gravitational_parameter / distance**3 * position
    coriolis = -2.0 * cross(spin, velocity)
    return gravity + force + coriolis - cross(spin, cross(spin, position))
