"""From accelerations to angle of attack and bank, within the limits of the vehicle."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jentry.guidance.bezier.allocation import attitude
from jentry.guidance.bezier.inverse_dynamics import Acceleration
from jentry.missions.cav_h.scenario import stored
from jentry.motion import EntryState, air_data
from jentry.motion.constraints import (
    DynamicPressure,
    HeatRate,
    LoadFactor,
)
from jentry.units import degree, km, standard_gravity


LAW = stored().guidance
PLANET, VEHICLE = LAW.model.planet, LAW.model.vehicle
ALTITUDE, VELOCITY = jnp.asarray(38.0 * km), jnp.asarray(5500.0)


LIMITS = {"dynamic_pressure": 200e3, "heat_rate": 2e6, "load_factor": 2.0}
KINDS = {
    "dynamic_pressure": DynamicPressure,
    "heat_rate": HeatRate,
    "load_factor": LoadFactor,
}
UNLIMITED = {"dynamic_pressure": 1e12, "heat_rate": 1e15}


def controls(vertical, lateral, factor=1.0, altitude=ALTITUDE, **limits):
    own = {n: jnp.asarray(x) for n, x in limits.items() if n not in KINDS}
    constraints = {n: k(limits.get(n, LIMITS[n])) for n, k in KINDS.items()}
    wanted = Acceleration(jnp.asarray(vertical), jnp.asarray(lateral))
    return attitude(
        PLANET,
        VEHICLE,
        dataclasses.replace(LAW.limits, **own),
        constraints,
        altitude,
        VELOCITY,
        wanted,
        jnp.asarray(factor),
    )


def lift(controls, altitude=ALTITUDE):
    state = EntryState(
        altitude, *(jnp.asarray(x) for x in (0.0, 0.0)), VELOCITY, 0.0, 0.0
    )
    return float(air_data(PLANET, VEHICLE, state, controls.angle_of_attack).lift)


def test_within_limits_the_acceleration_is_achieved():
    found = controls(5.0, -2.0)
    assert lift(found) * float(found.cos_bank) == pytest.approx(5.0, rel=1e-13)
    assert lift(found) * float(found.sin_bank) == pytest.approx(-2.0, rel=1e-13)
    assert float(found.bank_angle) == pytest.approx(np.arctan2(-2.0, 5.0), rel=1e-13)


def test_the_lift_factor_is_made_up_for():
    assert lift(controls(5.0, 0.0, factor=1.1)) * 1.1 == pytest.approx(5.0, rel=1e-13)


def test_load_factor_is_limited():
    found = controls(30.0, 40.0)
    assert lift(found) == pytest.approx(2.0 * standard_gravity, rel=1e-12)
    assert float(found.sin_bank / found.cos_bank) == pytest.approx(4 / 3, rel=1e-13)


def test_angle_of_attack_stays_within_its_limits():
    high = jnp.asarray(70.0 * km)
    assert float(controls(5.0, 0.0, altitude=high).angle_of_attack) == pytest.approx(
        20.0 * degree
    )
    low = controls(
        0.1, 0.0, least_angle_of_attack=6 * degree, largest_angle_of_attack=7 * degree
    )
    assert float(low.angle_of_attack) == pytest.approx(6.0 * degree)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_bank_stays_within_its_limit(side):
    """Bending down, the vehicle banks as far as it may, with the lift that fits best."""
    found = controls(-0.5, side * 3.0, **UNLIMITED)
    bank = side * 85.0 * degree
    assert float(found.bank_angle) == pytest.approx(bank, rel=1e-13)
    fits = -0.5 * np.cos(bank) + side * 3.0 * np.sin(bank)
    assert lift(found) == pytest.approx(fits, rel=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_bending_down_is_no_turn(side):
    """With next to nothing wanted to the side, nothing large goes there.

    The lower limit of a level glide remains. With the bank of 85 degrees in it, it would
    be 1 / cos(85 deg) = 11.5 times that, nearly all to the side: enough to turn a glider
    by 0.05 degrees in its last tenth of a second.
    """
    limit = 20e3
    found = controls(-30.0, side * 1e-3, dynamic_pressure=limit, load_factor=9.0)
    assert float(found.bank_angle) == pytest.approx(side * 85.0 * degree, rel=1e-13)
    radius = PLANET.radius + ALTITUDE
    weight = float(PLANET.gravity.acceleration(radius) - VELOCITY**2 / radius)
    density = 2.0 * limit / float(VELOCITY) ** 2
    there = jnp.asarray(-7200.0 * np.log(density / 1.225))
    assert lift(found, there) == pytest.approx(weight, rel=1e-12)


def test_straight_down_asks_for_no_lift():
    found = controls(-4.0, 0.0, least_angle_of_attack=-5 * degree, **UNLIMITED)
    # The lower limits of equilibrium glide are those of a lift that is positive.
    assert lift(found) == pytest.approx(0.0, abs=1e-5)


def test_lower_limits_are_those_of_equilibrium_glide():
    """(35): with that lift the vehicle would glide where the limit is just met."""
    radius = PLANET.radius + ALTITUDE
    weight = float(PLANET.gravity.acceleration(radius) - VELOCITY**2 / radius)
    limit = 20e3
    found = controls(0.5, 0.0, dynamic_pressure=limit, load_factor=9.0)
    density = 2.0 * limit / float(VELOCITY) ** 2
    there = jnp.asarray(-7200.0 * np.log(density / 1.225))
    assert lift(found, there) == pytest.approx(weight, rel=1e-12)

    limit = 0.7e6
    found = controls(0.5, 0.0, heat_rate=limit, load_factor=9.0)
    density = (limit / (1e-6 * float(VELOCITY) ** 3.5)) ** 2
    there = jnp.asarray(-7200.0 * np.log(density / 1.225))
    assert lift(found, there) == pytest.approx(weight, rel=1e-12)


def test_no_lower_limit_asks_for_more_load_than_is_borne():
    found = controls(-4.0, 0.1, dynamic_pressure=1e3)
    assert lift(found) <= 2.0 * standard_gravity * (1 + 1e-12)
