"""What a law says of how it decided, from the flight to what is printed."""

import cheap
import equinox as eqx
import jax
import numpy as np
import pytest
from helpers import Doubting, fly_compiled, free_scenario, with_leaf

from jentry.campaign import monte_carlo
from jentry.campaign.campaign import fly_in_blocks
from jentry.campaign.results import dataset
from jentry.cli.campaign_report import print_campaign
from jentry.cli.mission_report import print_flight
from jentry.flight import fly
from jentry.units import km


def scenario(altitude):
    """Steps and cycles of 1 s: this is about what is told of a flight, not the flight."""
    return with_leaf(free_scenario(), lambda s: s.guidance, Doubting(altitude))


@pytest.fixture(scope="module")
def low():
    """The share is that of the history: cycles that began below 60 km."""
    return scenario(60 * km)


def test_share_is_that_of_the_flight(low):
    flight = fly_compiled(low, cheap.SOLVER, 1.0)
    altitude = np.asarray(flight.history.states.altitude)
    below = altitude[np.isfinite(altitude)] < 60 * km
    assert 0.1 < np.mean(below) < 0.9
    assert list(flight.caveats) == ["low_cycles"]
    assert float(flight.caveats["low_cycles"]) == pytest.approx(np.mean(below))


def test_a_law_without_caveats():
    shapes = eqx.filter_eval_shape(fly, cheap.scenario(), cheap.SOLVER)
    assert shapes.caveats == {}


@pytest.mark.parametrize("altitude, told", [(60 * km, True), (0.0, False)])
def test_a_flight_tells(capsys, recwarn, altitude, told):
    """By a warning from Python, and by a line from the command."""
    given = scenario(altitude)
    flight = fly(given, cheap.SOLVER)
    said = [str(w.message) for w in recwarn.list]
    print_flight(cheap.MISSION, given, flight)
    printed = capsys.readouterr().out
    share = float(flight.caveats["low_cycles"])
    sentence = f"1 of 1 flights have low cycles, up to {share:.0%} in one flight"
    assert (said == [sentence]) == told
    assert (sentence in printed) == told and ("caveat" in printed) == told


def test_a_campaign_tells(low, capsys):
    """The column has every run's share, and only some runs are told of."""
    table, key = cheap.dispersions(), jax.random.key(0)
    with pytest.warns(UserWarning, match=r"\d+ of 20 flights have low cycles, up to"):
        campaign = monte_carlo(low, table, key, 20, solver=cheap.SOLVER)
    results = dataset(low, campaign)
    shares = results["low_cycles"]
    np.testing.assert_array_equal(shares, campaign.flights.caveats["low_cycles"])
    assert shares.attrs["caveat"] == 1 and shares.attrs["units"] == "1"
    assert len(np.unique(shares)) > 1
    print_campaign(cheap.MISSION, results, as_published=False)
    printed = capsys.readouterr().out
    assert f"caveat: {np.sum(shares.values > 0)} of 20 flights have low" in printed
    none = results.assign(low_cycles=(0.0 * shares).assign_attrs(shares.attrs))
    print_campaign(cheap.MISSION, none, as_published=False)
    assert "caveat" not in capsys.readouterr().out


def test_blocks_are_flown_without_a_word(low):
    """The commands say it once, of all runs; a warning a block would be many."""
    blocks = fly_in_blocks(
        low, cheap.dispersions(), jax.random.key(0), 20, solver=cheap.SOLVER
    )
    assert sum(len(block.runs) for _, block in blocks) == 20
