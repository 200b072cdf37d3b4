"""Inertial navigation in a flight: an independent program, and what a law may know."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from composed_laws import reference
from helpers import ConstantBank, mars_planet, mars_scenario, mars_vehicle
from jax.interpreters import partial_eval
from laws import all_laws
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from jentry import find_mission, fly
from jentry.campaign import Dispersion, Normal, monte_carlo
from jentry.flight import (
    Crossing,
    EnergyBelow,
    FixedStep,
    Outcome,
    RangeToGoBelow,
    Target,
    Termination,
    VelocityBelow,
)
from jentry.flight.closed_loop import decide, start
from jentry.flight.scenario_checks import check
from jentry.flight.sensing import command
from jentry.motion import Controls, EntryDynamics, EntryState
from jentry.motion.forces import air_data
from jentry.motion.quantities import from_ground_track
from jentry.onboard import (
    AbstractAccelerometers,
    Accelerometers,
    BodyAccelerometers,
    Gyroscopes,
    InertialNavigation,
    InertialNoise,
    KnowledgeError,
    PerfectAccelerometers,
    PerfectNavigation,
    SpecificForce,
)
from jentry.units import degree, km
from jentry.world import (
    ConstantWind,
    InverseSquareGravity,
)


# A flight.

BIASED = BodyAccelerometers(2e-3, -1e-3, 3e-3, 4e-4, -6e-4, 3e-4, -2e-4, 1e-4)
OFF = InertialNavigation(
    KnowledgeError(300.0, -200.0, 150.0, 0.4, -0.6, 0.5, 2e-4, -3e-4, 4e-4),
    Gyroscopes(2e-6, -3e-6, 4e-6),
    InverseSquareGravity(4.2829e13),
)


def windy(navigation=OFF, accelerometers=BIASED, law="range tracking", seconds=100.0):
    """A banked flight over a planet that turns, in wind, at an angle of attack."""
    planet = dataclasses.replace(
        mars_planet(), wind=ConstantWind(60.0, -35.0, 4.0), rotation_rate=7.0882e-5
    )
    return dataclasses.replace(
        mars_scenario(
            all_laws[law](reference()), dynamics=EntryDynamics(), time_limit=seconds
        ),
        planet=planet,
        vehicle=eqx.tree_at(
            lambda v: v.trim_angle_of_attack, mars_vehicle(), jnp.asarray(-0.2)
        ),
        initial_state=EntryState(70 * km, 0.3, 0.5, 5500.0, -12 * degree, 70 * degree),
        navigation=navigation,
        accelerometers=accelerometers,
    )


@pytest.fixture(scope="module")
def flown():
    """A compiled flight, for all scenarios of one structure."""
    return eqx.filter_jit(lambda s: fly(s, FixedStep(0.25)))


@pytest.mark.slow
def test_without_errors_it_is_the_truth(flown):
    perfect = eqx.tree_at(
        lambda s: (s.navigation, s.accelerometers),
        windy(),
        (
            jax.tree.map(jnp.zeros_like, OFF),
            jax.tree.map(jnp.zeros_like, BIASED),
        ),
    )
    known = windy().planet.gravity.gravitational_parameter
    perfect = eqx.tree_at(
        lambda s: s.navigation.gravity.gravitational_parameter, perfect, known
    )
    flight = flown(perfect)
    alone = flown(windy(PerfectNavigation(), PerfectAccelerometers()))
    for there in (flight.navigated, alone.state):
        for name, size in (("altitude", 1e5), ("velocity", 5e3), ("heading", 1.0)):
            off = getattr(flight.state, name) - getattr(there, name)
            assert abs(float(off)) < 1e-11 * size, name
    assert alone.navigated is None


def test_the_flight_is_that_of_an_independent_program(flown):
    """In inertial axes with matrices, by scipy; the motion and its forces are jentry's."""
    scenario = dataclasses.replace(windy(), guidance=ConstantBank(0.9))
    flight = flown(scenario)
    planet, vehicle = scenario.planet, scenario.vehicle
    rate, radius = float(planet.rotation_rate), float(planet.radius)
    known, gyro, off = OFF.gravity, OFF.gyroscopes, OFF.knowledge
    mu = float(known.gravitational_parameter)

    @jax.jit
    def actual(y):
        state = EntryState(*y)
        controls = Controls.from_bank(jnp.asarray(0.9), jnp.asarray(0.0))
        air = air_data(planet, vehicle, state, controls.angle_of_attack)
        rates = scenario.dynamics.rates(planet, vehicle, state, controls)
        numbers = air.lift, air.drag, controls.angle_of_attack, controls.bank_angle
        return jnp.stack(jax.tree.leaves(rates)), jnp.stack(numbers)

    def axes(longitude, latitude):
        """Rows: east, north, up."""
        a, b = np.sin, np.cos
        east = [-a(longitude), b(longitude), 0.0]
        up = [b(latitude) * b(longitude), b(latitude) * a(longitude), a(latitude)]
        return np.array([east, np.cross(up, east), up])

    def body(state, bank, angle):
        """Columns: forward, right, down, in inertial axes at time zero."""
        altitude, longitude, latitude, speed, path, heading = state
        velocity = speed * np.array(
            [
                np.cos(path) * np.sin(heading),
                np.cos(path) * np.cos(heading),
                np.sin(path),
            ]
        )
        velocity -= [60.0, -35.0, 4.0]
        ahead = velocity / np.linalg.norm(velocity)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        down = np.cross(ahead, right)
        level = np.array([ahead, right, down]).T
        turn = Rotation.from_euler("x", bank).as_matrix()
        pitch = Rotation.from_euler("y", angle).as_matrix()
        return level @ turn @ pitch

    spin = np.array([0.0, 0.0, rate])

    def slope(time, y):
        truth, place, velocity, tilt = y[:6], y[6:9], y[9:12], y[12:]
        rates, (lift, drag, angle, bank) = map(np.asarray, actual(truth))
        turned = Rotation.from_rotvec(spin * time).as_matrix()
        attitude = turned @ axes(*truth[1:3]).T @ body(truth, bank, angle)
        force = Rotation.from_euler("y", angle).as_matrix().T @ [-drag, 0.0, -lift]
        b = BIASED
        bias = np.array([b.bias_forward, b.bias_right, b.bias_down], float)
        scale = np.array([b.scale_error_forward, 0.0, b.scale_error_down], float)
        turn = [b.misalignment_roll, b.misalignment_pitch, b.misalignment_yaw]
        sensed = force + bias + scale * force - np.cross(np.array(turn, float), force)
        believed = attitude @ sensed
        believed = believed + np.cross(tilt, believed)
        drift = [gyro.drift_roll, gyro.drift_pitch, gyro.drift_yaw]
        return np.concatenate(
            [
                rates,
                velocity,
                believed - mu * place / np.linalg.norm(place) ** 3,
                attitude @ np.array(drift, float),
            ]
        )

    first = np.array([float(x) for x in jax.tree.leaves(scenario.initial_state)])
    altitude, longitude, latitude, speed, path, heading = first
    size = radius + altitude
    longitude += float(off.east) / size / np.cos(latitude)
    latitude_off = latitude + float(off.north) / size
    there = axes(longitude, latitude_off)
    place = (size + float(off.up)) * there[2]
    over = speed * np.array(
        [np.cos(path) * np.sin(heading), np.cos(path) * np.cos(heading), np.sin(path)]
    )
    over += np.array([off.velocity_east, off.velocity_north, off.velocity_up], float)
    velocity = there.T @ over + np.cross(spin, place)
    tilts = np.array([off.tilt_east, off.tilt_north, off.tilt_up], float)
    tilt = axes(first[1], first[2]).T @ tilts
    end = float(flight.time)
    found = solve_ivp(
        slope,
        (0.0, end),
        np.concatenate([first, place, velocity, tilt]),
        method="DOP853",
        rtol=1e-10,
        atol=1e-10,
    ).y[:, -1]
    # The truth is the flight's, so that they can be compared.
    truth = np.array([float(x) for x in jax.tree.leaves(flight.state)])
    np.testing.assert_allclose(found[:6], truth, rtol=1e-7)
    back = Rotation.from_rotvec(-spin * end).as_matrix()
    place = back @ found[6:9]
    believed = flight.navigated
    here = axes(float(believed.longitude), float(believed.latitude))
    expected = (radius + float(believed.altitude)) * here[2]
    # The errors are of 400 m; 5 mm are those of both integrations.
    assert np.linalg.norm(place - (radius + truth[0]) * axes(*truth[1:3])[2]) > 300.0
    np.testing.assert_allclose(expected, place, rtol=0, atol=5e-3)
    velocity = here @ (back @ found[9:12] - np.cross(spin, place))
    path, heading = float(believed.flight_path_angle), float(believed.heading)
    expected = float(believed.velocity) * np.array(
        [np.cos(path) * np.sin(heading), np.cos(path) * np.cos(heading), np.sin(path)]
    )
    np.testing.assert_allclose(expected, velocity, rtol=0, atol=1e-4)


