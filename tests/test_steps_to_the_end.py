"""The last steps to the end: their number is bounded, and they leave no NaN behind."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario
from jax import lax

from jentry.flight import FixedStep, Outcome, fly
from jentry.flight.closed_loop import select
from jentry.flight.cycle import _next_trial, steps_to_the_end
from jentry.flight.lane import Bracket


STEP = 0.1
"""s"""

LIMIT = 5.0
"""s; the flights below end about then"""

TOLERANCE = 1e-9
"""s, within which the steps come to the end"""


def steps_taken(margin):
    """How many steps go to the zero of a margin in a step, and how far off they stop."""
    inf = jnp.asarray(jnp.inf)
    zero = jnp.zeros(())
    bracket = Bracket(jnp.asarray(STEP), margin(zero), inf, zero, inf)

    def step(known, _):
        time, bracket, count = known
        there = margin(time + bracket.trial)
        taken = there > 0.0
        going = bracket.trial > 0.0
        after = _next_trial(bracket, there, taken, STEP)
        time = jnp.where(going & taken, time + bracket.trial, time)
        return (time, select(going, after, bracket), count + going), None

    known = zero, bracket, jnp.asarray(0)
    # The first step finds that the end is in it.
    most = steps_to_the_end(STEP) + 1
    (time, bracket, count), _ = lax.scan(step, known, length=most)
    return time, bracket.trial, count


@jax.jit
@jax.vmap
def of_two(ends, rates, bends):
    """Of the smaller of two bent margins."""

    def margin(time):
        to_go = ends - time
        return jnp.min(rates * to_go * (1.0 + bends * to_go / STEP))

    return steps_taken(margin)


def test_steps_to_the_end_are_bounded_for_any_pair_of_conditions():
    """Of rates that differ by up to eight orders, and ends by up to eight below a step."""
    random = np.random.default_rng(8)
    shape = 20_000, 2
    apart = 10.0 ** random.uniform(-9, -1, shape[0]) * random.choice([-1, 1], shape[0])
    first = random.uniform(0.0, STEP, shape[0])
    ends = np.stack([first, first + apart], axis=-1)
    rates = 10.0 ** random.uniform(-3, 5, shape)
    bends = random.uniform(-0.3, 0.3, shape)
    inside = (ends.min(axis=1) > 1e-6) & (ends.min(axis=1) < STEP - 1e-6)
    ends, rates, bends = ends[inside], rates[inside], bends[inside]

    time, trial, count = of_two(ends, rates, bends)
    assert np.all(trial == 0.0), "some did not arrive within the bound"
    # Within the tolerance of the bracket, or as the slope of the last step has it: it may
    # be off by the bends, which do not matter over such a distance.
    off = ends.min(axis=1) - np.asarray(time)
    assert np.all((off >= 0.0) & (off < 2.0 * TOLERANCE))
    assert np.max(count) > 12, "the case is too easy to need a bound"


def test_a_single_condition_takes_few_steps():
    random = np.random.default_rng(9)
    first = random.uniform(1e-6, STEP - 1e-6, 5000)
    ends = np.stack([first, np.full(5000, 1e3)], axis=-1)
    rates = np.stack([10.0 ** random.uniform(-3, 5, 5000), np.full(5000, 1e9)], axis=-1)
    bends = random.uniform(-0.1, 0.1, (5000, 1)) * np.array([1.0, 0.0])
    *_, count = of_two(ends, rates, bends)
    assert np.max(count) <= 8


# Flights ------------------------------------------------------------------------------


def descent():
    """Low in the atmosphere, falling fast: altitude and velocity both come down."""
    return eqx.tree_at(
        lambda s: (
            s.initial_state.altitude,
            s.initial_state.velocity,
            s.initial_state.flight_path_angle,
        ),
        mars_scenario(time_limit=LIMIT),
        (jnp.asarray(16e3), jnp.asarray(1500.0), jnp.asarray(-0.3)),
    )


NEVER = jnp.array([-1e5, 1.0])
"""An altitude (m) and a velocity (m/s) that are not met"""


def flown(ends, path):
    """A flight to the first of an altitude and a velocity, from a flight-path angle."""
    conditions = lambda s: s.termination.conditions
    scenario = eqx.tree_at(
        lambda s: (
            conditions(s)["altitude"].altitude,
            conditions(s)["velocity"].velocity,
            s.initial_state.flight_path_angle,
        ),
        descent(),
        (ends[0], ends[1], path),
    )
    return fly(scenario, FixedStep(STEP))


fly_to = eqx.filter_jit(jax.vmap(flown, (0, None)))
PATH = jnp.asarray(-0.3)


def before_the_limit(seconds):
    """Altitude and velocity so long before the time limit, from a line through two times.

    The lines bend by less than 1e-3 of the time: where flights end is measured, not this.
    """
    limit = fly_to(NEVER[None], PATH)
    assert limit.outcome[0] == Outcome.TIMED_OUT
    altitude, velocity = limit.state.altitude[0], limit.state.velocity[0]
    close = jnp.array([[altitude + 1.0, 1.0]])
    earlier = fly_to(close, PATH)
    gap = LIMIT - earlier.time[0]
    slowing = (earlier.state.velocity[0] - velocity) / gap
    return altitude + seconds / gap, velocity + slowing * seconds


@pytest.mark.slow
def test_ends_just_before_the_time_limit_are_reached():
    """The time limit is a condition too, and its margin closes at another rate."""
    seconds = np.geomspace(1e-6, 0.09, 400)
    altitudes, velocities = before_the_limit(seconds)
    for column, values in enumerate((altitudes, velocities)):
        ends = np.tile(np.asarray(NEVER), (400, 1))
        ends[:, column] = values
        flight = fly_to(jnp.asarray(ends), PATH)
        assert np.all(flight.outcome == Outcome.REACHED)
        ended_at = (flight.state.altitude, flight.state.velocity)[column]
        np.testing.assert_allclose(ended_at, values, rtol=0, atol=1e-9)
        np.testing.assert_allclose(LIMIT - flight.time, seconds, rtol=3e-2, atol=1e-9)


def test_of_two_conditions_the_first_ends_the_flight():
    apart = np.concatenate(
        [np.geomspace(1e-8, 0.05, 100), -np.geomspace(1e-8, 0.05, 100)]
    )
    altitudes, _ = before_the_limit(np.full(200, 1.03))
    _, velocities = before_the_limit(1.03 + apart)
    never = np.tile(np.asarray(NEVER), (200, 1))
    alone = []
    for column, values in enumerate((altitudes, velocities)):
        ends = never.copy()
        ends[:, column] = values
        alone.append(np.asarray(fly_to(jnp.asarray(ends), PATH).time))
    both = fly_to(jnp.stack([altitudes, velocities], axis=-1), PATH)
    assert np.all(both.outcome == Outcome.REACHED)
    first = np.minimum(*alone)
    np.testing.assert_allclose(both.time, first, rtol=0, atol=1e-9)
    clear = np.abs(alone[0] - alone[1]) > 1e-8
    assert clear.sum() > 150
    chosen = np.asarray(both.ended_by)[clear]
    np.testing.assert_array_equal(chosen, np.argmin(alone, axis=0)[clear])


@pytest.fixture(scope="module")
def shallow():
    """Ends on an altitude at a shallow angle, with their gradients in reverse mode."""
    random = np.random.default_rng(3)
    paths = -(10.0 ** random.uniform(-4.5, -2.0, 4000))
    drops = 10.0 ** random.uniform(-3.0, 1.0, 4000)

    def range_of(path, drop):
        flight = flown(jnp.stack([16e3 - drop, NEVER[1]]), path)
        return flight.state.longitude, flight

    gradient = jax.grad(range_of, argnums=(0, 1), has_aux=True)
    gradient = eqx.filter_jit(jax.vmap(gradient))
    return gradient(jnp.asarray(paths), jnp.asarray(drops))


@pytest.mark.slow
def test_reverse_mode_is_finite_in_flights_that_reached(shallow):
    (of_path, of_drop), flight = shallow
    reached = np.asarray(flight.outcome == Outcome.REACHED)
    assert reached.mean() > 0.9
    assert np.all(np.isfinite(np.asarray(of_path)[reached]))
    assert np.all(np.isfinite(np.asarray(of_drop)[reached]))


@pytest.mark.slow
def test_reverse_mode_of_shallow_ends_is_that_of_the_descent(shallow):
    """A longer drop goes on by the ground speed over the rate of descent, at the end."""
    (_, of_drop), flight = shallow
    state = flight.state
    steep = np.asarray(state.flight_path_angle) < -1e-3
    reached = steep & np.asarray(flight.outcome == Outcome.REACHED)
    radius = 3397e3 + np.asarray(state.altitude)
    expected = -1.0 / np.tan(np.asarray(state.flight_path_angle)) / radius
    assert reached.sum() > 1000
    np.testing.assert_allclose(
        np.asarray(of_drop)[reached], expected[reached], rtol=1e-7
    )
