"""The range of the rest of a flight by a network, in place of its prediction."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf

import jentry
from jentry.addresses import leaves_by_address, replace_leaves
from jentry.guidance.bank_shapes import ConstantBankShape, LinearBankShape
from jentry.guidance.range_network import INPUTS, RangeNetwork, basis, features
from jentry.learning.range_network import (
    LEAST,
    predict_samples,
    train_range_network,
)
from jentry.missions.mars import predictor_corrector as mars
from jentry.missions.mars.drag_tracking import independent
from jentry.onboard import Factors
from jentry.onboard.navigation import Measurement, measure
from jentry.onboard.network import Network, load_network, save_network
from jentry.onboard.profiles import PolynomialProfile


ALL = [(-1e3, 1e3)] * 6 + [(0.0, 1.0)]


def linear(constant=0.0, ranges=ALL, **weights):
    """Network without hidden layers: a sum of its inputs."""
    given = [weights.pop(name, 0.0) for name in ("velocity", "number")]
    assert not weights
    row = np.zeros(7)
    row[1], row[6] = given
    return RangeNetwork(
        Network(
            (jnp.asarray(row)[None],),
            (jnp.zeros(1),),
            INPUTS,
            jnp.zeros(7),
            jnp.ones(7),
            jnp.asarray(ranges),
            jnp.asarray(constant),
            jnp.asarray(1.0),
        ),
        of(in_plane().guidance),
    )


def of(law):
    angle = law.model.vehicle.trim_angle_of_attack
    return basis(law.model, in_plane().initial_state, angle, law.end.first())


@functools.cache
def in_plane():
    return mars.in_plane()


def underway(velocity=3000.0, altitude=30e3, law=None):
    """What is measured by the nominal vehicle some way down."""
    law = in_plane().guidance if law is None else law
    model = law.model
    state = jentry.EntryState(altitude, 0.1, 0.0, velocity, -0.1, jnp.pi / 2)
    state = jax.tree.map(jnp.asarray, state)
    angle = model.vehicle.trim_angle_of_attack
    sensed = measure(model.planet, model.vehicle, state, angle)
    return Measurement(state, sensed.lift, sensed.drag, angle, angle, {})


def asked(network, number=0.5, velocity=3000.0, factors=Factors()):
    law, seen = in_plane().guidance, underway(velocity)
    factors = jax.tree.map(jnp.asarray, factors)
    given = law.model, seen.state, seen.angle_of_attack, factors, jnp.asarray(number)
    return network(*given, law.end.first())


def test_range_is_that_of_the_mean_deceleration():
    """Of 10 m/s2 from 3000 m/s down to 503: x = (v^2 - v_f^2) / (2 a)."""
    answer = asked(linear(np.log(10.0)))
    assert bool(answer.knows)
    end = float(in_plane().guidance.end.velocity)
    assert float(answer.range) == pytest.approx((3000.0**2 - end**2) / 20.0, rel=1e-12)


def test_inputs_are_what_their_names_say():
    law, seen = in_plane().guidance, underway()
    factors = Factors(jnp.asarray(1.2), jnp.asarray(0.8))
    read = features(
        law.model, seen.state, seen.angle_of_attack, factors, jnp.asarray(0.3)
    )
    vehicle, air = law.model.vehicle, law.model.planet.atmosphere
    density = float(air.surface_density * np.exp(-30e3 / air.scale_height))
    # 115 kg/m2 of the paper.
    drag = 0.8 * 0.5 * density * 3000.0**2 / 115.0
    expected = [3.0, 3.0, -1.0, np.log(drag), np.log(0.8), np.log(1.5), 0.3]
    np.testing.assert_allclose(read, expected, rtol=1e-9)
    assert vehicle.mass == 992.0


@pytest.mark.parametrize(
    ("change", "knows"),
    [
        ({}, True),
        ({"number": 1.0}, True),
        ({"number": 1.0001}, False),
        ({"velocity": 500.0}, False),  # slower than the end
        ({"factors": Factors(jnp.nan, 1.0)}, False),
    ],
)
def test_it_knows_what_it_was_trained_on(change, knows):
    answer = asked(linear(2.0), **change)
    assert bool(answer.knows) == knows
    assert np.isfinite(answer.range) and (answer.range > 0.0) == knows


def test_another_network_is_refused():
    wrong = Network(
        (jnp.ones((1, 2)),),
        (jnp.zeros(1),),
        ("a", "b"),
        jnp.zeros(2),
        jnp.ones(2),
        jnp.asarray([(0.0, 1.0)] * 2),
        jnp.asarray(0.0),
        jnp.asarray(1.0),
    )
    with pytest.raises(ValueError, match="the network reads a, b: the range is read"):
        RangeNetwork(wrong, jnp.zeros(8))
    with pytest.raises(
        ValueError, match="of has shape .3,.: a network of the range is"
    ):
        RangeNetwork(linear().network, jnp.zeros(3))


@pytest.mark.parametrize(
    "address",
    [
        "end.velocity",
        "end.altitude",
        "model.planet.radius",
        "model.planet.gravity.gravitational_parameter",
        "model.planet.atmosphere.surface_density",
        "model.planet.atmosphere.scale_height",
        "model.vehicle.mass",
        "model.vehicle.aerodynamics.lift_coefficient",
        "model.vehicle.aerodynamics.drag_coefficient",
    ],
)
def test_of_another_model_or_end_it_knows_nothing(address):
    law, seen = in_plane().guidance, underway()
    other = replace_leaves(law, {address: 1.0001 * leaves_by_address(law)[address]})
    for asked_about, knows in ((law, True), (other, False)):
        answer = linear(2.0)(
            asked_about.model,
            seen.state,
            seen.angle_of_attack,
            Factors(jnp.asarray(1.0), jnp.asarray(1.0)),
            jnp.asarray(0.5),
            asked_about.end.first(),
        )
        assert bool(answer.knows) == knows


def with_network(network, **changes):
    return dataclasses.replace(in_plane().guidance, network=network, **changes)


def test_a_decision_is_where_the_network_says_that_the_target_is():
    """ln of the deceleration falls by 1 from number 0 to 1: more lift flies farther."""
    law = with_network(linear(2.9, number=-1.0), corrections=6)
    seen = underway()
    end = float(law.end.velocity)
    to_go = float(law.range_to_go(seen.state))
    number = 2.9 - np.log((3000.0**2 - end**2) / (2.0 * to_go))
    assert 0.1 < number < 0.9
    _, before = law.init(seen)
    _, after = eqx.filter_jit(law.update)(jnp.asarray(0.0), seen, (), before)
    assert float(after.numbers[0]) == pytest.approx(number, abs=1e-9)
    assert float(law.caveats(after)["decisions_without_prediction"]) == 0.0


def test_a_shape_with_another_largest_bank_asks_about_its_bank():
    """The same bank is flown, whatever the number is that tells it."""
    seen, cosines = underway(), []
    for lowest in (-1.0, -0.8):
        shape = ConstantBankShape(lowest=lowest)
        law = with_network(linear(2.9, number=-1.0), corrections=8, shape=shape)
        _, before = law.init(seen)
        _, held = eqx.filter_jit(law.update)(jnp.asarray(0.0), seen, (), before)
        cosines.append(float(shape.cos_bank(held.numbers, held.since, held.since)))
    assert cosines[1] == pytest.approx(cosines[0], abs=1e-9)


def test_where_the_network_knows_nothing_the_number_stays_and_it_is_said():
    slow = [*ALL[:1], (0.5, 2.0), *ALL[2:]]
    law = with_network(linear(2.5, slow, number=-1.0))
    seen = underway()
    _, before = law.init(seen)
    _, after = eqx.filter_jit(law.update)(jnp.asarray(0.0), seen, (), before)
    assert float(after.numbers[0]) == float(before.numbers[0])
    assert float(law.caveats(after)["decisions_without_prediction"]) == 1.0


def test_a_network_of_another_prediction_is_refused():
    law = in_plane().guidance
    for changes in (
        {"in_space": True},
        {"shape": LinearBankShape(end=0.0)},
        {"angle_of_attack": PolynomialProfile(jnp.ones(1))},
        {"end": mars.GuidedEnd(altitude=10e3)},
    ):
        with pytest.raises(
            ValueError, match="a network takes the place of the predict"
        ):
            dataclasses.replace(law, network=linear(), **changes)
    turning = with_leaf(law, lambda law: law.model.planet.rotation_rate, 7e-5)
    with pytest.raises(ValueError, match="over a planet at rest"):
        dataclasses.replace(turning, network=linear())


def test_shipped_network_says_how_it_was_trained():
    network = mars.range_network()
    _, card = load_network(mars.FOLDER / "range.npz")
    assert network.network.names == INPUTS
    assert card["command"].startswith("jentry train mars-range-tracking --seed 0 ")
    low, high = card["inputs"]["number of the bank"]
    assert (low, high) == (0.0, 1.0)  # where a number saturates it is known
    np.testing.assert_allclose(network.of, of(in_plane().guidance), rtol=1e-9)


def test_a_file_that_does_not_say_what_it_is_of_is_refused(tmp_path):
    network, card = load_network(mars.FOLDER / "range.npz")
    del card["of"]
    save_network(tmp_path / "range.npz", network, card)
    with pytest.raises(ValueError, match="does not say what it is of .velocity at the"):
        mars.range_network(tmp_path)


@pytest.fixture(scope="module")
def samples():
    """Of another seed than those that the shipped network has learnt from."""
    return predict_samples(in_plane(), independent(), 100, 3000, jax.random.key(7))


@pytest.mark.slow
@pytest.mark.optimized
def test_samples_are_predictions(samples):
    law = in_plane().guidance
    predict = eqx.filter_jit(law.predicted)
    for index in range(0, len(samples), len(samples) // 20):
        one = jax.tree.map(jnp.asarray, samples.of(np.array([index])))
        state, factors = jax.tree.map(lambda x: x[0], (one.states, one.factors))
        angle = law.model.vehicle.trim_angle_of_attack
        sensed = measure(law.model.planet, law.model.vehicle, state, angle)
        seen = Measurement(state, sensed.lift, sensed.drag, angle, angle, {})
        end = predict(jnp.asarray(0.0), seen, factors, one.numbers[:1], 1.0, False)
        flown = law.model.planet.radius * end.state.longitude
        assert float(one.ranges[0]) == pytest.approx(float(flown), rel=1e-9)
    assert np.all(samples.ranges >= LEAST)
    left_out = sum(samples.left_out.values())
    assert len(samples) + left_out == 3000 and left_out < 600
    for bound in (0.0, 1.0):
        assert np.mean(samples.numbers == bound) == pytest.approx(0.045, abs=0.015)


def errors(network, samples):
    """Magnitudes, m; NaN where the network knows nothing."""
    law = in_plane().guidance
    angle, end = law.model.vehicle.trim_angle_of_attack, law.end.first()

    @eqx.filter_jit
    @jax.vmap
    def asked(state, factors, number):
        return network(law.model, state, angle, factors, number, end)

    given = samples.states, samples.factors, samples.numbers
    answers = asked(*jax.tree.map(jnp.asarray, given))
    found = np.where(answers.knows, answers.range, np.nan)
    return np.abs(found - samples.ranges)


@pytest.mark.slow
@pytest.mark.optimized
def test_shipped_network_predicts_as_well_as_its_card_says(samples):
    _, card = load_network(mars.FOLDER / "range.npz")
    error = errors(mars.range_network(), samples)
    known = np.isfinite(error)
    error = error[known]
    assert known.mean() > 0.98
    # Means of 6000 and of 3000 errors with long tails.
    assert error.mean() < 1.3 * card["held out mean error, m"]
    near = samples.ranges[known] < 100e3
    assert error[near].mean() < 1.3 * card["held out mean error below 100 km, m"]


@pytest.mark.slow
@pytest.mark.optimized
def test_training_again_learns(samples):
    told = []
    trained = train_range_network(
        in_plane(),
        samples,
        jax.random.key(0),
        hidden=(16,),
        warm_up=500,
        iterations=500,
        report=told.append,
    )
    card = trained.card
    assert card["samples"] + card["held out samples"] == len(samples)
    # The error of the card is that of flights which the network has not learnt from.
    _, split, _, _ = jax.random.split(jax.random.key(0), 4)
    flights = np.max(samples.flights) + 1
    out = np.asarray(jax.random.uniform(split, (flights,))) < 0.1
    held = samples.of(out[samples.flights])
    error = errors(trained.network, held)
    assert card["held out samples"] == len(held)
    assert card["held out mean error, m"] == pytest.approx(np.nanmean(error), rel=1e-6)
    # A tenth of what a prediction of one number would err.
    spread = np.abs(samples.ranges - np.median(samples.ranges)).mean()
    assert card["held out mean error, m"] < 0.1 * spread
    assert len(told) == 2 and told[1].startswith("L-BFGS, 500 steps: loss")


def test_only_a_law_that_predicts_in_the_plane_can_be_learnt():
    with pytest.raises(ValueError, match="expected a PredictorCorrector with in_space"):
        predict_samples(
            mars.three_dimensional(), independent(), 100, 100, jax.random.key(0)
        )