# Noise.

WALK = InertialNoise(velocity_random_walk=2e-3, angle_random_walk=3e-5, cycle=2.0)


def test_noise_is_a_random_walk_of_velocity_and_attitude():
    """Of 2000 flights: velocity s sqrt(t), position the sum of the steps, tilt as well."""
    scenario = windy(
        InertialNavigation(noise=WALK), PerfectAccelerometers(), "bank profile", 40.0
    )
    # Without forces, so that the tilt moves nothing.
    lens = lambda s: s.planet.density_scale
    scenario = eqx.tree_at(lens, scenario, jnp.asarray(1e-9))

    @jax.jit
    @jax.vmap
    def off(seed):
        mine = eqx.tree_at(lambda s: s.navigation.seed, scenario, seed)
        flight = fly(mine, FixedStep(1.0))
        known, truth = flight.navigated, flight.state
        rise = known.velocity * jnp.sin(known.flight_path_angle)
        rise -= truth.velocity * jnp.sin(truth.flight_path_angle)
        return jnp.stack([known.altitude - truth.altitude, rise, flight.time])

    altitude, rise, time = np.asarray(
        off(jnp.linspace(0.0, 1.0, 2000, endpoint=False))
    ).T
    assert np.all(time == 40.0)
    # At 2, 4, ... 38 s; the flight ends before that of 40 s.
    since = 40.0 - 2.0 * np.arange(1, 20)
    steps = 2e-3 * np.sqrt(2.0)
    for values, expected in (
        (rise, steps * np.sqrt(since.size)),
        (altitude, steps * np.sqrt(np.sum(since**2))),
    ):
        # Five standard errors of a standard deviation of 2000.
        assert np.std(values) == pytest.approx(expected, rel=5.0 / np.sqrt(4000.0))
        assert abs(np.mean(values)) < 5.0 * expected / np.sqrt(2000.0)
    assert np.corrcoef(rise[:-1], rise[1:])[0, 1] == pytest.approx(0.0, abs=0.12)


