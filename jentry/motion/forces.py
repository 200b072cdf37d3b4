"""Aerodynamic forces on the vehicle."""

import equinox as eqx

from .._math import root, sincos
from ..fields import Scalar
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ..world.wind import AbstractWind, StillAir
from .axes import VelocityAxes
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
    angle_of_attack: Scalar
    """rad"""


def wind_at(planet: Planet, state: EntryState) -> AbstractWind:
    """The wind over the altitude of a state, at its place."""
    return planet.wind_above(state.latitude)


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
    return root(east * east + north * north + up * up)


def air_data(
    planet: Planet,
    vehicle: Vehicle,
    state: EntryState,
    angle_of_attack: Scalar,
    airspeed: Scalar | None = None,
) -> AirData:
    """Flow and specific forces at an angle of attack (rad).

    `airspeed` is the speed relative to the air, m/s, if it is known already; None for that
    of the state.
    """
    here = planet.above(state.longitude, state.latitude)
    density = here.density(state.altitude)
    if airspeed is None:
        airspeed = speed_over_air(wind_at(planet, state), state)
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
        angle_of_attack=angle_of_attack,
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
    wind = wind_at(planet, state)
    return about_velocity(wind, state, -air.drag, above, right)


def about_velocity(
    wind: AbstractWind, state: EntryState, along: Scalar, above: Scalar, right: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Components of a vector along, above and to the right of the velocity, from those of
    the velocity relative to the air."""
    if isinstance(wind, StillAir):
        return along, above, right
    over_air = VelocityAxes.along(*velocity_over_air(wind, state))
    return VelocityAxes.of(state).from_local(*over_air.to_local(along, above, right))
