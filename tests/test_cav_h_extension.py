"""Beyond the paper: re-planned by Newton's method, with what the vehicle senses.

Bounds hold for any seed: see `test_cav_h`. Newton's method fails in about one flight of
4000; such a flight may end metres per second and a tenth of a degree off.
"""

import jax
import numpy as np
import pytest
from first_sets import assert_first_set
from helpers import SPREADS, most_by_chance

from jentry import ResultWarning
from jentry.campaign.campaign import drawn_inputs, monte_carlo
from jentry.flight import Outcome
from jentry.missions import find_mission
from jentry.units import degree


MISSION = find_mission("cav-h")
RUNS = 500

ALL = 16 * RUNS

pytestmark = pytest.mark.optimized  # published


def few(off, found):
    """Where so many of all 8000 were off, and three more are reckoned with."""
    return np.sum(np.asarray(off)) <= most_by_chance(RUNS, (found + 3) / ALL)


def errors(variant, reading, runs=RUNS):
    """Magnitudes of the velocity errors, and the campaign.

    The errors of the accelerometers are inputs of all, zero where a reading has none, so
    that one program flies every reading.
    """
    scenario = MISSION.scenario_of(variant)
    key, indices = jax.random.key(0), np.arange(runs)
    drawn = drawn_inputs(scenario, MISSION.dispersion_table(reading), key, indices)
    sensed = drawn_inputs(
        scenario, MISSION.dispersion_table("normal-sensed"), key, indices
    )
    inputs = {address: np.zeros(runs) for address in sensed}
    inputs |= {address: np.asarray(values) for address, values in drawn.items()}
    campaign = monte_carlo(scenario, inputs=inputs)
    assert np.all(np.asarray(campaign.flights.outcome) == Outcome.REACHED)
    if runs == RUNS:
        assert_first_set(MISSION.name, variant, reading, scenario, campaign)
    return np.abs(campaign.misses.velocity), campaign


@pytest.mark.slow
def test_with_known_factors():
    """Within millimetres per second, but for the few where Newton's method fails."""
    error, _ = errors("newton", "normal")
    assert np.median(error) < 0.00151 + SPREADS * 0.00004
    assert few(error > 0.01, 2)
    error, _ = errors("newton", "uniform")
    assert np.median(error) < 0.00144 + SPREADS * 0.00007
    assert few(error > 0.01, 20) and few(error > 20.0, 1)


@pytest.mark.slow
def test_with_accelerometers():
    """Better than the paper's table, with errors of sensors that it does not have."""
    error, campaign = errors("newton", "normal-sensed")
    assert np.mean(error) < 5.01
    assert np.median(error) < 0.0447 + SPREADS * 0.0030
    assert few(error > 1.0, 1) and few(error > 19.8, 0)
    missed = campaign.misses
    assert few(missed.distance > 1.0, 0)
    assert few(np.abs(missed.flight_path_angle) > 0.002 * degree, 2)
    assert few(np.abs(missed.heading) > 0.02 * degree, 2)


@pytest.mark.slow
def test_with_the_network():
    # A quarter leaves the ranges of its training somewhere, and is left on its curve there.
    # Four of all 8000 would end slower than any that it has learnt from, and stay so.
    with pytest.warns(ResultWarning, match="flights have unanswered predictions"):
        error, campaign = errors("newton-network", "normal-sensed")
    assert np.mean(error) < 5.01
    assert np.median(error) < 0.661 + SPREADS * 0.045
    assert few(error > 19.8, 4)
    assert few(campaign.flights.caveats["unanswered_predictions"] > 0.8, 4)


@pytest.mark.slow
def test_what_a_density_wave_leaves():
    """The place and the angles are met; the velocity is not: the air below is unknown."""
    scenario = MISSION.scenario("newton")
    table = MISSION.dispersion_table("waves-sensed")
    campaign = monte_carlo(scenario, table, jax.random.key(0), RUNS)
    assert_first_set(MISSION.name, "newton", "waves-sensed", scenario, campaign)
    error = np.abs(campaign.misses.velocity)
    assert few(campaign.misses.distance > 1.0, 0)
    # The largest of a set.
    angle = np.max(np.abs(campaign.misses.flight_path_angle))
    assert angle < (0.0755 + SPREADS * 0.0051) * degree
    assert np.mean(error) == pytest.approx(63.5, abs=SPREADS * 1.8)
