"""The policy gradient of the benchmark of the neural law, piece by piece."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neural_laws import SOLVER, law_of, scenario_of
from pages import benchmark

from jentry.campaign import Dispersion, Uniform
from jentry.campaign.campaign import drawn_inputs
from jentry.learning.flight_residuals import distances, flown, ground_miss
from jentry.tuning.batch_gradients import Simulation


policy_gradient = benchmark("policy_gradient")

FLIGHTS, DEVIATION = 64, 0.3
SIMULATION = Simulation(ground_miss, SOLVER)
SETTINGS = policy_gradient.Settings(
    updates=1, flights=FLIGHTS, batch=32, first_deviation=DEVIATION
)


def density(scenario):
    return scenario.planet.density_scale


TABLE = {"density": Dispersion(density, Uniform(0.9, 1.1))}


def test_the_objective_has_no_slope_where_a_ratio_has_gone_far_enough():
    ratios = np.array([0.5, 0.9, 1.0, 1.1, 1.5] * 2)
    advantages = np.repeat([2.0, -3.0], 5)
    expected = [
        min(r * a, min(max(r, 0.8), 1.2) * a)
        for r, a in zip(ratios, advantages, strict=True)
    ]
    of = lambda r: policy_gradient.clipped_objective(r, jnp.asarray(advantages), 0.2)
    np.testing.assert_allclose(of(jnp.asarray(ratios)), expected, rtol=1e-14)
    slopes = jax.grad(lambda r: jnp.sum(of(r)))(jnp.asarray(ratios))
    gone = (advantages > 0) & (ratios > 1.2) | (advantages < 0) & (ratios < 0.8)
    np.testing.assert_array_equal(slopes, np.where(gone, 0.0, advantages))


@pytest.mark.parametrize("trace", [0.0, 0.9, 1.0])
def test_advantages_are_discounted_sums_of_errors(trace):
    rng = np.random.default_rng(0)
    ends, cycles = [3, 5, 1, 0], 5
    flying = np.arange(cycles) < np.array(ends)[:, None]
    values, rewards = rng.normal(size=(4, cycles)), rng.normal(size=4)
    expected = np.zeros((4, cycles))
    for flight, end in enumerate(ends):
        later = [*values[flight, 1:end], rewards[flight]]
        for cycle in range(end):
            expected[flight, cycle] = sum(
                trace ** (k - cycle) * (later[k] - values[flight, k])
                for k in range(cycle, end)
            )
    found = policy_gradient.advantages_of(values, flying, rewards, trace)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
    if trace == 1.0:
        off = np.where(flying, rewards[:, None] - values, 0.0)
        np.testing.assert_allclose(found, off, rtol=1e-12, atol=1e-14)


def test_the_density_is_that_of_a_normal_distribution():
    actions = np.linspace(-30.0, 30.0, 60_001)
    found = np.exp(policy_gradient.log_density(actions, 0.5, np.log(1.7)))
    step = actions[1] - actions[0]
    # The trapezoidal rule is exact to rounding for such functions.
    moments = [step * np.sum(found * (actions - 0.5) ** n) for n in (0, 1, 2)]
    np.testing.assert_allclose(moments, [1.0, 0.0, 1.7**2], rtol=1e-12, atol=1e-12)


def explored(runs=FLIGHTS, deviation=DEVIATION, seed=5):
    """Flights of a small law with noise, and their distances."""

    def draw(noisy):
        table = policy_gradient.with_noise(TABLE)
        return drawn_inputs(noisy, table, jax.random.key(seed), np.arange(runs))

    law = law_of()
    noise = np.log(deviation) if deviation else -np.inf
    return policy_gradient.explored(
        scenario_of(law), law, jnp.asarray(noise), SIMULATION, draw
    )


@pytest.fixture(scope="module")
def flights():
    return explored()


@pytest.fixture(scope="module")
def learner():
    return policy_gradient.Learner(law_of().network, SETTINGS)


def noise_of(learner, flights):
    trained = learner.weights.actor
    means = policy_gradient.along(learner.network, trained, flights.inputs)
    return np.asarray((flights.actions - means) / DEVIATION)


def test_every_run_and_every_cycle_has_its_own_noise(flights, learner):
    found, _ = flights
    noise = noise_of(learner, found)[found.flying]
    assert len(noise) > 1000
    assert len(np.unique(noise.round(9))) == len(noise)
    # Four standard errors of a mean, and of a deviation.
    assert abs(noise.mean()) < 4.0 / np.sqrt(len(noise))
    assert abs(noise.std() - 1.0) < 4.0 / np.sqrt(2.0 * len(noise))


def test_the_noise_is_that_of_the_seed(flights, learner):
    again, other = explored(runs=32), explored(seed=6)
    cycles = min(x[0].inputs.shape[1] for x in (flights, again))
    np.testing.assert_array_equal(
        again[0].actions[:, :cycles], flights[0].actions[:32, :cycles]
    )
    np.testing.assert_array_equal(again[1], flights[1][:32])
    both = flights[0].flying[:, 0] & other[0].flying[:, 0]
    first = [noise_of(learner, x[0])[both, 0] for x in (flights, other)]
    assert np.all(first[0] != first[1])


def test_before_the_first_step_all_ratios_are_one(flights, learner):
    """The update builds the memories up again, from the recorded inputs."""
    found, _ = flights
    ratios = np.asarray(learner.ratios(learner.weights, found))
    assert np.sum(found.flying) > 1000
    # The scan adds up in another order than the flight.
    np.testing.assert_allclose(ratios, 1.0, rtol=0, atol=1e-10)


def test_flights_end_and_are_rewarded_for_their_own_distance(flights):
    found, off = flights
    count = found.flying.sum(axis=1)
    assert np.all(found.flying == (np.arange(found.flying.shape[1]) < count[:, None]))
    ended = np.isfinite(off)
    assert ended.any() and np.all((count > 0) == ended)
    np.testing.assert_allclose(
        found.rewards[ended], -np.log(np.hypot(off[ended], 0.1)), rtol=1e-12
    )
    assert np.all(found.inputs[~found.flying] == 0.0)


def test_without_noise_the_law_flies_itself():
    _, off = explored(deviation=0.0)
    scenario = scenario_of(law_of())
    runs = drawn_inputs(scenario, TABLE, jax.random.key(5), np.arange(FLIGHTS))
    residuals, finite = flown(scenario, SIMULATION, runs)
    np.testing.assert_array_equal(np.isfinite(off), finite)
    # Two programs of the same flight round differently.
    np.testing.assert_allclose(off[finite], distances(residuals)[finite], rtol=1e-7)


def test_an_update_makes_what_paid_more_likely(flights):
    found, _ = flights
    learner = policy_gradient.Learner(law_of().network, SETTINGS)
    before = learner.weights
    shown = learner.learn(found, np.random.default_rng(0))
    assert 0.0 <= shown["clipped"] < 0.5
    values = policy_gradient.along(learner.network, before.critic, found.inputs)
    advantages = policy_gradient.advantages_of(
        values, jnp.asarray(found.flying), jnp.asarray(found.rewards), SETTINGS.trace
    )
    counted = np.asarray(advantages)[found.flying]
    change = np.asarray(learner.ratios(learner.weights, found))[found.flying] - 1.0
    assert np.sum(change * (counted - counted.mean())) > 0.0


@pytest.mark.slow
def test_it_learns():
    start = scenario_of(law_of())
    runs = drawn_inputs(start, TABLE, jax.random.key(1), np.arange(FLIGHTS))

    def judged(scenario):
        residuals, finite = flown(scenario, SIMULATION, runs)
        off = np.where(finite, distances(residuals), np.inf)
        return [float(np.median(off))]

    settings = SETTINGS._replace(updates=40, rate=1e-2, first_deviation=0.2)
    course = policy_gradient.course_of(
        start, TABLE, SIMULATION, 0, judged, settings, judge_every=20
    )
    assert [flights for flights, _ in course] == [1280, 2560]
    assert course[-1][1][0] < 0.5 * judged(start)[0]
