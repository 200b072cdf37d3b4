"""Derivatives through segments of a flight, and the value at their ends."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from neural_laws import ANGLES, SOLVER, gliding_scenario_of, law_of
from test_neural_training import FLIGHTS, SIMULATION, TABLE, Stopped, start, trained

from jentry.addresses import replace_leaves
from jentry.campaign.campaign import drawn_inputs
from jentry.flight.closed_loop import start as begun
from jentry.flight.cycle import Plan
from jentry.flight.flight import landed, ready
from jentry.flight.loop import while_running
from jentry.flight.scenario import Scenario
from jentry.learning import AdamSteps, Segments, robust_mean
from jentry.learning.flight_residuals import (
    flown,
    flown_with_derivatives,
    ground_miss,
)
from jentry.learning.flight_segments import (
    Noise,
    flown_in_segments,
    noisy_samples,
)
from jentry.learning.segment_value import Learner, Samples, Value


CYCLES = 12
"""Guidance cycles of a segment: a flight has some seven"""


def small(cycles=CYCLES, **options):
    return Segments(cycles, **({"hidden": (8,), "steps": 20, "samples": 64} | options))


# -- the value, without a flight


def known_samples(count=400, segments=3):
    """Residuals that are a function of two of three inputs; the third is constant. At the
    end of each segment the inputs are about another number, in another unit."""
    draws = np.random.default_rng(1)
    residuals = draws.normal(0.0, 5.0, (count, 2)) + np.array([40.0, 0.0])
    units = 10.0 ** np.arange(segments)[:, None]
    read = (residuals @ MIXED)[:, None] * units + 50.0 * units**2
    read = np.concatenate([read, np.full((count, segments, 1), 7.0)], axis=-1)
    there = draws.random((count, segments)) < 0.7
    return Samples(np.where(there[..., None], read, 0.0), there, residuals)


MIXED = np.array([[1.0, 0.3], [-0.2, 2.0]])


@pytest.mark.slow
def test_a_value_learns_a_function_and_its_derivative():
    """A linear one, whose inverse numpy knows. The spread of the residuals is 5."""
    segments, samples = Segments(5, steps=400, rate=3e-3), known_samples()
    value = Learner.begun(segments, samples, jax.random.key(0)).value
    inverse = np.linalg.inv(MIXED).T
    for place in range(3):
        there = samples.there[:, place]
        read = jnp.asarray(samples.inputs[there, place])
        at = lambda x, place=jnp.asarray(place): value(x, place)
        off = np.asarray(jax.vmap(at)(read)) - samples.residuals[there]
        assert np.median(np.linalg.norm(off, axis=-1)) < 0.25
        slopes = 10.0**place * np.median(jax.vmap(jax.jacrev(at))(read), axis=0)
        np.testing.assert_allclose(slopes[:, :2], inverse, atol=0.05)
        np.testing.assert_array_equal(slopes[:, 2], 0.0)


def test_a_value_that_has_learnt_nothing_is_the_mean_without_a_derivative():
    samples, last = known_samples(), jnp.asarray(2)
    value = Value.untrained(samples, (8,), jax.random.key(0))
    some = jnp.asarray(samples.inputs[samples.there][0])
    mean = samples.residuals[np.any(samples.there, axis=1)].mean(axis=0)
    np.testing.assert_allclose(value(some, last), mean, rtol=1e-12)
    np.testing.assert_array_equal(jax.jacrev(value)(some, last), 0.0)
    assert value.reached == samples.reached == 2


def test_other_residuals_normalise_a_value_and_leave_its_function():
    samples, one = known_samples(), jnp.asarray(1)
    value = Learner.begun(small(), samples, jax.random.key(0)).value
    other = samples._replace(residuals=0.01 * samples.residuals - 3.0)
    about, some = value.about(other), jnp.asarray(samples.inputs[samples.there][0])
    np.testing.assert_allclose(about(some, one), value(some, one), rtol=1e-9)
    np.testing.assert_allclose(about.spread, 0.01 * value.spread, rtol=1e-9)


def test_a_learner_comes_back_from_its_arrays():
    segments, samples = small(hidden=(8, 5)), known_samples()
    learner = Learner.begun(segments, samples, jax.random.key(0))
    again = Learner.of_arrays(segments, learner.as_arrays())
    key = jax.random.key(3)
    one, other = (x.taught(segments, samples, key) for x in (learner, again))
    assert eqx.tree_equal(one, other)
    assert not eqx.tree_equal(one.value, learner.value)
    nothing = samples._replace(there=np.zeros_like(samples.there))
    assert learner.taught(segments, nothing, key) is learner


@pytest.mark.parametrize(
    "options, message",
    [
        ({"cycles": 0}, "cycles is 0: it must be a whole number, at least 1"),
        ({"samples": -1}, "samples is -1"),
        ({"hidden": (8, 0)}, r"hidden is \(8, 0\)"),
        ({"noise": 0.0}, "noise is 0.0: it must be positive and finite"),
        ({"rate": np.nan}, "rate is nan"),
    ],
)
def test_segments_that_cannot_be_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Segments(**({"cycles": 5} | options))


def test_segments_longer_than_the_flights_are_refused():
    nothing = Samples(np.zeros((4, 2, 3)), np.zeros((4, 2), bool), np.zeros((4, 2)))
    with pytest.raises(ValueError, match="none of 4 flights has an end and more than"):
        Learner.begun(Segments(500), nothing, jax.random.key(0))


# -- through flights

RUNS = 4


class RestOfFlight(eqx.Module):
    """The exact value: the residuals at the end of the rest of a flight."""

    scenario: Scenario
    names: tuple[str, ...] = eqx.field(static=True)
    """Addresses of the dispersed numbers, in the order of their vector"""

    def __call__(self, read, segment):
        numbers = dict(zip(self.names, read[-len(self.names) :], strict=True))
        dispersed = replace_leaves(self.scenario, numbers)
        flying = ready(dispersed)
        plan = Plan.of(flying, SOLVER, None)
        lane = begun(flying, plan.step)
        parts = lane.flown, lane.moving, lane.held, lane.noted.peaks, lane.aiding
        vector, put_back = ravel_pytree(eqx.filter(parts, eqx.is_inexact_array))
        flown, moving, held, peaks, _ = put_back(read[: len(vector)])
        lane = dataclasses.replace(
            lane,
            flown=flown,
            moving=moving,
            held=held,
            noted=dataclasses.replace(lane.noted, peaks=peaks),
        )
        running = lambda lane: lane.running
        lane = while_running(plan.cycle, running, flying, lane, plan.cycles)
        return jnp.stack(ground_miss(dispersed, landed(flying, lane)))


def drawn(count=RUNS):
    return drawn_inputs(start(), TABLE, jax.random.key(5), np.arange(count))


REACHED = 5


def noisy(scenario=None, noise=0.3, seed=1, reached=REACHED, count=FLIGHTS):
    return noisy_samples(
        start() if scenario is None else scenario,
        SIMULATION,
        small(noise=noise),
        drawn(count),
        jax.random.key(seed),
        reached,
    )


@pytest.fixture(scope="module")
def learner():
    """A value with derivatives that are not zero, and what it has learnt from."""
    samples = noisy()
    return samples, Learner.begun(small(), samples, jax.random.key(2))


@pytest.mark.slow
def test_with_the_exact_value_segments_have_the_derivatives_of_whole_flights():
    runs, scenario = drawn(), start()
    exact = RestOfFlight(scenario, tuple(sorted(runs)))
    whole = flown_with_derivatives(scenario, SIMULATION, runs)
    found = flown_in_segments(scenario, SIMULATION, CYCLES, exact, runs)
    assert np.all(found.finite)
    np.testing.assert_array_equal(found.residuals, whole.residuals)
    largest = np.abs(whole.derivatives).max()
    np.testing.assert_allclose(
        found.derivatives, whole.derivatives, rtol=1e-7, atol=1e-8 * largest
    )


@pytest.mark.slow
def test_one_segment_is_the_whole_flight(learner):
    _, found = learner
    runs = drawn()
    whole = flown_with_derivatives(start(), SIMULATION, runs)
    one = flown_in_segments(start(), SIMULATION, 10_000, found.value, runs)
    np.testing.assert_array_equal(one.derivatives, whole.derivatives)
    cut = flown_in_segments(start(), SIMULATION, CYCLES, found.value, runs)
    np.testing.assert_array_equal(cut.residuals, whole.residuals)
    assert np.abs(cut.derivatives - whole.derivatives).max() > 0.0


@pytest.mark.slow
def test_samples_are_the_ends_of_segments_and_what_came_of_them(learner):
    """With noise before: times, and the exact value of the rest of the flight there."""
    samples, _ = learner
    assert 0.2 < np.mean(samples.there) < 0.8 and samples.reached > REACHED
    period = start().guidance.cycle.period
    times = CYCLES * period * np.arange(samples.there.shape[1])
    expected = np.broadcast_to(times, samples.there.shape)[samples.there]
    np.testing.assert_allclose(samples.inputs[samples.there][:, 0], expected, rtol=1e-9)
    names = tuple(sorted(drawn(1)))
    rest = RestOfFlight(start(), names)
    exact = eqx.filter_jit(lambda read, place: jax.vmap(rest, (0, None))(read, place))
    for place in (1, REACHED):
        found = exact(jnp.asarray(samples.inputs[:RUNS, place]), jnp.asarray(place))
        there = samples.there[:RUNS, place]
        np.testing.assert_allclose(
            found[there], samples.residuals[:RUNS][there], rtol=1e-6, atol=1e-6
        )
    assert np.all(samples.there[:, REACHED]) and not np.all(samples.there[:, 1])
    assert np.any(samples.there[:RUNS, 1])


@pytest.mark.slow
def test_noise_moves_each_flight_in_its_own_way(learner):
    samples, _ = learner
    residuals, finite = flown(start(), SIMULATION, drawn(FLIGHTS))
    assert np.all(finite)
    moved = samples.residuals - residuals
    assert np.all(np.abs(moved).max(axis=1) > 1e-3)
    assert abs(np.corrcoef(moved.T)[0, 1]) < 0.9
    assert np.all(noisy(seed=7).residuals != samples.residuals)
    np.testing.assert_array_equal(noisy().residuals, samples.residuals)
    quiet = noisy(reached=0)
    np.testing.assert_array_equal(quiet.residuals, residuals)
    assert not np.any(quiet.there[:, 0]) and np.all(quiet.there[:, 1])


@pytest.mark.slow
def test_an_angle_of_attack_has_noise_within_its_range():
    """Loud noise, so that it is at a limit in most decisions."""
    scenario = gliding_scenario_of(law_of(angles=ANGLES))
    lowest, highest = ANGLES.lowest, ANGLES.highest
    lane = eqx.filter_jit(begun)(ready(scenario), 1.0)
    law = scenario.law
    found = [
        Noise(jnp.asarray(5.0), jnp.asarray(seed), jnp.asarray(1)).added(law, lane).held
        for seed in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    ]
    angles = np.array([held.angle_of_attack for held in found])
    assert np.all((angles >= lowest) & (angles <= highest))
    assert np.any(angles == lowest) and np.any(angles == highest)
    moved = np.array([[held.bank, *held.memory] for held in found])
    moved -= np.array([lane.held.bank, *lane.held.memory])
    assert np.all(np.abs(moved) > 0.0) and 2.0 < moved.std() < 8.0


LEARNT = {
    "methods": (AdamSteps(robust_mean, steps=6, flights=FLIGHTS, rate=3e-2),),
    "judge_every": 2 * FLIGHTS,
    "segments": small(),
}


@pytest.mark.slow
def test_a_training_through_segments_learns_and_resumes_bit_for_bit(tmp_path):
    whole = trained(**LEARNT)
    assert whole.final.distances[0] < 0.9 * whole.course[0].distances[0]
    assert whole.course[-1].flights == 6 * FLIGHTS
    seen, store = [], tmp_path / "course.npz"

    def stop(judged):
        seen.append(judged)
        if len(seen) == 3:
            raise Stopped

    with pytest.raises(Stopped):
        trained(store=store, report=stop, **LEARNT)
    again = trained(store=store, **LEARNT)
    assert eqx.tree_equal(again.scenario.guidance, whole.scenario.guidance)
    assert [j.distances for j in again.course] == [j.distances for j in whole.course]
    with pytest.raises(ValueError, match="holds another training: segments"):
        trained(store=store, **(LEARNT | {"segments": small(CYCLES + 1)}))
    with pytest.raises(ValueError, match="holds another training: segments"):
        trained(store=store, **(LEARNT | {"segments": None}))


@pytest.mark.slow
def test_segments_have_no_history():
    with pytest.raises(ValueError, match="history is 4.0 s and segments are given"):
        trained(history=4.0, segments=small())
