"""Training of the velocity network on flights of its own."""

import jax
import numpy as np
import pytest

from jentry.design import fly_samples, train_predictor
from jentry.guidance.velocity_prediction import Inputs
from jentry.missions import find_mission
from jentry.missions.cav_h import subdivided
from jentry.missions.cav_h_dispersions import training_dispersions
from jentry.missions.cav_h_networks import BETWEEN


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
    card = trained[Inputs.ALL].card
    assert list(card["inputs"]) == list(Inputs.ALL.names)
    assert card["samples"] + card["held out samples"] == len(samples)


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
