"""`fly`: solvers, outcomes, peaks, and flights in batches."""

import cartesian
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    bank_profile,
    fly_batch,
    fly_compiled,
    free_scenario,
    mars_scenario,
    with_leaf,
)
from laws import all_laws
from scipy.integrate import solve_ivp

from jentry.flight import Adaptive, FixedStep, Outcome, Termination, fly, has_end
from jentry.guidance import BankProfile, Sampled
from jentry.motion import EntryState
from jentry.onboard import PolynomialProfile
from jentry.units import degree, km


STEP = FixedStep(0.1)


def entry(velocity=6750.0, path=-14.4 * degree, altitude=126.1 * km):
    return EntryState(altitude, 0.0, 0.0, velocity, path, 90 * degree)


def changed(**changes):
    """The free scenario with another start, velocity at the end, lift or density."""
    scenario = free_scenario()
    places = {
        "start": lambda s: s.initial_state,
        "end_velocity": lambda s: s.termination.conditions["velocity"].velocity,
        "bank_angle": lambda s: s.guidance.bank_angle,
        "lift_scale": lambda s: s.vehicle.lift_scale,
        "density_scale": lambda s: s.planet.density_scale,
        "mass": lambda s: s.vehicle.mass,
    }
    for name, value in changes.items():
        scenario = with_leaf(scenario, places[name], value)
    return scenario


ENDS = {
    "reached": ({}, Outcome.REACHED, "velocity"),
    "crashed": (
        {"start": entry(path=-40 * degree), "density_scale": 0.3},
        Outcome.CRASHED,
        "ground",
    ),
    "skipped out": (
        {"start": entry(path=-9 * degree), "bank_angle": 0.0},
        Outcome.SKIPPED_OUT,
        "ceiling",
    ),
    "timed out": ({"start": entry(3500.0, 0.0)}, Outcome.TIMED_OUT, "time_limit"),
    "not finite": ({"lift_scale": 1e300}, Outcome.NOT_FINITE, None),
    "not finite at the start": ({"mass": 1e-300}, Outcome.NOT_FINITE, None),
    "too fast to be a number": (
        {"start": entry(velocity=1e160)},
        Outcome.NOT_FINITE,
        None,
    ),
    "deep below": ({"start": entry(altitude=-1e7)}, Outcome.NOT_FINITE, None),
    "began too slow": (
        {"end_velocity": 7000.0},
        Outcome.BEGAN_BEYOND_END,
        "velocity",
    ),
    "began at the end": (
        {"end_velocity": 6750.0},
        Outcome.BEGAN_BEYOND_END,
        "velocity",
    ),
    "began too high": (
        {"start": entry(altitude=150 * km)},
        Outcome.BEGAN_BEYOND_END,
        "ceiling",
    ),
    "over a pole": (
        {
            "start": EntryState(126.1 * km, 0.0, 1.5, 6750.0, -14.4 * degree, 0.0),
            "bank_angle": 0.0,
        },
        Outcome.SINGULAR,
        None,
    ),
}


def assert_ends(flight, scenario, outcome, name):
    assert flight.outcome == outcome
    if name is not None:
        assert scenario.termination.names[int(flight.ended_by)] == name
        margins = scenario.termination.margins(
            flight.time, flight.state, flight.state, scenario.planet
        )
        if outcome == Outcome.BEGAN_BEYOND_END:
            assert margins[flight.ended_by] <= 0.0
            assert flight.time == 0.0
            assert eqx.tree_equal(flight.state, scenario.initial_state)
            return
        # The condition that ended it is met: rounding of one altitude in metres.
        assert abs(margins[flight.ended_by]) < 1e-9
        others = jnp.delete(margins, int(flight.ended_by))
        assert jnp.all(others > 0.0)


@pytest.mark.parametrize("case", ENDS)
def test_outcomes(case):
    changes, outcome, name = ENDS[case]
    scenario = changed(**changes)
    flight = fly_compiled(scenario, STEP)
    assert_ends(flight, scenario, outcome, name)
    if outcome == Outcome.TIMED_OUT:
        # Exactly at the limit, up to rounding of the sum of the steps.
        np.testing.assert_allclose(flight.time, 300.0, rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["reached", "crashed", "skipped out", "timed out"])
def test_fixed_steps_agree_with_adaptive_ones(case):
    changes, outcome, name = ENDS[case]
    scenario = changed(**changes)
    fixed = fly_compiled(scenario, STEP)
    adaptive = fly_compiled(scenario, Adaptive())
    assert_ends(adaptive, scenario, outcome, name)
    # RK4 with 0.1 s errs by a millimetre at most, 1e-9 of the way; the adaptive solver
    # by its tolerance of 1e-10 in each of some hundred steps.
    np.testing.assert_allclose(fixed.time, adaptive.time, rtol=1e-8)
    for one, other in zip(
        *map(jax.tree.leaves, (fixed.state, adaptive.state)), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8)


