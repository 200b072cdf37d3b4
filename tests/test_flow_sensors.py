"""Flow sensors: errors, limits and noise of the measured velocity over the air."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import mars_planet, mars_vehicle
from winds_on_board import STATE, TABLE, air_velocity, sensed

from jentry.onboard import FlowSensors, measure
from jentry.units import degree
from jentry.world import StillAir


ERRORS = 0.02, 0.6 * degree, -0.4 * degree


def numbers(air):
    return np.array([air.east, air.north, air.up], float)


def test_flow_sensors_turn_and_stretch_the_velocity_over_the_air():
    actual = air_velocity(TABLE)
    found = numbers(sensed(TABLE, FlowSensors(least_dynamic_pressure=0.0)).air_velocity)
    np.testing.assert_allclose(found, actual, rtol=1e-13)
    speed = np.linalg.norm(actual)
    heading = np.arctan2(actual[0], actual[1])
    right = np.array([np.cos(heading), -np.sin(heading), 0.0])
    above = np.cross(right, actual / speed)
    assert above[2] > 0.0
    sensors = FlowSensors(*ERRORS, least_dynamic_pressure=0.0)
    off = (numbers(sensed(TABLE, sensors).air_velocity) - actual) / speed
    scale, side, rise = ERRORS
    expected = scale * actual / speed + side * right + rise * above
    np.testing.assert_allclose(off, expected, rtol=0.0, atol=1e-14)


def test_flow_is_sensed_between_two_limits_and_at_samples_alone():
    still = sensed(StillAir(), FlowSensors())
    planet = mars_planet()
    mach = 700.0 / float(planet.atmosphere.speed_of_sound(STATE.altitude))
    pressure = 0.5 * float(planet.density(STATE.altitude)) * 700.0**2
    for share, senses in ((0.99, True), (1.01, False)):
        for limit in (
            {"least_dynamic_pressure": share * pressure},
            {"largest_mach": mach / share, "least_dynamic_pressure": 0.0},
        ):
            read = sensed(StillAir(), FlowSensors(**limit)).air_velocity
            assert bool(read.is_sensed) == senses
    assert still.air_velocity is not None
    angle = mars_vehicle().trim_angle_of_attack
    between = measure(planet, mars_vehicle(), STATE, angle, flow_sensors=FlowSensors())
    assert between.air_velocity is None and sensed(StillAir()).air_velocity is None


def test_noise_of_the_flow_is_of_samples():
    actual, times = air_velocity(TABLE), jnp.arange(2000) * 0.1

    @jax.jit
    def read(times):
        sensors = FlowSensors(noise=5e-3, noise_seed=0.3, least_dynamic_pressure=0.0)
        planet, vehicle = mars_planet(wind=TABLE), mars_vehicle()
        angle = vehicle.trim_angle_of_attack

        def at(time):
            return measure(
                planet, vehicle, STATE, angle, sampled_at=time, flow_sensors=sensors
            ).air_velocity

        return jax.vmap(at)(times)

    air = read(times)
    off = np.stack([air.east, air.north, air.up], axis=1) - actual
    off = off / np.linalg.norm(actual)
    # In any frame, as it is of the same size along each axis: four standard errors.
    np.testing.assert_allclose(np.std(off, axis=0), 5e-3, rtol=4 / np.sqrt(4000))
    assert np.all(np.abs(np.mean(off, axis=0)) < 4 * 5e-3 / np.sqrt(2000))
    assert np.all(np.abs(np.corrcoef(off.T) - np.eye(3)) < 4 / np.sqrt(2000))
