"""Beyond the paper: re-planned by Newton's method, with what the vehicle senses."""

import jax
import numpy as np
import pytest

from jentry.campaign.monte_carlo import drawn_inputs, monte_carlo
from jentry.flight import Outcome
from jentry.missions import find_mission
from jentry.units import degree


MISSION = find_mission("cav-h")


def errors(variant, reading, runs=500):
    """Magnitudes of the velocity errors, and the campaign.

    The errors of the accelerometers are inputs of all, zero where a reading has none, so
    that one program flies every reading.
    """
    scenario = MISSION.scenario(variant)
    key, indices = jax.random.key(0), np.arange(runs)
    drawn = drawn_inputs(scenario, MISSION.dispersion_table(reading), key, indices)
    sensed = drawn_inputs(
        scenario, MISSION.dispersion_table("normal-sensed"), key, indices
    )
    inputs = {address: np.zeros(runs) for address in sensed}
    inputs |= {address: np.asarray(values) for address, values in drawn.items()}
    campaign = monte_carlo(scenario, inputs=inputs)
    assert np.all(np.asarray(campaign.flights.outcome) == Outcome.REACHED)
    return np.abs(campaign.misses.velocity), campaign


def test_with_known_factors():
    """All of 500 within 1 m/s, and within 20 m/s where the factors are uniform."""
    assert np.max(errors("newton", "normal")[0]) < 1.0
    assert np.max(errors("newton", "uniform")[0]) < 20.0


def test_with_accelerometers():
    """Better than the paper's table, with errors of sensors that it does not have."""
    error, campaign = errors("newton", "normal-sensed")
    assert np.mean(error) < 5.01
    assert np.max(error) < 19.8
    missed = campaign.misses
    assert np.max(np.asarray(missed.distance)) < 1.0
    assert np.max(np.abs(missed.flight_path_angle)) < 0.002 * degree
    assert np.max(np.abs(missed.heading)) < 0.02 * degree


@pytest.mark.slow
def test_with_the_network():
    error, _ = errors("newton-network", "normal-sensed")
    assert np.mean(error) < 5.01
    assert np.max(error) < 19.8


@pytest.mark.slow
def test_through_the_standard_atmosphere():
    error, _ = errors("us-1976", "normal-sensed")
    assert np.max(error) < 19.8


@pytest.mark.slow
def test_what_a_density_wave_leaves():
    """The place and the angles are met; the velocity is not: the air below is unknown."""
    campaign = monte_carlo(
        MISSION.scenario("newton"),
        MISSION.dispersion_table("waves-sensed"),
        jax.random.key(0),
        500,
    )
    error = np.abs(campaign.misses.velocity)
    assert np.max(np.asarray(campaign.misses.distance)) < 1.0
    assert np.max(np.abs(campaign.misses.flight_path_angle)) < 0.1 * degree
    assert 30.0 < np.mean(error) < 100.0
