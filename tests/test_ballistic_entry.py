"""Ballistic entries against the closed forms of Allen and Eggers, and of Chapman."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from external_cases import CLOSED, NOWHERE, ballistic_vehicle
from helpers import ConstantBank, fly_compiled

from jentry.flight import AltitudeBelow, FixedStep, Outcome, Scenario, Termination, fly
from jentry.flight.termination import AbstractEndCondition
from jentry.motion import EntryState, air_data
from jentry.units import degree
from jentry.world import (
    ConstantGravity,
    ExponentialAtmosphere,
    InverseSquareGravity,
    Planet,
    Vehicle,
)


FLAT = 1e20
"""m; the radius of a planet without curvature"""


class PastPeakDrag(AbstractEndCondition):
    """Ends where the drag of a ballistic flight stops rising, D'/D = 0.

    It has a world of its own, as a law has.
    """

    planet: Planet
    vehicle: Vehicle
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state, planet):
        planet = self.planet
        drag = air_data(
            planet, self.vehicle, state, jnp.zeros_like(state.altitude)
        ).drag
        gravity = planet.gravity.acceleration(planet.radius + state.altitude)
        sine = jnp.sin(state.flight_path_angle)
        thicker = -state.velocity * sine / planet.atmosphere.scale_height
        return thicker + 2.0 * (-drag - gravity * sine) / state.velocity


def straight_entry(
    surface_density,
    scale_height,
    velocity,
    steepness,
    ballistic_coefficient,
    start,
    end=0.0,
    gravity=0.0,
    time_limit=400.0,
    ends_at_peak=True,
):
    """Entry along a straight line; ends at peak drag or at an altitude (m)."""
    planet = Planet(
        FLAT,
        gravity=ConstantGravity(gravity),
        atmosphere=ExponentialAtmosphere(surface_density, scale_height),
    )
    vehicle = ballistic_vehicle(ballistic_coefficient)
    if ends_at_peak:
        conditions = {"peak": PastPeakDrag(planet, vehicle)}
    else:
        conditions = {"altitude": AltitudeBelow(end)}
    return Scenario(
        planet,
        vehicle,
        EntryState(start, 0.0, 0.0, velocity, -steepness, 90 * degree),
        ConstantBank(),
        Termination(conditions, time_limit),
        NOWHERE,
    )


EARTH = (1.225, 7200.0, 7500.0, 10 * degree, 300.0)

ALLEN_EGGERS = {
    # In feet and slugs: there is no gravity, so that the unit of length is free. A state
    # that is exactly vertical has cos(gamma) = 6e-17 in floating point, which is harmless
    # here: nothing turns the flight.
    "nasa_sphere": (0.0034, 22000.0, 30000.0, 90 * degree, 10.1853882),
    "earth": EARTH,
    "mars": (0.020, 11100.0, 5500.0, 14.5 * degree, 120.0),
}


@pytest.mark.parametrize("case", ALLEN_EGGERS)
def test_peak_deceleration_of_allen_and_eggers(case):
    numbers = ALLEN_EGGERS[case]
    # From 45 scale heights the air above the start, which the closed form includes,
    # is a share of exp(-45) = 3e-20 of all.
    scenario = straight_entry(*numbers, start=45 * numbers[1])
    flight = fly_compiled(scenario, FixedStep(0.05))
    expected = CLOSED[f"allen_eggers_{case}"]
    assert flight.outcome == Outcome.REACHED
    assert flight.ended_by == 0
    # The peak is located exactly; RK4 errs by some (0.05 s / time scale 1 s)^4 x 1e-2 at
    # the shortest, the sphere, where the drag rises by e in 0.7 s; and the truths have
    # nine digits.
    close = 1e-7 if case == "nasa_sphere" else 1e-9
    peak = flight.peaks.drag
    np.testing.assert_allclose(flight.state.altitude, expected["altitude"], rtol=close)
    np.testing.assert_allclose(flight.state.velocity, expected["velocity"], rtol=close)
    np.testing.assert_allclose(peak, expected["deceleration"], rtol=close)


@eqx.filter_jit
def velocity_and_gradient(numbers):
    """V at 36948 m from 120 km, over surface density, steepness and beta."""

    def velocity(surface_density, steepness, ballistic_coefficient):
        scenario = straight_entry(
            surface_density,
            EARTH[1],
            EARTH[2],
            steepness,
            ballistic_coefficient,
            start=120e3,
            end=36948.0,
            ends_at_peak=False,
        )
        return fly(scenario, FixedStep(0.05)).state.velocity

    return jax.value_and_grad(velocity, argnums=(0, 1, 2))(*numbers)


@pytest.mark.slow
def test_gradient_of_velocity_at_an_altitude():
    numbers = jnp.asarray(EARTH[0]), jnp.asarray(EARTH[3]), jnp.asarray(EARTH[4])
    velocity, gradient = velocity_and_gradient(numbers)
    expected = CLOSED["allen_eggers_gradient"]
    # Twelve digits of the truth; RK4 with 0.05 s is good to 1e-10 here.
    np.testing.assert_allclose(velocity, expected["velocity"], rtol=1e-9)
    names = "velocity_by_surface_density", "velocity_by_steepness", "velocity_by_beta"
    for found, name in zip(gradient, names, strict=True):
        np.testing.assert_allclose(found, expected[name], rtol=1e-8)


@eqx.filter_jit
def peak_and_gradient(numbers):
    """Peak deceleration over entry velocity, steepness and beta."""

    def peak(velocity, steepness, ballistic_coefficient):
        scenario = straight_entry(
            EARTH[0],
            EARTH[1],
            velocity,
            steepness,
            ballistic_coefficient,
            start=45 * EARTH[1],
        )
        state = fly(scenario, FixedStep(0.05)).state
        planet, vehicle = scenario.planet, scenario.vehicle
        return air_data(planet, vehicle, state, jnp.asarray(0.0)).drag

    return jax.value_and_grad(peak, argnums=(0, 1, 2))(*numbers)


@pytest.mark.optimized
@pytest.mark.slow
def test_gradient_of_peak_deceleration():
    numbers = tuple(jnp.asarray(EARTH[i]) for i in (2, 3, 4))
    peak, (by_velocity, by_steepness, by_beta) = peak_and_gradient(numbers)
    expected = CLOSED["allen_eggers_gradient"]
    np.testing.assert_allclose(
        peak, CLOSED["allen_eggers_earth"]["deceleration"], rtol=1e-9
    )
    # As for the velocity above.
    np.testing.assert_allclose(
        by_velocity, expected["deceleration_by_velocity"], rtol=1e-8
    )
    np.testing.assert_allclose(
        by_steepness, expected["deceleration_by_steepness"], rtol=1e-8
    )
    # Zero exactly; here the sum of terms of about a_max / beta = 0.8.
    assert abs(by_beta) < 1e-8


@eqx.filter_jit
def drop_time_and_gradient(drag_coefficient):
    """Time of a vertical drop of 100 m from rest, over the drag coefficient.

    The speed-angle state is singular at rest, so that the flight starts after 0.2 s, at
    the height and speed of the closed form, which move with the drag coefficient too.
    Vertical itself is harmless: cos(gamma) is 6e-17 in floating point, and gravity turns
    the path further towards the vertical.
    """
    gravity, mass, area, density, height, begun = 9.80665, 1.0, 0.005, 1.225, 100.0, 0.2

    def time(drag_coefficient):
        terminal = jnp.sqrt(2.0 * mass * gravity / (density * area * drag_coefficient))
        x = gravity * begun / terminal
        fallen = terminal**2 / gravity * jnp.log(jnp.cosh(x))
        scenario = straight_entry(
            density,
            1e30,
            terminal * jnp.tanh(x),
            jnp.pi / 2,
            mass / (area * drag_coefficient),
            start=height - fallen,
            gravity=gravity,
            time_limit=10.0,
            ends_at_peak=False,
        )
        return begun + fly(scenario, FixedStep(0.02)).time

    return jax.value_and_grad(time)(drag_coefficient)


@pytest.mark.slow
def test_gradient_of_the_time_of_a_drop():
    time, gradient = drop_time_and_gradient(jnp.asarray(0.5))
    expected = CLOSED["vertical_drop"]
    # RK4 with 0.02 s on a fall with a time scale of 5 s is at rounding, and so is the
    # location of the end (1e-9 s, corrected to second order).
    np.testing.assert_allclose(time, expected["time"], rtol=1e-11)
    np.testing.assert_allclose(
        gradient, expected["time_by_drag_coefficient"], rtol=1e-8
    )


def decay(ballistic_coefficient, radius, gravitational_parameter):
    """Decay from circular orbit, started where the drag is 1e-5 g."""
    scale_height = radius / 900.0
    gravity = gravitational_parameter / radius**2
    drag = 1e-5 * gravity
    velocity = np.sqrt(gravity * radius)
    density = 2.0 * drag * ballistic_coefficient / velocity**2
    altitude = scale_height * np.log(1.225 / density)
    planet = Planet(
        radius,
        gravity=InverseSquareGravity(gravitational_parameter),
        atmosphere=ExponentialAtmosphere(1.225, scale_height),
    )
    vehicle = ballistic_vehicle(ballistic_coefficient)
    # A circular orbit that decays: r' = -2 r D / V.
    velocity = np.sqrt(gravitational_parameter / (radius + altitude))
    path = -2.0 * drag * (radius + altitude) / velocity**2
    return Scenario(
        planet,
        vehicle,
        EntryState(altitude, 0.0, 0.0, velocity, path, 90 * degree),
        ConstantBank(),
        Termination({"peak": PastPeakDrag(planet, vehicle)}, 100_000.0),
        NOWHERE,
    )


@pytest.mark.parametrize("ballistic_coefficient", [50, 200, 1000])
def test_decay_from_orbit_as_chapman_has_it(ballistic_coefficient):
    radius, mu = 6378137.0, 3.986004418e14
    flight = fly_compiled(decay(ballistic_coefficient, radius, mu), FixedStep(1.0))
    assert flight.outcome == Outcome.REACHED
    gravity = mu / radius**2
    expected = CLOSED[f"chapman_{ballistic_coefficient}"]
    peak = flight.peaks.drag / gravity
    # Half a unit of the last of four digits.
    np.testing.assert_allclose(peak, expected["peak_drag_g"], atol=5e-4, rtol=0)
    always = CLOSED["chapman_all"]
    circular = np.sqrt(mu / (radius + flight.state.altitude))
    ratio = flight.state.velocity / circular
    path = flight.state.flight_path_angle / degree
    # Printed for all three together: half a unit of the last digit, and what they differ.
    np.testing.assert_allclose(ratio, always["velocity_ratio"], atol=2e-4, rtol=0)
    np.testing.assert_allclose(path, always["flight_path_angle_deg"], atol=0.01, rtol=0)
