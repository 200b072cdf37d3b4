"""Training of a neural law through the flight: small networks and few steps."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neural_laws import (
    ANGLES,
    PERIOD,
    SOLVER,
    gliding_scenario_of,
    law_of,
    network_of,
    scenario_of,
)

import jentry.learning.neural_law as training_of_laws
from jentry.campaign import Dispersion, Normal, Uniform, add, monte_carlo
from jentry.campaign.campaign import drawn_inputs
from jentry.flight import fly, misses
from jentry.guidance import BankProfile, Sampled
from jentry.guidance.neural_law import INPUTS, PURPOSE, inputs_of
from jentry.learning import (
    AdamSteps,
    GaussNewtonSteps,
    LawTraining,
    Recording,
    imitated,
    record_inputs,
    robust_mean,
    train_law,
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
from jentry.learning.law_training import random_law
from jentry.learning.training_record import best_of
from jentry.onboard import (
    Measurement,
    PolynomialProfile,
    load_recurrent_network,
    measure,
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
        return {"distances": next(given), "without_end": 0}

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


def teacher():
    """Banks by a polynomial over the velocity, to the right."""
    law = Sampled(BankProfile(PolynomialProfile(jnp.array([0.2, 1e-4]))), PERIOD)
    return scenario_of(law)


def test_a_recorded_law_flies_as_it_does_and_holds_what_is_read():
    scenario, model = teacher(), law_of().model
    runs = drawn_inputs(scenario, TABLE, jax.random.key(6), np.arange(FLIGHTS))
    recording = record_inputs(scenario, law_of(first_bank=0.4), runs, SOLVER)
    assert recording.inputs[:, 0, SINE : SINE + 2] == pytest.approx(
        np.tile([np.sin(0.4), np.cos(0.4)], (FLIGHTS, 1))
    )
    history = monte_carlo(
        scenario, TABLE, jax.random.key(6), FLIGHTS, solver=SOLVER, history=PERIOD
    ).flights.history
    flying = np.isfinite(history.time)
    np.testing.assert_array_equal(np.isfinite(recording.banks), flying)
    np.testing.assert_array_equal(np.all(np.isfinite(recording.inputs), -1), flying)
    banks = np.arctan2(history.controls.sin_bank, history.controls.cos_bank)
    np.testing.assert_allclose(recording.banks[flying], banks[flying], rtol=1e-12)
    # Of one flight: state and true forces in the measurement, and the bank before.
    states = jax.tree.map(lambda x: jnp.asarray(x[2, 5]), history.states)
    density = float(runs["planet.density_scale"][2])
    planet = eqx.tree_at(
        lambda p: p.density_scale, scenario.planet, jnp.asarray(density)
    )
    angle = scenario.vehicle.trim_angle_of_attack
    forces = measure(planet, scenario.vehicle, states, angle)
    read = inputs_of(
        model,
        start().law.aim,
        Measurement(states, forces.lift, forces.drag, angle, angle, {}),
        jnp.asarray(banks[2, 4]),
    )
    np.testing.assert_allclose(recording.inputs[2, 5], read, rtol=1e-9, atol=1e-12)


def test_only_a_sampled_law_is_recorded():
    scenario = dataclasses.replace(
        teacher(), guidance=BankProfile(PolynomialProfile(jnp.ones(1)))
    )
    with pytest.raises(ValueError, match="recorded is a sampled law with a FixedCycle"):
        record_inputs(scenario, law_of(), {}, SOLVER)


def test_an_imitation_flies_like_its_teacher():
    scenario = teacher()
    runs = drawn_inputs(scenario, TABLE, jax.random.key(6), np.arange(FLIGHTS))
    recording = record_inputs(scenario, law_of(), runs, SOLVER)
    said = []
    found = imitated(
        start(), recording, jax.random.key(1), steps=600, rate=2e-2, report=said.append
    )
    assert [line.split(":")[0] for line in said] == [
        "imitation, 500 steps",
        "imitation, 600 steps",
    ]
    ends = [
        monte_carlo(
            s, TABLE, jax.random.key(7), FLIGHTS, solver=SOLVER
        ).misses.downrange
        for s in (start(), scenario, found)
    ]
    before, after = (np.median(np.abs(x - ends[1])) for x in (ends[0], ends[2]))
    assert after < 0.05 * before
    beside = scenario_of(law_of(beside=teacher().guidance))
    with pytest.raises(ValueError, match="imitation is for a network alone"):
        imitated(beside, recording, jax.random.key(1))


def test_banks_alone_are_imitated():
    with_angle = gliding_scenario_of(law_of(angles=ANGLES))
    recording = Recording(np.zeros((2, 3, len(INPUTS) + 1)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="imitation learns banks alone"):
        imitated(with_angle, recording, jax.random.key(1))


def test_trainings_that_do_not_go_together_are_refused_before_they_fly(tmp_path):
    first = training_of()
    with pytest.raises(ValueError, match="memory is 5, and 2 in the training before"):
        dataclasses.replace(first, before=first, memory=5)
    with_angle = dataclasses.replace(first, with_angle=True)
    with pytest.raises(ValueError, match="leave out --imitate"):
        train_law(with_angle, 0, tmp_path, imitate=True)
    (tmp_path / "course.npz").write_bytes(b"of another training")
    both = dataclasses.replace(first, before=first)
    with pytest.raises(ValueError, match="course.npz is of another training"):
        train_law(both, 0, tmp_path)
    assert (both.place, both.first) == (1, first)
    assert dataclasses.replace(both, before=both).place == 2


def training_of(methods=METHODS, **others):
    return LawTraining(
        **others,
        teacher=teacher(),
        with_network=lambda network: scenario_of(law_of(network)),
        dispersions=TABLE,
        methods=methods,
        solver=SOLVER,
        memory=2,
        hidden=(3,),
        taught_flights=FLIGHTS,
        taught_steps=20,
    )


def test_a_training_of_a_mission_stores_the_network_and_its_card(tmp_path):
    few = (AdamSteps(robust_mean, steps=2, flights=FLIGHTS),)
    said, judged = [], []
    found = train_law(
        training_of(few),
        3,
        tmp_path,
        imitate=True,
        card={"mission": "a test"},
        say=said.append,
        report=lambda training, one: judged.append(one),
    )
    network, card = load_recurrent_network(tmp_path / "law.npz", PURPOSE)
    assert eqx.tree_equal(network, found.scenario.guidance.network)
    assert card["mission"] == "a test" and card["seed"] == 3
    assert card["begins with an imitation"] is True
    assert (card["memory"], card["hidden"]) == (2, [3])
    assert tuple(card["held out distance"].values()) == found.final.distances
    assert card["flights with derivatives"] == 2 * FLIGHTS
    assert said[0] == "64 flights of the teacher, Sampled"
    assert [j.step for j in judged] == [0, 2]
    assert set(card["inputs"]) == set(INPUTS)
    assert said[1].startswith("imitation, 20 steps")
    again = train_law(training_of(few), 3, tmp_path, imitate=True)
    assert eqx.tree_equal(again.scenario.guidance, found.scenario.guidance)


def test_a_training_begins_with_the_network_of_the_one_before(tmp_path):
    """In another world: here a heavier vehicle."""

    def heavier(network):
        scenario = scenario_of(law_of(network))
        return eqx.tree_at(
            lambda s: s.vehicle.mass, scenario, replace_fn=lambda m: 2 * m
        )

    few = (AdamSteps(robust_mean, steps=2, flights=FLIGHTS, rate=3e-2),)
    still = (AdamSteps(robust_mean, steps=1, flights=FLIGHTS, rate=0.0),)
    first = training_of(few)
    both = dataclasses.replace(
        training_of(still, before=first), with_network=heavier, dispersions=TABLE
    )
    seen = []
    report = lambda training, judged: seen.append((training is both, judged.step))
    found = train_law(both, 3, tmp_path / "both", report=report)
    assert seen == [(False, 0), (False, 2), (True, 0), (True, 1)]
    alone = train_law(first, 3, tmp_path / "alone")
    before, _ = load_recurrent_network(tmp_path / "both" / "before" / "law.npz")
    assert eqx.tree_equal(before, alone.scenario.guidance.network)
    # Its judgements are of other flights than those of the one before.
    plain = dataclasses.replace(both, with_network=first.with_network, judged_by=50.0)
    again = train_law(plain, 3, tmp_path / "plain")
    first_judged, last_judged = alone.course[alone.best], again.course[0]
    other = dataclasses.replace(plain, judged_by=95.0)
    with pytest.raises(ValueError, match="judged by is 50.0 there and 95.0 now"):
        train_law(other, 3, tmp_path / "plain")
    assert last_judged.distances != first_judged.distances
    assert last_judged.distances[0] == pytest.approx(first_judged.distances[0], rel=0.2)
    last, card = load_recurrent_network(tmp_path / "both" / "law.npz")
    assert eqx.tree_equal(last.trained, before.trained)
    assert float(found.scenario.vehicle.mass) == 2 * float(start().vehicle.mass)
    assert card["begins with another training"] is True
    assert card["flights with derivatives"] == 3 * FLIGHTS
    best = found.course[found.best].flights
    assert card["best after flights"] == 2 * FLIGHTS + best
    assert card["dispersed"] == ["density", "path"]
    assert found.final.distances[0] > 1.1 * alone.final.distances[0]


def test_a_law_with_an_angle_of_attack_is_trained(tmp_path):
    """The second output has derivatives, and learns: weights of both outputs change."""
    training = dataclasses.replace(
        training_of((AdamSteps(robust_mean, steps=6, flights=FLIGHTS, rate=3e-2),)),
        teacher=gliding_scenario_of(teacher().guidance),
        with_network=lambda n: gliding_scenario_of(law_of(n, angles=ANGLES)),
        with_angle=True,
    )
    begun, recording = random_law(training, 5)
    assert recording.inputs.shape[-1] == len(INPUTS) + 1
    found = train_law(training, 5, tmp_path)
    assert found.final.distances[0] < 0.9 * found.course[0].distances[0]
    old, new = (s.guidance.network.layers[-1].weight for s in (begun, found.scenario))
    assert np.all(np.abs(np.asarray(new - old)).max(axis=1) > 1e-3)


def test_weights_go_in_and_out():
    scenario = start()
    vector = weights_of(scenario)
    assert eqx.tree_equal(with_weights(scenario, vector), scenario)
    moved = weights_of(with_weights(scenario, vector + 1.0))
    np.testing.assert_allclose(moved, vector + 1.0, rtol=1e-14)
    plain = scenario_of(law_of(network_of(memory=0)))
    assert eqx.tree_equal(with_weights(plain, weights_of(plain)), plain)
