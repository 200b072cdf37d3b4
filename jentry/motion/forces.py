"""Aerodynamic forces on the vehicle."""

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ..world.wind import AbstractWind, StillAir
from .state import Controls, EntryState


class AirData(eqx.Module):
    """The flow around the vehicle and the specific forces that it causes."""

    density: Scalar
    """Density of the air, kg/m3"""
    airspeed: Scalar
    """Speed relative to the air, m/s"""
    dynamic_pressure: Scalar
    """Dynamic pressure, Pa"""
    mach: Scalar
    lift: Scalar
    """Specific force perpendicular to the relative wind, m/s2"""
    drag: Scalar
    """Specific force along the relative wind, m/s2"""


def velocity_over_air(
    wind: AbstractWind, state: EntryState
) -> tuple[Scalar, Scalar, Scalar]:
    """Velocity relative to the air towards east, north and up, m/s."""
    sin_path, cos_path = sincos(state.flight_path_angle)
    sin_heading, cos_heading = sincos(state.heading)
    east, north, up = wind.velocity(state.altitude)
    horizontal = state.velocity * cos_path
    return (
        horizontal * sin_heading - east,
        horizontal * cos_heading - north,
        state.velocity * sin_path - up,
    )


def speed_over_air(wind: AbstractWind, state: EntryState) -> Scalar:
    """Speed relative to the air, m/s; in still air it is the velocity of the state."""
    if isinstance(wind, StillAir):
        return state.velocity
    east, north, up = velocity_over_air(wind, state)
    return jnp.sqrt(east * east + north * north + up * up)


def air_data(
    planet: Planet, vehicle: Vehicle, state: EntryState, angle_of_attack: Scalar
) -> AirData:
    """Flow and specific forces at an angle of attack (rad)."""
    here = planet.above(state.longitude, state.latitude)
    density = here.density(state.altitude)
    airspeed = speed_over_air(planet.wind, state)
    mach = airspeed / here.atmosphere.speed_of_sound(state.altitude)
    dynamic_pressure = 0.5 * density * airspeed * airspeed
    lift, drag = vehicle.coefficients(angle_of_attack, mach, airspeed)
    area_to_mass = vehicle.reference_area / vehicle.mass
    return AirData(
        density=density,
        airspeed=airspeed,
        dynamic_pressure=dynamic_pressure,
        mach=mach,
        lift=dynamic_pressure * (area_to_mass * lift),
        drag=dynamic_pressure * (area_to_mass * drag),
    )


def aerodynamic_acceleration(
    planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
) -> tuple[Scalar, Scalar, Scalar]:
    """Specific aerodynamic force along, above and to the right of the velocity, m/s2.

    "Above" is the direction perpendicular to the velocity in its vertical plane. In wind,
    lift and drag refer to the velocity relative to the air, and the bank turns the lift
    about that velocity.
    """
    air = air_data(planet, vehicle, state, controls.angle_of_attack)
    above = air.lift * controls.cos_bank
    right = air.lift * controls.sin_bank
    if isinstance(planet.wind, StillAir):
        return -air.drag, above, right

    east, north, up = velocity_over_air(planet.wind, state)
    ground = jnp.sqrt(east * east + north * north)
    sin_path, cos_path = up / air.airspeed, ground / air.airspeed
    sin_heading, cos_heading = east / ground, north / ground
    ahead = -air.drag * cos_path - above * sin_path
    force_east = ahead * sin_heading + right * cos_heading
    force_north = ahead * cos_heading - right * sin_heading
    force_up = -air.drag * sin_path + above * cos_path

    sin_path, cos_path = sincos(state.flight_path_angle)
    sin_heading, cos_heading = sincos(state.heading)
    ahead = force_east * sin_heading + force_north * cos_heading
    return (
        ahead * cos_path + force_up * sin_path,
        force_up * cos_path - ahead * sin_path,
        force_east * cos_heading - force_north * sin_heading,
    )