def constraints_at(times, start, density_scale):
    """Path constraints of the free scenario by an independent integration, in SI units.

    Of its numbers: 50 deg of bank, a ballistic coefficient of 115 kg/m2, a lift-to-drag
    ratio of 0.18, the density of the exponential atmosphere, a nose of 1 m, and Sutton
    and Graves' constant.
    """
    radius = 3397e3

    def density(position):
        altitude = np.linalg.norm(position) - radius
        return density_scale * 0.0158 * np.exp(-altitude / 9354.5)

    def rate(time, flown):
        position, velocity = flown[:3], flown[3:]
        drag = lambda speed: 0.5 * density(position) * speed**2 / 115.0
        forces = cartesian.acceleration(
            position,
            velocity,
            gravitational_parameter=4.28283e13,
            rotation_rate=0.0,
            wind=(0.0, 0.0, 0.0),
            drag=drag,
            lift=lambda speed: 0.18 * drag(speed),
            bank_angle=np.radians(50.0),
        )
        return np.concatenate([velocity, forces])

    first = np.concatenate(cartesian.from_entry_state(radius, start, np))
    flown = solve_ivp(
        rate, (0.0, times[-1]), first, "DOP853", times, rtol=1e-11, atol=1e-6
    ).y.T
    air = np.array([density(place) for place in flown[:, :3]])
    speed = np.linalg.norm(flown[:, 3:], axis=1)
    pressure = 0.5 * air * speed**2
    return {
        "drag": pressure / 115.0,
        "dynamic_pressure": pressure,
        "heat_rate": 1.7415e-4 * np.sqrt(air) * speed**3,
        "load_factor": pressure / 115.0 * np.hypot(1.0, 0.18) / 9.80665,
    }


@pytest.mark.parametrize("case", ["reached", "crashed"])
@pytest.mark.parametrize(
    ("solver", "between"), [(STEP, 0.1), (Adaptive(), 1.0)], ids=["fixed", "adaptive"]
)
def test_peaks_are_over_what_the_solver_steps_on(case, solver, between):
    """All steps, or with the adaptive solver the ends of cycles, of 1 s; and the end.

    One flight peaks on its way, at the middle of a cycle or not; the other at its end.
    """
    changes, _, _ = ENDS[case]
    flight = fly_compiled(changed(**changes), solver)
    end = flight.time.item()
    times = np.append(between * np.arange(np.ceil(end / between)), end)
    start = changes.get("start", entry())
    expected = constraints_at(times, start, changes.get("density_scale", 1.0))
    for name, values in expected.items():
        # RK4 of 0.1 s errs by 1e-9 of the way, and an altitude by that over 9 km.
        peak = getattr(flight.peaks, name)
        np.testing.assert_allclose(peak, values.max(), rtol=1e-7, err_msg=name)
    ends_at_its_peak = case == "crashed"
    assert (np.argmax(expected["drag"]) == len(times) - 1) == ends_at_its_peak


@pytest.mark.slow
def test_solvers_agree_on_a_sampled_law(reference):
    scenario = mars_scenario(all_laws["sampled observer"](reference))
    fixed = fly_compiled(scenario, STEP)
    adaptive = fly_compiled(scenario, Adaptive())
    assert fixed.outcome == adaptive.outcome == Outcome.REACHED
    # The observer's poles near -1/0.48 s make the step of 0.1 s err by some
    # (0.1 / 0.48)^4 / 120 = 2e-5 of what the observer does, 1e-6 of the whole.
    np.testing.assert_allclose(fixed.time, adaptive.time, rtol=1e-6)
    for name in ("altitude", "longitude", "velocity"):
        one, other = getattr(fixed.state, name), getattr(adaptive.state, name)
        np.testing.assert_allclose(one, other, rtol=1e-6)


WITHOUT_END = [case for case in ENDS if not has_end(ENDS[case][1])]


@pytest.mark.parametrize("case", WITHOUT_END)
def test_adaptive_steps_name_flights_without_an_end(case):
    changes, outcome, name = ENDS[case]
    scenario = changed(**changes)
    assert_ends(fly_compiled(scenario, Adaptive()), scenario, outcome, name)


def test_an_infinite_peak_on_the_way_is_not_finite():
    """The state stays finite: only the heat rate is beyond all numbers."""
    scenario = changed()
    scenario = with_leaf(scenario, lambda s: s.planet.heating_coefficient, 1e308)
    assert fly_compiled(scenario, STEP).outcome == Outcome.NOT_FINITE


