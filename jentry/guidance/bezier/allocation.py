"""Angle of attack and bank, within limits, for the acceleration that a path requires."""

import functools
import math

import equinox as eqx
import jax.numpy as jnp

from ..._math import sincos
from ...fields import Scalar, scalar
from ...motion.constraints import (
    Constraints,
    DynamicPressure,
    HeatRate,
    LoadFactor,
    limit_of,
)
from ...motion.state import Controls
from ...onboard.model import require_sphere, require_still_air
from ...units import standard_gravity
from ...world.aerodynamics import AbstractInvertibleAerodynamics
from ...world.planet import Planet
from ...world.vehicle import Vehicle
from .inverse_dynamics import Acceleration


class FlightLimits(eqx.Module):
    """Limits of the command: equation (13).

    The limits of the loads on the vehicle, equation (11), are the path constraints of the
    scenario.
    """

    least_angle_of_attack: Scalar = scalar(unit="rad")
    largest_angle_of_attack: Scalar = scalar(unit="rad")
    largest_bank: Scalar = scalar(unit="rad", range=(0.0, math.pi))
    """Largest bank to either side"""


def lift_coefficient(
    planet: Planet, vehicle: Vehicle, altitude: Scalar, velocity: Scalar, lift: Scalar
) -> Scalar:
    """Lift coefficient that gives a specific lift (m/s2)."""
    dynamic_pressure = 0.5 * planet.density(altitude) * velocity * velocity
    return lift * vehicle.mass / (dynamic_pressure * vehicle.reference_area)


def attitude(
    planet: Planet,
    vehicle: Vehicle,
    limits: FlightLimits,
    constraints: Constraints,
    altitude: Scalar,
    velocity: Scalar,
    wanted: Acceleration,
    lift_factor: Scalar,
) -> Controls:
    """Angle of attack and bank: equations (33) to (36), corrected.

    The lower limits on the angle of attack are those of equilibrium glide: with more lift
    the vehicle glides where the air is thinner. The upper limits, with that of the load
    factor (33) among them, are applied last: near the largest bank the lower limits
    require more lift than the load factor allows.

    The path may require a bank beyond the largest one, for example where it bends down
    more than gravity bends it. The lift is then the component of the required acceleration
    in the direction of the lift at the largest bank. As printed, it would have the full
    size of the required lift, which points to the other side. There the vehicle does not
    glide in equilibrium, and the lower limits are those of a glide with level wings. With
    the bank included they would require a lift that is eleven times as large and almost
    all to the side.

    **Arguments:**

    - `constraints`: path constraints; the command respects the limits of load factor,
        dynamic pressure and heat rate. The load factor (33) counts the lift alone.
    - `lift_factor`: ratio of the actual lift to that of the model.
    """
    aerodynamics = vehicle.aerodynamics
    assert isinstance(aerodynamics, AbstractInvertibleAerodynamics)
    require_still_air(planet, "the law along a curve")
    require_sphere(planet, "the law along a curve")
    radius = planet.radius + altitude
    mach = velocity / planet.atmosphere.speed_of_sound(altitude)

    total = jnp.sqrt(wanted.vertical * wanted.vertical + wanted.lateral**2)
    cos_bank, sin_bank = wanted.vertical / total, wanted.lateral / total
    sin_most, cos_most = sincos(limits.largest_bank)
    beyond = cos_bank < cos_most
    cos_bank = jnp.where(beyond, cos_most, cos_bank)
    sin_bank = jnp.where(beyond, jnp.where(sin_bank < 0, -sin_most, sin_most), sin_bank)

    # Component of the required acceleration in the direction of the lift: all of it, unless
    # the bank is at its limit.
    lift = wanted.vertical * cos_bank + wanted.lateral * sin_bank

    def angle_of_lift(lift: Scalar) -> Scalar:
        lift = lift / lift_factor
        return angle(lift_coefficient(planet, vehicle, altitude, velocity, lift))

    def angle(coefficient: Scalar) -> Scalar:
        return aerodynamics.angle_of_attack(coefficient, mach, velocity)

    weight = planet.gravity.acceleration(radius) - velocity * velocity / radius
    upright = jnp.where(beyond, 1.0, cos_bank)
    loading = vehicle.mass * weight / (vehicle.reference_area * upright)
    pressure = limit_of(constraints, DynamicPressure)
    heat_rate = limit_of(constraints, HeatRate)
    load_factor = limit_of(constraints, LoadFactor)
    lowest, least, most = (
        [],
        limits.least_angle_of_attack,
        limits.largest_angle_of_attack,
    )
    if pressure is not None:
        lowest.append(angle(loading / pressure))
    if heat_rate is not None:
        heating = planet.heating_coefficient * velocity**planet.heating_exponent
        at_heat_limit = (
            0.5 * vehicle.nose_radius * (heat_rate * velocity / heating) ** 2
        )
        lowest.append(angle(loading / at_heat_limit))
    if lowest:
        least = jnp.maximum(least, functools.reduce(jnp.maximum, lowest))
    if load_factor is not None:
        most = jnp.minimum(most, angle_of_lift(load_factor * standard_gravity))
    angle_of_attack = jnp.minimum(jnp.maximum(angle_of_lift(lift), least), most)
    return Controls(angle_of_attack, cos_bank, sin_bank)
