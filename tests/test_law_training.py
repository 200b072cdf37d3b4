"""Trainings of the laws of missions, and the flights of other laws that they record."""

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
    scenario_of,
    teacher,
)
from test_neural_training import FLIGHTS, METHODS, SINE, TABLE, start

from jentry.campaign import monte_carlo
from jentry.campaign.campaign import drawn_inputs
from jentry.guidance import BankProfile
from jentry.guidance.neural_law import INPUTS, PURPOSE, inputs_of
from jentry.learning import (
    AdamSteps,
    LawTraining,
    Recording,
    imitated,
    record_inputs,
    robust_mean,
    train_law,
)
from jentry.learning.law_training import random_law
from jentry.onboard import (
    Measurement,
    PolynomialProfile,
    load_recurrent_network,
    measure,
)


pytestmark = pytest.mark.slow


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