def test_a_flight_ends_right_after_its_start():
    """Sooner than the search resolves: it began before the end, and reached it."""
    scenario = changed(start=entry(path=-60 * degree, altitude=30 * km))
    start = scenario.initial_state.velocity
    scenario = changed(
        start=entry(path=-60 * degree, altitude=30 * km), end_velocity=start - 1e-9
    )
    flight = fly_compiled(scenario, STEP)
    assert flight.outcome == Outcome.REACHED
    assert 0.0 <= flight.time < 1e-9


def test_flight_ends_at_the_first_of_two_conditions_that_are_close():
    """Metres and metres per second meet zero within a step, in either order."""
    scenario = changed()
    at_velocity = fly_compiled(scenario, STEP)
    for metres, name, outcome in (
        (-1.0, "velocity", Outcome.REACHED),
        (1.0, "ground", Outcome.CRASHED),
    ):
        close = with_leaf(
            scenario,
            lambda s: s.termination.conditions["ground"].altitude,
            at_velocity.state.altitude + metres,
        )
        flight = fly_compiled(close, STEP)
        assert_ends(flight, close, outcome, name)


LIMITS = [20.0, 20.037]


@pytest.mark.slow
@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize(
    ("period", "step"),
    [
        (1.0, 1.0),
        (1.0, 0.5),
        (1.0, 0.25),
    ],
)
def test_time_limit_of_a_sampled_law(period, step, limit):
    scenario = mars_scenario(Sampled(bank_profile(), period), time_limit=limit)
    flight = fly_compiled(scenario, FixedStep(step))
    assert flight.outcome == Outcome.TIMED_OUT
    # Rounding of a sum of a few steps.
    np.testing.assert_allclose(flight.time, limit, rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [STEP, Adaptive()], ids=["fixed", "adaptive"])
def test_time_limit_alone(solver):
    scenario = mars_scenario()
    scenario = with_leaf(scenario, lambda s: s.termination, Termination({}, 10.0))
    flight = fly_compiled(scenario, solver)
    assert flight.outcome == Outcome.TIMED_OUT
    np.testing.assert_allclose(flight.time, 10.0, rtol=1e-14)


# Batches and repetition.


def test_vmap_equals_loop():
    scenarios = [changed(**changes) for changes, _, _ in ENDS.values()]
    batch = fly_batch(jax.tree.map(lambda *x: jnp.stack(x), *scenarios), STEP)
    for lane, scenario in enumerate(scenarios):
        alone = fly_compiled(scenario, STEP)
        together = jax.tree.map(lambda x, lane=lane: x[lane], batch)
        assert together.outcome == alone.outcome
        if not has_end(alone.outcome):
            continue
        assert together.ended_by == alone.ended_by
        ours, theirs = (
            jax.tree.leaves((f.time, f.state, f.peaks)) for f in (alone, together)
        )
        for one, other in zip(ours, theirs, strict=True):
            # The compiler may order sums differently in the two programs: rounding,
            # grown along the flight.
            np.testing.assert_allclose(other, one, rtol=1e-11, atol=1e-13)


def test_same_scenario_same_flight():
    one, other = (fly_compiled(changed(), STEP) for _ in range(2))
    assert eqx.tree_equal(one, other)


def test_traces_once():
    """Other numbers, and other end values, do not compile again."""
    traced = eqx.filter_jit(eqx.debug.assert_max_traces(fly, max_traces=1))
    coarse = FixedStep(1.0)
    traced(changed(), coarse)
    traced(changed(end_velocity=600.0, lift_scale=0.9, start=entry(6000.0)), coarse)


def test_history_is_where_direct_flights_end():
    history = fly_compiled(changed(), STEP, 10.0).history
    for entry_number in (9, 13, 20):
        velocity = history.states.velocity[entry_number]
        flight = fly_compiled(changed(end_velocity=velocity), STEP)
        # Two programs with the same truncation error: the last partial step to the end is
        # a whole step in the other, which leaves rounding.
        np.testing.assert_allclose(flight.time, history.time[entry_number], rtol=1e-10)
        for one, other in zip(
            jax.tree.leaves(flight.state), jax.tree.leaves(history.states), strict=True
        ):
            np.testing.assert_allclose(one, other[entry_number], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("step", [1.0, 0.1])
def test_two_end_conditions_that_are_met_at_once_end_a_flight(step):
    """One closes much faster than the other, in other units: the end is found all the
    same, within the time that any other takes."""
    profile = BankProfile(PolynomialProfile([0.5915, 0.0302], 503.0, 6247.0))
    scenario = with_leaf(
        mars_scenario(profile), lambda s: s.planet.density_scale, 1.0432
    )
    flight = fly_compiled(scenario, FixedStep(step))
    assert int(flight.outcome) == Outcome.REACHED
