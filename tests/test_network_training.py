"""Training of the velocity network on flights of its own."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.cli.training_report import print_cards
from jentry.guidance import PathPoint
from jentry.guidance.bezier.anchoring import Shape
from jentry.guidance.bezier.prediction import Inputs, Situation
from jentry.learning import fly_samples, train_predictor
from jentry.learning.velocity_samples import Samples
from jentry.missions import find_mission
from jentry.missions.cav_h.dispersions import training_dispersions
from jentry.missions.cav_h.scenario import stored, subdivided
from jentry.missions.cav_h.training import BETWEEN
from jentry.onboard import Factors


@pytest.fixture(scope="module")
def samples():
    return fly_samples(
        subdivided(),
        training_dispersions(),
        200,
        jax.random.key(0),
        again=200,
        between=BETWEEN,
    )


@pytest.mark.slow
def test_samples_are_situations_of_flights(samples):
    assert len(samples) > 2000
    # Every flight from the entry that counts has its first sample there.
    first = np.unique(samples.flights[samples.flights < 200])
    np.testing.assert_array_equal(samples.flights[samples.at_entry], first)
    assert np.all(samples.situations.point.along[samples.at_entry] < 0.01)
    # Flown again it is the same vehicle, with the same factors.
    again = np.flatnonzero(samples.flights >= 200)
    for index in again[:: len(again) // 20]:
        same = (samples.vehicles == samples.vehicles[index]) & (samples.flights < 200)
        drag = samples.situations.factors.drag
        np.testing.assert_allclose(drag[same], drag[index], rtol=1e-6)
    assert list(samples.left_out) == [
        "do not reach the target",
        "leave the curve at a limit of the angle of attack",
        "end outside of 1600 to 3600 m/s",
    ]
    assert samples.left_out["end outside of 1600 to 3600 m/s"] > 0
    assert np.all(samples.final_velocity > BETWEEN[0])
    assert np.all(samples.final_velocity < BETWEEN[1])
    # Every flight has one end, and the vehicle slows down on its way there.
    for flight in np.unique(samples.flights)[:20]:
        of = samples.flights == flight
        assert len(np.unique(samples.final_velocity[of])) == 1
        assert np.all(np.diff(samples.situations.velocity[of]) < 0.0)
        assert np.all(np.diff(samples.situations.point.along[of]) > 0.0)
        # Lift and drag are known from the first sample on.
        assert np.ptp(samples.situations.factors.drag[of]) < 1e-6
    assert np.max(samples.flights) >= 200  # some begin on the way


@pytest.mark.slow
def test_training_predicts_what_it_has_not_seen(samples):
    """Some hundred flights and iterations: a tenth of what the state alone allows."""
    lines = []
    trained = {
        inputs: train_predictor(
            subdivided(),
            samples,
            inputs,
            jax.random.key(1),
            hidden=(12,),
            warm_up=500,
            iterations=300,
            report=lines.append,
        )
        for inputs in Inputs
    }
    errors = {
        inputs: result.card["held out mean error, m/s"]
        for inputs, result in trained.items()
    }
    assert errors[Inputs.ALL] < 15.0
    assert errors[Inputs.STATE] > 3.0 * errors[Inputs.ALL]
    assert lines[0].startswith("Adam, 500 steps") and len(lines) == 4
    assert trained[Inputs.ALL].predictor.network.names == Inputs.ALL.names
    card = trained[Inputs.ALL].card
    assert card["samples"] + card["held out samples"] == len(samples)


def made_up(vehicles=40, each=6):
    """Samples of flights that nobody flew: the velocity falls as a known function."""
    rng = np.random.default_rng(5)
    law = stored().guidance
    length = float(law.track.length())
    drag = np.repeat(rng.uniform(0.8, 1.2, vehicles), each)
    to_go = np.tile(np.linspace(length, 0.1, each), vehicles)
    velocity = rng.uniform(7400.0, 7600.0, drag.shape)
    final = velocity * np.exp(-to_go * drag)
    count = len(drag)

    # As it comes out of the curve: the same but for rounding.
    k1 = 0.848 + rng.uniform(-1e-12, 1e-12, count)

    @jax.vmap
    def situation(along, velocity, k1, drag):
        nothing = 0.0 * along
        point = PathPoint(along, 5e4 + nothing, nothing, nothing, nothing)
        shape, factors = Shape(k1, 0.717 + nothing), Factors(1.0 + nothing, drag)
        return Situation(point, velocity, shape, law.target(), factors)

    situations = situation(length - to_go, velocity, k1, drag)
    situations = jax.tree.map(np.asarray, situations)
    vehicle = np.repeat(np.arange(vehicles), each)
    flight = vehicle + vehicles * (np.arange(count) % 2)  # every vehicle flies twice
    left_out = {"do not reach the target": 7}
    return Samples(situations, final, flight, vehicle, to_go == length, left_out)


@pytest.mark.slow
def test_card_of_a_training(capsys):
    """What was left out, and the error at the entry, from the predictor itself."""
    samples = made_up()
    trained = train_predictor(
        stored(),
        samples,
        Inputs.ALL,
        jax.random.key(0),
        hidden=(4,),
        warm_up=200,
        iterations=20,
        held_out=0.3,
    )
    card, glide = trained.card, stored().guidance.glide(stored().constraints)
    predict = jax.jit(jax.vmap(lambda s: trained.predictor.predict(glide, s)))
    error = np.abs(
        predict(jax.tree.map(jnp.asarray, samples.situations)) - samples.final_velocity
    )
    answered = np.isfinite(error)
    draws = jax.random.uniform(jax.random.split(jax.random.key(0), 4)[1], (40,))
    held = np.asarray(draws < 0.3)[samples.vehicles]  # whole vehicles
    assert card["left out"] == {"do not reach the target": 7}
    assert (card["samples"], card["held out samples"]) == (np.sum(~held), np.sum(held))
    assert card["held out samples outside of the ranges"] == np.sum(~answered[held])
    # Of the training itself only what is predicted beyond its fastest or slowest flight.
    assert np.mean(answered[~held]) > 0.98
    held &= answered
    means = {
        "held out mean error, m/s": error[held].mean(),
        "held out mean error at the entry, m/s": error[held & samples.at_entry].mean(),
    }
    for key, mean in means.items():
        assert card[key] == pytest.approx(mean, rel=1e-9)
    assert card["held out samples at the entry"] == np.sum(held & samples.at_entry)
    ends = samples.final_velocity[held & samples.at_entry]
    assert card["mean deviation at the entry from the median, m/s"] == pytest.approx(
        np.mean(np.abs(ends - np.median(ends))), rel=1e-12
    )
    network = trained.predictor.network
    assert network.input_scale[6] == 0.0 and network.input_scale[7] == 0.0
    assert network.input_scale[9] > 0.0
    print_cards(find_mission("cav-h"), {"made-up": card})
    printed = capsys.readouterr().out
    at_entry = card["held out mean error at the entry, m/s"]
    for shown in (f"{at_entry:.3f}", "left out: 7 of flights that do not reach"):
        assert shown in printed


@pytest.mark.slow
def test_only_the_law_can_be_learnt():
    other = find_mission("mars-drag-tracking").scenario()
    with pytest.raises(ValueError, match="this needs BezierGuidance"):
        fly_samples(
            other,
            find_mission("mars-drag-tracking").dispersion_table(),
            10,
            jax.random.key(0),
            again=10,
            between=BETWEEN,
        )