def test_the_axes_of_the_noise_are_independent_and_as_large_as_stated():
    known = InertialNavigation(noise=WALK).start(mars_planet(), windy().initial_state)
    steps = jax.jit(
        jax.vmap(
            lambda seed: eqx.tree_at(
                lambda n: n.seed, InertialNavigation(noise=WALK), seed
            ).update(lambda: None, known, None, jnp.asarray(2.0), jnp.asarray(True))[0]
        )
    )(jnp.linspace(0.0, 1.0, 4000, endpoint=False))
    state, root = steps.state, np.sqrt(2.0)
    cos, sin = np.cos, np.sin
    path, heading = np.asarray(state.flight_path_angle), np.asarray(state.heading)
    ahead = np.asarray(state.velocity) * cos(path)
    velocity = [ahead * sin(heading), ahead * cos(heading), state.velocity * sin(path)]
    values = np.stack([*velocity, *steps.tilt])
    values -= values.mean(axis=1, keepdims=True)
    sizes = np.repeat([2e-3 * root, 3e-5 * root], 3)
    # Five standard errors of 4000.
    found = np.cov(values / sizes[:, None])
    np.testing.assert_allclose(found, np.eye(6), atol=5.0 * np.sqrt(2.0 / 4000.0))


@pytest.mark.slow
def test_the_noise_of_a_flight_does_not_depend_on_what_is_stored(flown):
    """Nor on the guidance cycle, which may be shorter than that of the navigation."""
    scenario = windy(InertialNavigation(noise=WALK), PerfectAccelerometers())
    ends = [
        fly(scenario, FixedStep(0.5), history=history).navigated
        for history in (None, 4.0)
    ]
    for a, b in zip(*map(jax.tree.leaves, ends), strict=True):
        assert float(a) == pytest.approx(float(b), rel=1e-12)


# What a law may know.


class Deaf(AbstractAccelerometers):
    """Senses what never changes: nothing of the truth comes through it."""

    def read(self, air, sampled_at):
        return SpecificForce(jnp.asarray(3.0), jnp.asarray(9.0))


@pytest.mark.parametrize("name", all_laws)
def test_a_law_knows_no_position_and_velocity_but_those_that_are_believed(name):
    """In the traced program no number of the true state reaches command or memory."""
    scenario = windy(InertialNavigation(), Deaf(), name)

    def guided(state):
        lane = start(scenario, 1.0)
        moving = dataclasses.replace(lane.moving, motion=state)
        after = decide(scenario, dataclasses.replace(lane, moving=moving), None)
        told = command(scenario, lane.flown, after.moving, after.held)
        return told, after.moving.memory, after.held

    arrays = lambda s: [x for x in jax.tree.leaves(guided(s)) if eqx.is_array(x)]
    jaxpr = jax.make_jaxpr(arrays)(scenario.initial_state).jaxpr
    _, used = partial_eval.dce_jaxpr(jaxpr, [True] * len(jaxpr.outvars))
    assert not any(used)


