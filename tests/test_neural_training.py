"""Training of a neural law through the flight: small networks and few steps."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neural_laws import (
    PERIOD,
    SOLVER,
    law_of,
    network_of,
    scenario_of,
    teacher,
)

import jentry.learning.neural_law as training_of_laws
from jentry.campaign import Dispersion, Normal, Uniform, add, monte_carlo
from jentry.campaign.campaign import drawn_inputs
from jentry.flight import fly, misses
from jentry.guidance import BankProfile
from jentry.guidance.neural_law import INPUTS
from jentry.learning import (
    AdamSteps,
    GaussNewtonSteps,
    record_inputs,
    robust_mean,
    train_neural_law,
)
from jentry.learning.flight_residuals import (
    distances,
    flown,
    flown_with_derivatives,
    ground_miss,
    weights_of,
    with_weights,
)
from jentry.learning.training_record import HeldOut, best_of
from jentry.onboard import (
    PolynomialProfile,
)
from jentry.tuning.batch_gradients import Simulation
from jentry.tuning.losses import power_mean
from jentry.units import degree, km


pytestmark = pytest.mark.slow

FLIGHTS = 64
SINE = INPUTS.index("sine of the bank")

TABLE = {
    "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.9, 1.1)),
    "path": Dispersion(
        lambda s: s.initial_state.flight_path_angle,
        Normal(0.0, 0.1 * degree),
        apply=add,
    ),
}

METHODS = (
    AdamSteps(robust_mean, steps=12, flights=FLIGHTS, rate=3e-2),
    GaussNewtonSteps(robust_mean, steps=6, flights=FLIGHTS),
    GaussNewtonSteps(power_mean, steps=2, flights=FLIGHTS),
)

SIMULATION = Simulation(ground_miss, SOLVER)


def start():
    return scenario_of(law_of())


def trained(**options):
    given = {
        "methods": METHODS,
        "held_out": FLIGHTS,
        "judge_every": 4 * FLIGHTS,
        "solver": SOLVER,
    }
    return train_neural_law(start(), TABLE, jax.random.key(4), **(given | options))


@pytest.fixture(scope="module")
def whole():
    return trained()


def test_it_learns(whole):
    first, best = whole.course[0], whole.course[whole.best]
    assert first.distances[0] > 100.0
    assert best.distances[0] < 0.1 * first.distances[0]
    assert [j.method for j in whole.course] == [0, 0, 0, 0, 1, 1, 2]
    assert [j.step for j in whole.course] == [0, 4, 8, 12, 4, 6, 2]
    assert whole.course[-1].flights == 20 * FLIGHTS
    assert whole.best == min(range(7), key=lambda i: whole.course[i].distances[2])


@pytest.mark.filterwarnings("ignore:.*decisions beyond training")
def test_the_final_judgement_is_of_other_flights(whole):
    """By a plain Monte Carlo of the trained scenario: the same statistics, not draws."""
    best = whole.course[whole.best]
    assert whole.final.distances != best.distances
    flights = monte_carlo(
        whole.scenario, TABLE, jax.random.key(99), 256, solver=SOLVER
    ).misses
    off = np.hypot(flights.downrange, flights.crossrange) / km
    assert np.median(off) == pytest.approx(whole.final.distances[0], rel=0.5)


def test_the_ranges_are_those_of_its_own_flights(whole):
    law = whole.scenario.guidance
    runs = drawn_inputs(whole.scenario, TABLE, jax.random.key(98), np.arange(FLIGHTS))
    read = record_inputs(whole.scenario, law, runs, SOLVER).inputs
    read = read[np.all(np.isfinite(read), axis=-1)]
    lower, upper = np.asarray(law.network.input_ranges).T
    width = (upper - lower) / 1.2
    assert np.all(read >= lower) and np.all(read <= upper)
    varies = width > 1e-6
    assert np.all(np.ptp(read, axis=0)[varies] > 0.7 * width[varies])


class Stopped(Exception):
    pass


def test_no_flight_is_used_twice(monkeypatch):
    """Steps, trials, judgements, the final one and the ranges have draws of their own."""
    drawn = []

    def remember(*given):
        found = drawn_inputs(*given)
        drawn.append(found["planet.density_scale"])
        return found

    monkeypatch.setattr(training_of_laws, "drawn_inputs", remember)
    few = (
        AdamSteps(robust_mean, steps=2, flights=FLIGHTS),
        GaussNewtonSteps(robust_mean, steps=2, flights=FLIGHTS),
    )
    found = trained(methods=few, judge_every=FLIGHTS)
    judgements = len(found.course)
    # Four steps, two trials, the final judgement and the ranges; and the judgements.
    assert len(drawn) == 4 + 2 + 2 + judgements
    different = {values.tobytes() for values in drawn}
    assert len(different) == 4 + 2 + 2 + 1
    numbers = np.concatenate([np.frombuffer(values) for values in different])
    assert len(np.unique(numbers)) == len(numbers)


def test_beside_another_law_the_trained_one_is_judged_with_its_ranges():
    beside = scenario_of(law_of(beside=teacher().guidance, corrects=True))
    one = AdamSteps(robust_mean, steps=2, flights=FLIGHTS)
    found = train_neural_law(
        beside,
        TABLE,
        jax.random.key(2),
        methods=(one,),
        held_out=FLIGHTS,
        solver=SOLVER,
    )
    flown_again = monte_carlo(
        found.scenario, TABLE, jax.random.key(97), FLIGHTS, solver=SOLVER
    )
    beyond = np.asarray(flown_again.flights.caveats["decisions_beyond_training"])
    assert np.mean(beyond) < 0.01
    runs = drawn_inputs(found.scenario, TABLE, jax.random.key(97), np.arange(FLIGHTS))
    read = record_inputs(found.scenario, law_of(), runs, SOLVER).inputs
    history = monte_carlo(
        found.scenario,
        TABLE,
        jax.random.key(97),
        FLIGHTS,
        solver=SOLVER,
        history=PERIOD,
    ).flights.history
    own = np.sin(history.decisions.bank)[:, :5]
    np.testing.assert_allclose(read[:, 1:6, SINE], own, rtol=1e-9, atol=1e-12)


def test_an_inner_model_that_is_dispersed_is_the_one_that_reads():
    model = {
        "model": Dispersion(
            lambda s: s.guidance.model.planet.density_scale, Uniform(0.5, 2.0)
        )
    }
    runs = drawn_inputs(start(), model, jax.random.key(3), np.arange(FLIGHTS))
    read = record_inputs(start(), law_of(), runs, SOLVER).inputs
    ratio = read[:, 8, INPUTS.index("ln of the sensed drag, over that of the model")]
    factor = runs["guidance.model.planet.density_scale"]
    np.testing.assert_allclose(ratio, -np.log(factor), atol=0.05)


@pytest.mark.parametrize("after", [3, 5])
def test_a_training_resumes_bit_for_bit(whole, tmp_path, after):
    """Stopped within the first method, and within the second."""
    seen = []

    def stop(judged):
        seen.append(judged)
        if len(seen) == after:
            raise Stopped

    store = tmp_path / "course.npz"
    with pytest.raises(Stopped):
        trained(store=store, report=stop)
    again = trained(store=store)
    assert eqx.tree_equal(again.scenario.guidance, whole.scenario.guidance)
    for a, b in zip(again.course, whole.course, strict=True):
        a, b = (
            dataclasses.replace(x, seconds=0.0, loss=np.nan_to_num(x.loss))
            for x in (a, b)
        )
        assert a == b
    # Once more: all is done, and nothing is flown but the final judgement.
    assert trained(store=store, report=stop).course == again.course
    with pytest.raises(ValueError, match="holds another training: judge every"):
        trained(store=store, judge_every=5 * FLIGHTS)
    store.write_bytes(store.read_bytes()[:-100])
    with pytest.raises(ValueError, match="is no record of a training"):
        trained(store=store)


def test_a_method_ends_without_progress(tmp_path):
    """At a rate of zero nothing gets better."""
    still = AdamSteps(robust_mean, steps=20, flights=FLIGHTS, rate=0.0)
    given = {"methods": (still,), "patience": 2, "judge_every": FLIGHTS}
    found = trained(**given)
    assert len(found.course) == 3
    assert found.best == 0
    seen = []

    def stop(judged):
        seen.append(judged)
        if len(seen) == 3:
            raise Stopped

    store = tmp_path / "course.npz"
    with pytest.raises(Stopped):
        trained(store=store, report=stop, **given)
    assert len(trained(store=store, **given).course) == 3
    with pytest.raises(ValueError, match="patience is 0"):
        trained(patience=0)


def test_a_method_begins_where_the_one_before_was_best():
    """Steps that are far too long, and then none."""
    wild = AdamSteps(robust_mean, steps=3, flights=FLIGHTS, rate=3.0)
    still = AdamSteps(robust_mean, steps=1, flights=FLIGHTS, rate=0.0)
    course = trained(methods=(wild, still), judge_every=FLIGHTS).course
    best = min(course[:-1], key=lambda j: j.distances[2])
    assert course[-2].distances != best.distances
    assert course[-1].distances == best.distances


def test_weights_are_better_by_the_percentile_that_is_asked_for():
    """Two judgements of which each is better by one percentile."""
    first, *_ = trained(methods=METHODS[:1]).course
    near = dataclasses.replace(first, distances=(1.0, 2.0, 3.0, 9.0))
    safe = dataclasses.replace(first, distances=(2.0, 3.0, 4.0, 5.0))
    lost = dataclasses.replace(near, without_end=1)
    assert [best_of([near, safe, lost], p) for p in (50.0, 99.0, 99.9)] == [0, 0, 1]
    assert best_of([lost, safe], 50.0) == 1
    assert best_of([], 99.0) is None


@pytest.mark.parametrize("percentile, best", [(50.0, 1), (99.0, 2), (99.9, 3)])
def test_the_best_weights_are_those_of_the_percentile(monkeypatch, percentile, best):
    """Of judgements that are given: each of the last three is best by one percentile."""
    judged = [(9.0, 9.0, 9.0, 9.0), (1.0, 5.0, 5.0, 5.0)]
    judged += [(5.0, 5.0, 1.0, 5.0), (5.0, 5.0, 5.0, 1.0), (9.0, 9.0, 9.0, 9.0)]
    given = iter(judged)

    def on_held_out(self, scenario, purpose):
        return HeldOut(next(given), 0)

    training = training_of_laws._Training
    monkeypatch.setattr(training, "on_held_out", on_held_out)
    three = AdamSteps(robust_mean, steps=3, flights=FLIGHTS)
    found = trained(methods=(three,), judge_every=FLIGHTS, judged_by=percentile)
    assert found.best == best
    assert found.final.step == best


def test_widths_scale_the_dispersions_of_a_method():
    """With a width near zero the flights of a step are one flight."""
    losses = []
    for width in (1e-9, 1.0):
        one = AdamSteps(power_mean, steps=1, flights=FLIGHTS)
        found = trained(methods=(one,), widths=[width])
        losses.append(found.course[-1].loss)
    nominal = fly(start(), SOLVER, None)
    missed = misses(start(), nominal)
    alone = np.hypot(missed.downrange, missed.crossrange) / km
    assert losses[0] == pytest.approx(float(alone), rel=1e-6)
    assert abs(losses[1] - losses[0]) > 1e-3


def test_a_method_says_which_derivatives_are_large():
    """By the median of a step half of its flights have larger ones."""
    clipped = []
    for large in (1.0, 1e9):
        one = AdamSteps(robust_mean, steps=1, flights=FLIGHTS, large=large)
        clipped.append(trained(methods=(one,)).course[-1].clipped)
    assert clipped == [FLIGHTS // 2, 0]


def test_what_cannot_be_trained_is_refused():
    with pytest.raises(ValueError, match="3 methods and 2 widths"):
        trained(widths=[1.0, 1.0])
    with pytest.raises(ValueError, match="judged_by is 90.0: choose from 50.0, 95.0"):
        trained(judged_by=90.0)
    with pytest.raises(ValueError, match="held_out is 0"):
        trained(held_out=0)
    other = dataclasses.replace(
        start(), guidance=BankProfile(PolynomialProfile(jnp.ones(1)))
    )
    with pytest.raises(ValueError, match="a NeuralLaw is trained"):
        train_neural_law(other, TABLE, jax.random.key(0))


def test_derivatives_of_flights_are_those_of_differences():
    scenario = start()
    runs = drawn_inputs(scenario, TABLE, jax.random.key(5), np.arange(FLIGHTS))
    found = flown_with_derivatives(scenario, SIMULATION, runs)
    assert np.all(found.finite)
    vector = weights_of(scenario)
    along = np.random.default_rng(0).normal(0.0, 1.0, vector.shape)
    along /= np.linalg.norm(along)

    def residuals(size):
        return flown(with_weights(scenario, vector + size * along), SIMULATION, runs)[0]

    coarse, fine = ((residuals(h) - residuals(-h)) / (2.0 * h) for h in (2e-4, 1e-4))
    expected = fine + (fine - coarse) / 3.0
    np.testing.assert_allclose(
        found.derivatives @ along,
        expected,
        rtol=1e-5,
        atol=1e-6 * np.abs(expected).max(),
    )
    np.testing.assert_array_equal(found.residuals, residuals(0.0))
    np.testing.assert_allclose(
        distances(found.residuals), np.hypot(*found.residuals.T), rtol=1e-14
    )


def test_weights_go_in_and_out():
    scenario = start()
    vector = weights_of(scenario)
    assert eqx.tree_equal(with_weights(scenario, vector), scenario)
    moved = weights_of(with_weights(scenario, vector + 1.0))
    np.testing.assert_allclose(moved, vector + 1.0, rtol=1e-14)
    plain = scenario_of(law_of(network_of(memory=0)))
    assert eqx.tree_equal(with_weights(plain, weights_of(plain)), plain)
