"""Inertial navigation of a flight in the plane of the equator."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filter_flights import ALTIMETER, filtering
from helpers import mars_planet, mars_scenario, mars_vehicle
from scipy.integrate import solve_ivp
from test_navigation import BIASED, OFF

from jentry import fly, navigation_errors
from jentry.campaign import Dispersion, Normal, monte_carlo
from jentry.flight import FixedStep
from jentry.flight.closed_loop import navigate, start
from jentry.flight.effect import unfelt
from jentry.guidance import BankProfile
from jentry.motion import Controls, EntryState, EquatorialDynamics, VectorDynamics
from jentry.motion.forces import air_data
from jentry.onboard import (
    InertialNavigation,
    InertialNoise,
    KnowledgeError,
    PolynomialProfile,
)
from jentry.units import degree, km
from jentry.world import ConstantWind, ZonalGravity


IN_PLANE = dataclasses.replace(
    OFF, knowledge=dataclasses.replace(OFF.knowledge, north=0.0, velocity_north=0.0)
)
"""The errors of a navigation, without those out of the plane"""
COSINE, ANGLE, RATE, WIND = 0.62, -0.2, 7.0882e-5, (60.0, 4.0)
"""Of the bank; angle of attack, rad; rotation of the planet, rad/s; to east and up, m/s"""


def banked(navigation=IN_PLANE):
    """A banked flight over a planet that turns, in wind, at an angle of attack."""
    wind = ConstantWind(WIND[0], 0.0, WIND[1])
    return dataclasses.replace(
        mars_scenario(BankProfile(PolynomialProfile([COSINE])), 100.0),
        planet=mars_planet(wind=wind, rotation_rate=RATE),
        vehicle=eqx.tree_at(
            lambda v: v.trim_angle_of_attack, mars_vehicle(), jnp.asarray(ANGLE)
        ),
        initial_state=EntryState(70 * km, 0.3, 0.0, 5500.0, -12 * degree, 90 * degree),
        navigation=navigation,
        accelerometers=BIASED,
    )


def test_the_flight_is_that_of_an_independent_program():
    """In inertial axes of the plane, by scipy; the motion and its forces are jentry's. The
    vehicle is banked, so that errors across the plane act within it."""
    scenario = banked()
    flight = fly(scenario, FixedStep(0.25))
    planet, vehicle = scenario.planet, scenario.vehicle
    radius, sine = float(planet.radius), np.sqrt(1.0 - COSINE**2)
    numbers = lambda part: np.array(jax.tree.leaves(part), float)

    @jax.jit
    def actual(altitude, longitude, velocity, path):
        here = 0.0 * path, velocity, path, 0.0 * path + 0.5 * np.pi
        state = EntryState(altitude, longitude, *here)
        controls = Controls(jnp.asarray(ANGLE), jnp.asarray(COSINE), jnp.asarray(sine))
        air = air_data(planet, vehicle, state, controls.angle_of_attack)
        rates = scenario.dynamics.rates(planet, vehicle, state, controls)
        moved = rates.altitude, rates.longitude, rates.velocity, rates.flight_path_angle
        return jnp.stack(moved), air.lift, air.drag

    def turned(angle):
        """East and up, over a longitude."""
        return (
            np.array([-np.sin(angle), np.cos(angle), 0.0]),
            np.array([np.cos(angle), np.sin(angle), 0.0]),
        )

    b, gyro = BIASED, IN_PLANE.gyroscopes
    bias = numbers([b.bias_forward, b.bias_right, b.bias_down])
    scale = numbers([b.scale_error_forward, 0.0, b.scale_error_down])
    misaligned = numbers(
        [b.misalignment_roll, b.misalignment_pitch, b.misalignment_yaw]
    )
    drift = numbers([gyro.drift_roll, gyro.drift_pitch, gyro.drift_yaw])
    mu = float(IN_PLANE.gravity.gravitational_parameter)

    def slope(time, y):
        truth, place, velocity, tilt = y[:4], y[4:7], y[7:10], y[10:]
        rates, lift, drag = map(np.asarray, actual(*truth))
        _, longitude, speed, path = truth
        east, up = turned(longitude + RATE * time)
        over = (speed * np.cos(path) - WIND[0], speed * np.sin(path) - WIND[1])
        ahead = (over[0] * east + over[1] * up) / np.hypot(*over)
        above, right = np.cross([0.0, 0.0, 1.0], -ahead), np.array([0.0, 0.0, -1.0])
        above *= np.sign(above @ up)
        lifted = COSINE * above + sine * right
        forward = np.cos(ANGLE) * ahead + np.sin(ANGLE) * lifted
        down = np.sin(ANGLE) * ahead - np.cos(ANGLE) * lifted
        axes = np.array([forward, COSINE * right - sine * above, down])
        force = axes @ (lift * lifted - drag * ahead)
        sensed = force + bias + scale * force - np.cross(misaligned, force)
        believed = sensed @ axes
        believed = believed + np.cross(tilt, believed)
        believed[2] = 0.0  # it knows that it stays in the plane
        pull = mu * place / np.linalg.norm(place) ** 3
        return np.concatenate([rates, velocity, believed - pull, drift @ axes])

    first, off = scenario.initial_state, scenario.navigation.knowledge
    size = radius + float(first.altitude)
    east, up = turned(float(first.longitude))
    seen_east, seen_up = turned(float(first.longitude) + float(off.east) / size)
    place = (size + float(off.up)) * seen_up
    speed, path = float(first.velocity), float(first.flight_path_angle)
    rises = speed * np.sin(path) + float(off.velocity_up)
    goes = speed * np.cos(path) + float(off.velocity_east)
    spin = RATE * np.array([0.0, 0.0, 1.0])
    velocity = goes * seen_east + rises * seen_up + np.cross(spin, place)
    tilt = numbers([off.tilt_east, off.tilt_north, off.tilt_up])
    tilt = tilt @ np.array([east, [0.0, 0.0, 1.0], up])
    truth = [float(first.altitude), float(first.longitude), speed, path]
    found = solve_ivp(
        slope,
        (0.0, 100.0),
        np.concatenate([truth, place, velocity, tilt]),
        method="DOP853",
        rtol=1e-10,
        atol=1e-10,
    ).y[:, -1]
    end, believed = flight.state, flight.navigated
    assert float(flight.time) == 100.0
    np.testing.assert_allclose(found[0], float(end.altitude), rtol=1e-7)
    east, up = turned(float(believed.longitude) + RATE * 100.0)
    here = (radius + float(believed.altitude)) * up
    # The errors are of 300 m; 5 mm are those of both integrations.
    np.testing.assert_allclose(here, found[4:7], rtol=0, atol=5e-3)
    off = navigation_errors(scenario, flight)
    assert np.hypot(float(off.downrange), float(off.altitude)) > 200.0
    speed, path = float(believed.velocity), float(believed.flight_path_angle)
    over = speed * np.cos(path) * east + speed * np.sin(path) * up
    expected = found[7:10] - np.cross(spin, found[4:7])
    np.testing.assert_allclose(over, expected, rtol=0, atol=1e-4)
    # Nothing is believed of what the plane does not have.
    assert float(believed.latitude) == 0.0
    assert float(believed.heading) == 0.5 * np.pi
    # m, the rounding of an arc
    assert float(off.crossrange) == pytest.approx(0.0, abs=1e-8)


def test_random_walks_stay_in_the_plane_and_are_as_large_as_stated():
    noise = InertialNoise(velocity_random_walk=2e-3, angle_random_walk=3e-5, cycle=2.0)
    scenario = banked(InertialNavigation(noise=noise))

    @jax.jit
    @jax.vmap
    def kicked(seed):
        # Errors to the north that are not known yet, and so are not refused, do nothing.
        lens = lambda s: (
            s.navigation.seed,
            s.navigation.knowledge.north,
            s.navigation.knowledge.velocity_north,
        )
        mine = eqx.tree_at(lens, scenario, (seed, 300.0 * seed, 20.0 * seed))
        first = start(mine, 1.0)
        lane = dataclasses.replace(first, flown=jnp.asarray(2.0))
        after = navigate(mine, lane, None)
        return [each.moving.navigated for each in (first, after)]

    first, known = kicked(jnp.linspace(0.0, 1.0, 4000, endpoint=False))
    assert first is not None and known is not None
    for each in (first, known):
        assert np.all(np.asarray(each.state.latitude) == 0.0)
        assert np.all(np.asarray(each.state.heading) == 0.5 * np.pi)
    seen = {name: np.asarray(x) for name, x in vars(known.state).items()}
    ahead = seen["velocity"] * np.cos(seen["flight_path_angle"])
    east, up = ahead * np.sin(seen["heading"]), seen["velocity"]
    up = up * np.sin(seen["flight_path_angle"])
    speed, path = 5500.0, -12 * degree
    steps = [east - speed * np.cos(path), up - speed * np.sin(path), *known.tilt]
    root = np.sqrt(2.0)
    sizes = np.repeat([2e-3 * root, 3e-5 * root], [2, 3])
    values = np.stack(steps) / sizes[:, None]
    # Five standard errors of 4000.
    assert np.all(np.abs(values.mean(axis=1)) < 5.0 / np.sqrt(4000.0))
    np.testing.assert_allclose(
        np.cov(values), np.eye(5), atol=5.0 * np.sqrt(2.0 / 4000.0)
    )


REFUSED = {
    "place": (
        InertialNavigation(KnowledgeError(north=30.0)),
        r"knowledge\.north is 0\.03 km, and EquatorialDynamics knows no north: take 0",
    ),
    "velocity": (
        InertialNavigation(KnowledgeError(velocity_north=-2.0)),
        r"knowledge\.velocity_north is -2 m/s, and EquatorialDynamics",
    ),
    "filter": (
        InertialNavigation(filter=filtering({"altimeter": ALTIMETER})),
        r"navigation has a filter and dynamics is EquatorialDynamics: .*\(filter=None\)",
    ),
    "gravity": (
        InertialNavigation(gravity=ZonalGravity(4.28e13, 3397e3, {"j3": 3e-5})),
        "zonal harmonics j3, which pull out",
    ),
}


@pytest.mark.parametrize(("navigation", "said"), REFUSED.values(), ids=REFUSED)
def test_what_leaves_the_plane_is_refused(navigation, said):
    with pytest.raises(ValueError, match=said):
        fly(banked(navigation))


def test_a_motion_in_other_coordinates_is_refused():
    scenario = dataclasses.replace(banked(), dynamics=VectorDynamics())
    with pytest.raises(
        ValueError, match="dynamics VectorDynamics: it integrates .* or"
    ):
        fly(scenario)


def test_an_error_across_the_plane_cannot_be_dispersed():
    table = {
        "north": Dispersion(lambda s: s.navigation.knowledge.north, Normal(0.0, 9.0))
    }
    said = r"navigation\.knowledge\.north has no effect .* EquatorialDynamics holds it"
    with pytest.raises(ValueError, match=said):
        monte_carlo(banked(), table, jax.random.key(0), 4)
    assert isinstance(banked().dynamics, EquatorialDynamics)
    across = {a for a in unfelt(banked()) if a.startswith("navigation.knowledge.")}
    assert across == {f"navigation.knowledge.{x}north" for x in ("", "velocity_")}