@pytest.mark.slow
def test_an_end_may_be_where_the_vehicle_believes_to_be(flown):
    """At the velocity and at the range that are believed; the truth is another."""
    origin = windy().initial_state
    target = Target(10 * km, 503.0, 600 * km, origin=origin)
    place = from_ground_track(windy().planet, origin, target.downrange, jnp.zeros(()))
    ends = {
        "velocity": lambda by: VelocityBelow(4800.0, by=by),
        "range": lambda by: RangeToGoBelow(200 * km, *place, by=by),
        "crossing": lambda by: Crossing(VelocityBelow(4800.0, by=by)),
    }
    for name, condition in ends.items():
        found = {}
        # What the truth ends is tested in `test_termination.py`, but for one beside it.
        for by in ("truth", "navigation")[name != "velocity" :]:
            limit = Termination({name: condition(by)}, 300.0)
            scenario = dataclasses.replace(windy(), termination=limit, target=target)
            check(scenario)
            flight = flown(scenario)
            assert flight.outcome == Outcome.REACHED
            found[by] = flight
            for state, mine in (
                (flight.state, "truth"),
                (flight.navigated, "navigation"),
            ):
                margin = limit.conditions[name].margin(state, windy().planet)
                # m/s or m
                assert (abs(float(margin)) < 1e-5) == (mine == by), (name, by, mine)
        if name == "velocity":
            assert float(found["truth"].time) != float(found["navigation"].time)
    elsewhere = RangeToGoBelow(200 * km, place[0] + 1e-5, place[1])
    limit = Termination({"range": elsewhere}, 300.0)
    with pytest.raises(ValueError, match=r"termination.conditions.range.longitude and"):
        check(dataclasses.replace(windy(), termination=limit, target=target))


def test_range_to_go_is_the_arc_to_the_place():
    planet, there = mars_planet(), (0.7, -0.3)
    state = EntryState(10 * km, -1.9, 0.8, 1e3, 0.0, 0.0)
    found = RangeToGoBelow(1.0, *there).margin(state, planet) + 1.0
    unit = lambda lon, lat: np.array(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    )
    angle = np.arccos(unit(*there) @ unit(-1.9, 0.8))
    assert float(found) == pytest.approx(float(planet.radius) * angle, rel=1e-12)


# Bad input.


def test_what_cannot_be_navigated_is_refused():
    with pytest.raises(ValueError, match="by is 'gps': it must be truth or navigation"):
        EnergyBelow(1e6, by="gps")
    with pytest.raises(ValueError, match="its condition says by which state"):
        Crossing(EnergyBelow(1e6), by="navigation")


def test_cycles_that_do_not_go_together_are_refused():
    off = dataclasses.replace(WALK, cycle=0.7)
    scenario = windy(InertialNavigation(noise=off), law="sampled bank profile")
    told = "the guidance period is 1.0 s and the cycle of the navigation is 0.7 s: each"
    with pytest.raises(ValueError, match=told):
        fly(scenario)
    told = "cycle of the navigation is 0.7 s: with a guidance cycle that varies"
    with pytest.raises(ValueError, match=told):
        glide = find_mission("cav-h").scenario()
        fly(dataclasses.replace(glide, navigation=InertialNavigation(noise=off)))
    with pytest.raises(ValueError, match="cycle is -1.0 s: it must be positive"):
        InertialNoise(cycle=-1.0)


def test_one_noise_for_all_runs_is_refused():
    scenario = windy(InertialNavigation(noise=WALK), law="bank profile")
    table = {
        "delivery": Dispersion(lambda s: s.initial_state.velocity, Normal(5500.0, 1.0))
    }
    told = "navigation.noise.velocity_random_walk is 0.002 m/s.1.5, and all runs would"
    with pytest.raises(ValueError, match=told):
        monte_carlo(scenario, table, jax.random.key(0), 4)


def test_a_knowledge_error_of_a_vehicle_that_knows_is_refused():
    table = {
        "knowledge": Dispersion(lambda s: s.navigation.knowledge.up, Normal(0.0, 100.0))
    }
    scenario = windy(PerfectNavigation(), PerfectAccelerometers(), "bank profile")
    with pytest.raises(ValueError, match="navigation is PerfectNavigation"):
        monte_carlo(scenario, table, jax.random.key(0), 4)


@pytest.mark.slow
def test_the_older_accelerometers_move_the_navigation_too(flown):
    flight = flown(windy(InertialNavigation(), Accelerometers(drag_bias=1e-2)))
    slower = float(flight.navigated.velocity - flight.state.velocity)
    assert slower == pytest.approx(-1e-2 * float(flight.time), rel=0.05)
