"""Drag tracking: the paper's closed forms, the planned reference, the nominal flight."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_planet, mars_scenario, mars_vehicle, truths
from laws import observer_law, state_feedback

from jentry._math import derivatives_along
from jentry.flight import FixedStep, Outcome
from jentry.guidance import ErrorGains, ObserverGains, Sampled, Sharp
from jentry.guidance.drag_tracking import (
    ObserverState,
    Tracking,
    drag_dynamics,
    observe,
)
from jentry.motion import Controls, EntryState, air_data, energy, entry_dynamics
from jentry.motion.index import AltitudeIndex, EnergyIndex, TimeIndex, VelocityIndex
from jentry.onboard import OnboardModel, index_motion, measure, quintic_profile
from jentry.units import degree, km


RADIUS = 3397 * km
PAPER = truths("yan_he.csv")


def states(key, count):
    low = jnp.array([15 * km, -3.0, -1.0, 500.0, -40 * degree, -3.0])
    high = jnp.array([90 * km, 3.0, 1.0, 7000.0, 10 * degree, 3.0])
    draws = jax.random.uniform(key, (count, 6), minval=low, maxval=high)
    return EntryState(*draws.T)


def measured(state):
    planet, vehicle = mars_planet(), mars_vehicle()
    return measure(planet, vehicle, state, vehicle.trim_angle_of_attack)


def along_the_flight(output, state, cos_bank):
    """Value and time derivatives of a function of (time, state) in banked flight."""
    planet, vehicle = mars_planet(), mars_vehicle()
    controls = Controls(0.0, cos_bank, jnp.sqrt(1.0 - cos_bank * cos_bank))

    def flow(point):
        time, state = point
        return jnp.ones_like(time), entry_dynamics(planet, vehicle, state, controls)

    return derivatives_along(
        flow, lambda point: output(*point), (0.0 * cos_bank, state)
    )


@jax.jit
@jax.vmap
def drag_both_ways(state, cos_bank):
    planet, vehicle = mars_planet(), mars_vehicle()
    model = OnboardModel(planet, vehicle)
    closed = drag_dynamics(model, measured(state), jnp.zeros_like(cos_bank))

    def drag(time, state):
        return air_data(planet, vehicle, state, jnp.zeros_like(time)).drag

    return closed, along_the_flight(drag, state, cos_bank)


def test_closed_form_of_the_drag_dynamics(key):
    """Equations (8), (9) and (11), corrected, against derivatives along the motion.

    The bank enters through f + g0 u, so that several banks test both.
    """
    drawn = states(key, 100)
    for cos_bank in (-0.9, 0.0, 0.4, 0.8):
        u = jnp.full(100, cos_bank)
        closed, (_, rate, second) = drag_both_ways(drawn, u)
        # Rounding of sums whose terms cancel by some orders of magnitude.
        np.testing.assert_allclose(closed.rate, rate, rtol=1e-9)
        found = closed.drift + closed.gain * u
        np.testing.assert_allclose(found, second, rtol=1e-9)
        # By itself a sum of terms of either sign must not hide g0.
        assert np.all(closed.gain < 0.0)


@pytest.mark.parametrize(
    "index",
    [
        EnergyIndex(),
        VelocityIndex(),
        TimeIndex(),
        AltitudeIndex(),
    ],
    ids=lambda x: type(x).__name__,
)
def test_closed_form_of_the_index_motion(index, key):
    planet, vehicle = mars_planet(), mars_vehicle()
    model = OnboardModel(planet, vehicle)

    @jax.jit
    @jax.vmap
    def both(state, cos_bank):
        time = 0.0 * cos_bank
        measurement = measured(state)
        rate = drag_dynamics(model, measurement, time).rate
        motion = index_motion(index, time, measurement, model, time, rate)
        second = motion.drift + motion.gain * cos_bank
        exact = along_the_flight(lambda *at: index.value(planet, *at), state, cos_bank)
        return (motion.value, motion.rate, second), exact

    found, exact = both(states(key, 100), jnp.linspace(-0.9, 0.9, 100))
    for one, other in zip(found, exact, strict=True):
        # Rounding; the rate of the energy is a small difference of large terms.
        scale = np.max(np.abs(other))
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * scale)


@pytest.mark.parametrize(("excess", "tracked"), [(0.5, True), (-0.5, False)])
def test_rates_of_the_observer_are_those_of_equation_25(excess, tracked):
    """By hand, for x1 = 0.7 and estimates 0.4 and -0.2; below the gate the second stays."""
    x1, error, rate = 0.7, 0.4, -0.2
    numbers = (jnp.asarray(x) for x in (0.3, x1, 9.0, excess))
    found = observe(
        ErrorGains(epsilon0=5.0, a=1.982, b=3.0),
        ObserverGains(epsilon=0.481, l1=2.0, l2=1.5),
        Sharp(),
        Tracking(*numbers),
        ObserverState(jnp.asarray(error), jnp.asarray(rate)),
    )
    expected = rate + 2.0 / 0.481 * (x1 - error)
    assert float(found.drag_error) == pytest.approx(expected, rel=1e-14)
    feedback = -1.982 / 25.0 * x1 - 3.0 / 5.0 * rate
    expected = feedback + 1.5 / 0.481**2 * (x1 - error) if tracked else 0.0
    assert float(found.drag_error_rate) == pytest.approx(expected, rel=1e-14)


# Profiles.


def test_quintic_profile_is_exact_at_its_nodes():
    nodes = jnp.linspace(1.0, 3.0, 9)
    value, first, second = jnp.sin(nodes), jnp.cos(nodes), -jnp.sin(nodes)
    profile = quintic_profile(nodes[0], nodes[1] - nodes[0], value, first, second)
    found = jax.jit(jax.vmap(profile.with_derivatives))(nodes)
    # Rounding, over the square of a spacing of 1/4.
    for one, other in zip(found, (value, first, second), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-14)


def test_quintic_profile_is_of_sixth_order():
    @functools.partial(jax.jit, static_argnums=0)
    def error(intervals):
        nodes = jnp.linspace(1.0, 3.0, intervals + 1)
        values = jnp.sin(nodes), jnp.cos(nodes), -jnp.sin(nodes)
        profile = quintic_profile(nodes[0], nodes[1] - nodes[0], *values)
        x = jnp.linspace(1.0, 3.0, 1001)
        return jnp.max(jnp.abs(jax.vmap(profile)(x) - jnp.sin(x)))

    # 2^6, within the next order.
    np.testing.assert_allclose(error(4) / error(8), 64.0, rtol=0.1)


def test_derivatives_of_a_profile_are_those_of_its_value(reference):
    """Between nodes, on them, and outside of the table."""
    profile = reference.drag
    intervals = profile.coefficients.shape[0]
    places = jnp.array([-0.3, 0.1, 0.25, 0.77, 1.0, 1.4])

    @jax.jit
    @jax.vmap
    def both(index):
        exact = derivatives_along(lambda x: jnp.ones_like(x), profile, index)
        return profile.with_derivatives(index), exact

    found, exact = both(profile.start + places * intervals * profile.spacing)
    spacing = abs(profile.spacing)
    size = np.max(np.abs(found[0]))
    # The same polynomial by two ways: rounding of its value over the spacing.
    for order, (one, other) in enumerate(zip(found, exact, strict=True)):
        close = 1e-14 * size / spacing**order
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=close)


# The planned reference.


def test_planned_bank_meets_the_target(planned):
    profile, flight, _ = planned
    at_end, at_entry = (
        np.degrees(np.arccos(float(profile(jnp.asarray(velocity)))))
        for velocity in (503.0, 6750.0)
    )
    expected = PAPER["reference"]
    # Given in whole degrees.
    np.testing.assert_allclose(at_end, expected["bank_at_end_deg"], atol=0.5)
    np.testing.assert_allclose(at_entry, expected["bank_at_entry_deg"], atol=0.5)
    # The reference itself is flown further, to 300 m/s.
    scenario = mars_scenario(flight.scenario.guidance)
    flown = fly_compiled(scenario, FixedStep(0.1))
    target = PAPER["target"]
    # Newton's method ends at 1e-11 of 100 km.
    np.testing.assert_allclose(flown.state.altitude, target["altitude_m"], atol=1e-3)
    np.testing.assert_allclose(flown.state.velocity, target["velocity_m_s"], atol=1e-5)
    downrange = flown.state.longitude * RADIUS
    np.testing.assert_allclose(downrange, target["downrange_m"], atol=1e-2)
    # About 226 s.
    assert abs(flown.time - expected["time_s"]) < 0.5


@pytest.mark.parametrize("kind", ["energy", "time"])
def test_reference_is_the_flown_drag(kind, planned):
    """At times between its nodes, against the drag and its derivatives in the flight."""
    _, flight, references = planned
    reference = references[kind]
    planet, vehicle = mars_planet(), mars_vehicle()
    scenario = flight.scenario

    @jax.jit
    @jax.vmap
    def both(time, state):
        cos_bank = scenario.guidance.cos_bank(state.velocity)

        def flow(point):
            time, state = point
            u = scenario.guidance.cos_bank(state.velocity)
            controls = Controls(0.0, u, 0.0)
            return jnp.ones_like(time), entry_dynamics(planet, vehicle, state, controls)

        def drag(point):
            return air_data(planet, vehicle, point[1], 0.0 * point[0]).drag

        exact = derivatives_along(flow, drag, (time, state))
        measurement = measured(state)
        model = OnboardModel(planet, vehicle)
        angle = 0.0 * time
        rate = drag_dynamics(model, measurement, angle).rate
        wanted = reference.at(time, measurement, model, angle, rate)
        second = wanted.drift + wanted.gain * cos_bank
        return (wanted.value, wanted.rate, second), exact

    # From 30 s on (drag above 1 m/s2): before that the energy hardly falls, and its nodes
    # are many seconds apart.
    some = slice(300, 2200, 37)
    times, there = jax.tree.map(lambda x: x[some], (flight.times, flight.states))
    found, exact = both(times, there)
    # Interpolation between nodes some 0.1 s apart, and rounding of the energy (1e-9 of
    # its interval), which counts once more in each derivative.
    for one, other, close in zip(found, exact, (1e-8, 1e-7, 1e-5), strict=True):
        scale = np.max(np.abs(other))
        np.testing.assert_allclose(one, other, rtol=0, atol=close * scale)


# The nominal flight.


@pytest.mark.parametrize(
    "make", [state_feedback, observer_law], ids=["full", "observer"]
)
@pytest.mark.parametrize(("kind", "metres"), [("time", 1.0), ("energy", 5.0)])
def test_nominal_flight_follows_its_reference(make, kind, metres, planned):
    scenario = mars_scenario(make(planned[2][kind]))
    flight = fly_compiled(scenario, FixedStep(0.1))
    assert flight.outcome == Outcome.REACHED
    miss = flight.state.longitude * RADIUS - PAPER["target"]["downrange_m"]
    # The promise of the mission: a metre over time, which needs no more than the table;
    # over energy its interpolation at entry, where it hardly changes, adds a few.
    assert abs(miss) < metres
    np.testing.assert_allclose(flight.state.altitude, 10 * km, atol=metres)


def test_energy_falls_along_the_nominal_flight(planned):
    _, flight, _ = planned
    planet = mars_planet()
    along = jax.vmap(lambda state: energy(planet, state))(flight.states)
    along = along[np.isfinite(along)]
    assert np.all(np.diff(along) < 0.0)


@pytest.mark.slow
def test_held_command_tends_to_the_continuous_one_at_first_order(planned):
    """Halving the guidance cycle halves the difference from the continuous law."""
    _, flight, references = planned
    scenario = mars_scenario(observer_law(references["energy"]))
    # From 60 s of the planned flight on, off it by so little that nothing is clipped.
    state = jax.tree.map(lambda x: x[600], flight.states)
    scenario = eqx.tree_at(
        lambda s: (
            s.initial_state,
            s.planet.density_scale,
            s.termination.conditions["altitude"].altitude,
        ),
        scenario,
        (state, jnp.asarray(1.0002), jnp.asarray(1e3)),
    )

    def end(law):
        flown = eqx.tree_at(lambda s: s.guidance, scenario, law)
        return fly_compiled(flown, FixedStep(0.05)).state.longitude * RADIUS

    continuous = end(scenario.guidance)
    coarse, fine = (
        end(Sampled(scenario.guidance, p)) - continuous for p in (0.1, 0.05)
    )
    # 2, within the next order of the cycle.
    np.testing.assert_allclose(coarse / fine, 2.0, rtol=0.1)
