"""Training samples of range networks, and the accuracy of the shipped networks."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, along_each, with_leaf
from range_networks import in_plane, in_space, of, turning, windy

import jentry
from jentry.guidance.bank_shapes import ConstantBankShape
from jentry.guidance.range_network import INPUTS
from jentry.learning.range_network import LEAST, predict_samples, train_range_network
from jentry.missions.mars import predictor_corrector as mars
from jentry.missions.mars.drag_tracking import independent
from jentry.motion.quantities import ground_track
from jentry.onboard.measurement import Measurement, measure
from jentry.onboard.network import load_network, save_network


def test_shipped_network_says_how_it_was_trained():
    network = mars.range_network()
    _, card = load_network(mars.FOLDER / "range.npz")
    assert network.network.names == INPUTS
    assert card["command"].startswith("jentry train mars-range-tracking --seed 0 ")
    low, high = card["inputs"]["number of the bank"]
    assert (low, high) == (0.0, 1.0)  # where a number saturates it is known
    np.testing.assert_allclose(network.of, of(in_plane().law), rtol=1e-9)


def test_a_file_that_does_not_say_what_it_is_of_is_refused(tmp_path):
    network, card = load_network(mars.FOLDER / "range.npz")
    del card["of"]
    save_network(tmp_path / "range.npz", network, card)
    with pytest.raises(
        ValueError, match="does not state what it is for .velocity at the"
    ):
        mars.range_network(tmp_path)


def test_shipped_networks_in_three_dimensions_say_how_they_were_trained():
    network = mars.range_network_in_space()
    assert network.in_space and len(network.networks) == 2
    for name in ("range", "ahead", "across"):
        _, card = load_network(mars.FOLDER / f"{name}.npz")
        _, of_the_plane = load_network(mars.FOLDER / "range.npz")
        assert card["command"] == of_the_plane["command"]
        assert card["inputs"]["number of the bank"] == [0.0, 1.0]
    np.testing.assert_allclose(network.of, of(in_space().law), rtol=1e-9)


def test_networks_that_do_not_belong_together_are_refused(tmp_path):
    for name in ("ahead", "across"):
        network, card = load_network(mars.FOLDER / f"{name}.npz")
        save_network(tmp_path / f"{name}.npz", network, card)
    assert mars.range_network_in_space(tmp_path).in_space
    mars.range_network_in_space.cache_clear()
    other = dict(card["of"], **{"velocity at the end, m/s": 600.0})
    save_network(tmp_path / "across.npz", network, card | {"of": other})
    with pytest.raises(
        ValueError,
        match="are for different predictions: velocity at the end, m/s 503 and 600;",
    ):
        mars.range_network_in_space(tmp_path)
    plane, card = load_network(mars.FOLDER / "range.npz")
    save_network(tmp_path / "ahead.npz", plane, card)
    with pytest.raises(ValueError, match="is a network for 'range at a constant bank"):
        mars.range_network_in_space(tmp_path)


@pytest.fixture(scope="module")
def samples():
    """Of another seed than those that the shipped network has learnt from."""
    return predict_samples(in_plane(), independent(), 100, 3000, jax.random.key(7))


@pytest.mark.slow
def test_samples_are_predictions(samples):
    law = in_plane().law
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
    law = in_plane().law
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
    card = trained.cards["range"]
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
    assert len(told) == 2 and told[1].startswith("range: L-BFGS, 500 steps: loss")


@pytest.fixture(scope="module")
def samples_in_space():
    """From places that flights by the networks visit, of another seed than those that
    these have learnt from."""
    scenario = mars.networked()
    # Of the last cycle before the end, for which there was nothing to learn.
    with pytest.warns(UserWarning, match="decisions without prediction, up to 1%"):
        return predict_samples(scenario, independent(), 100, 1500, jax.random.key(7))


@pytest.mark.slow
def test_samples_in_three_dimensions_are_predictions_to_either_side(samples_in_space):
    """From another place, with another heading and to the other side, seen from there."""
    law, samples = in_space().law, samples_in_space
    planet, angle = law.model.planet, law.model.vehicle.trim_angle_of_attack
    predict = eqx.filter_jit(law.predicted)
    for index in range(0, len(samples), len(samples) // 10):
        one = jax.tree.map(jnp.asarray, samples.of(np.array([index])))
        state, factors = jax.tree.map(lambda x: x[0], (one.states, one.factors))
        place = {"longitude": 1.0, "latitude": -0.6, "heading": 0.3 + index}
        place = {name: jnp.asarray(value) for name, value in place.items()}
        state = dataclasses.replace(state, **place)
        sensed = measure(planet, law.model.vehicle, state, angle)
        seen = Measurement(state, sensed.lift, sensed.drag, angle, angle, {})
        sign = jnp.asarray(-1.0)
        end = predict(jnp.asarray(0.0), seen, factors, one.numbers[:1], sign, True)
        ahead, to_the_left = ground_track(planet, state, end.state)
        # Steps are the same; in between is the rounding of some hundred of them.
        assert float(one.ranges[0]) == pytest.approx(float(ahead), rel=1e-7)
        assert float(one.across[0]) == pytest.approx(
            float(to_the_left), rel=1e-7, abs=0.1
        )


@pytest.mark.slow
def test_shipped_networks_in_three_dimensions_are_as_good_as_their_cards_say(
    samples_in_space,
):
    samples = samples_in_space
    law, network = in_space().law, mars.range_network_in_space()
    angle, end = law.model.vehicle.trim_angle_of_attack, law.end.first()

    @eqx.filter_jit
    @jax.vmap
    def asked(state, factors, number):
        return network(law.model, state, angle, factors, number, end)

    given = samples.states, samples.factors, samples.numbers
    answers = asked(*jax.tree.map(jnp.asarray, given))
    known = np.asarray(answers.knows)
    assert known.mean() > 0.98
    near = samples.ranges[known] < 100e3
    for name, found, expected in (
        ("ahead", answers.range, samples.ranges),
        ("across", answers.across, samples.across),
    ):
        _, card = load_network(mars.FOLDER / f"{name}.npz")
        error = np.abs(np.asarray(found) - expected)[known]
        # Means of 10635 and of 1500 errors with long tails.
        assert error.mean() < 1.3 * card["held out mean error, m"]
        assert error[near].mean() < 1.3 * card["held out mean error below 100 km, m"]


@pytest.mark.slow
def test_a_flight_by_the_networks_has_its_derivatives():
    """By density and lift; between reversals, which are discrete."""
    scenario = mars.networked()

    def end(factors):
        given = with_leaf(scenario, lambda s: s.planet.density_scale, factors[0])
        given = with_leaf(given, lambda s: s.vehicle.lift_scale, factors[1])
        flight = jentry.fly(given)
        sides = flight.state.longitude, flight.state.latitude
        return jnp.stack(sides) * scenario.planet.radius

    slopes, differences = along_each(end, [1.02, 0.97], [1e-6, 1e-6])
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1.0)
    assert np.min(np.max(np.abs(differences), axis=1)) > 1.0


def test_only_predictions_of_a_constant_bank_can_be_learnt():
    def learnt(law):
        scenario = eqx.tree_at(lambda s: s.guidance, in_space(), law)
        predict_samples(scenario, independent(), 100, 100, jax.random.key(0))

    with pytest.raises(ValueError, match="the law is Const.*expected a PredictorCorr"):
        learnt(ConstantBank())
    with pytest.raises(ValueError, match="the range can be learnt for a Const"):
        shape = ConstantBankShape(lowest=-0.5)
        learnt(dataclasses.replace(in_space().guidance, shape=shape))
    for change in (turning, windy):
        for law in (in_space().guidance, in_plane().guidance):
            with pytest.raises(ValueError, match="must not depend on the direction"):
                learnt(change(law))
