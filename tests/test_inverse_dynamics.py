"""The inverse dynamics against the equations of motion themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.guidance.bezier.inverse_dynamics import (
    directions,
    path_point,
    required_acceleration,
    seconds_per_radian,
)
from jentry.missions import find_mission
from jentry.motion import Controls, EntryState, air_data, entry_dynamics
from jentry.onboard import Track
from jentry.units import degree, km


SCENARIO = "cav-h", "stored"


@pytest.fixture(scope="module")
def world():
    mission, variant = SCENARIO
    scenario = find_mission(mission).scenario_of(variant)
    return scenario.planet, scenario.vehicle


@pytest.mark.parametrize(
    ("longitude", "latitude", "heading"), [(0.3, 20.0, 4.0), (-0.8, 50.0, -7.0)]
)
def test_acceleration_of_a_flown_path_is_the_lift(world, longitude, latitude, heading):
    """Fly with some lift and bank; from the curvature of the path comes the same lift."""
    planet, vehicle = world
    track = Track(0.0, 0.0, 0.0, 55.9067 * degree)
    angles = (jnp.asarray(a * degree) for a in (longitude, latitude, -0.7, heading))
    longitude, latitude, path_angle, heading = angles
    state = EntryState(40 * km, longitude, latitude, 5500.0, path_angle, heading)
    bank = jnp.asarray(35.0 * degree)
    controls = Controls(jnp.asarray(11 * degree), jnp.cos(bank), jnp.sin(bank))

    def flow(state):
        return entry_dynamics(planet, vehicle, state, controls)

    def point(state):
        return path_point(planet, track.position(state), state)

    at, rates = jax.jvp(point, (state,), (flow(state),))
    slopes = (
        rates.altitude_slope / rates.along,
        rates.cross_slope / rates.along,
    )
    wanted = required_acceleration(planet, at, slopes, state.velocity)
    lift = air_data(planet, vehicle, state, controls.angle_of_attack).lift
    # Rounding of second derivatives.
    assert float(wanted.vertical) == pytest.approx(
        float(lift * jnp.cos(bank)), rel=1e-9
    )
    assert float(wanted.lateral) == pytest.approx(float(lift * jnp.sin(bank)), rel=1e-9)
    # The slopes are the rates of the place, and time passes as the motion has it.
    np.testing.assert_allclose(
        rates.altitude / rates.along, at.altitude_slope, rtol=1e-12
    )
    np.testing.assert_allclose(rates.cross / rates.along, at.cross_slope, rtol=1e-12)
    towards = directions(planet, at)
    radius = planet.radius + state.altitude
    passed = seconds_per_radian(radius, state.velocity, towards)
    assert float(passed) == pytest.approx(1.0 / float(rates.along), rel=1e-12)
    assert float(towards.tan_path) == pytest.approx(np.tan(-0.7 * degree), rel=1e-12)
