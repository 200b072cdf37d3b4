"""The first sets of runs of the populations that the pages have the statistics of.

To compile a mission takes longer than to fly it, and with little optimization, see
`compiling`, it takes half as long; but what is flown then should be few flights. So a test
that flies a set for nothing but its statistics flies the first runs of it alone.
"""

from unittest import mock

import equinox as eqx
import jax
import pytest
from pages import benchmark

from jentry.campaign import batch, monte_carlo
from jentry.missions import find_mission


populations = benchmark("populations")
"""The benchmark that flies many sets of runs"""


def small_batches():
    """Within it a batch has as many runs as the first ones that are saved.

    A batch of users would be filled up with flights that nobody asks for, and would take
    eight times as long.
    """
    return mock.patch.object(batch, "LANES", populations.FIRST_RUNS)


def fly_few(mission, variant, dispersions, seed=0):
    """A scenario, and the campaign of as many runs as the first ones that are saved."""
    chosen = find_mission(mission)
    scenario, table = chosen.scenario_of(variant), chosen.dispersion_table(dispersions)
    runs = populations.FIRST_RUNS
    with small_batches():
        return scenario, monte_carlo(scenario, table, jax.random.key(seed), runs)


def assert_first_runs(
    mission, variant, dispersions, scenario, campaign, rel=1e-6, absolute=1e-9
):
    """The runs of a campaign are the first ones of the first set, to what is saved of them.

    The other order of rounding is below the relative difference, as for `assert_first_set`,
    or below the absolute one, for a mean that is nearly zero.
    """
    first = populations.first_runs_of(_results(scenario, campaign))
    for heading, statistic, saved in _saved_of(mission, variant, dispersions):
        expected = pytest.approx(saved.first_runs, rel=rel, abs=absolute)
        assert statistic(first) == expected, heading


def assert_first_set(mission, variant, dispersions, scenario, campaign, rel=1e-6):
    """The runs of a campaign are those of the first set, to what is saved of it.

    Another compiler's order of rounding is below the relative difference, but for flights
    that hang on a thread, as where Newton's method does not converge.
    """
    results = _results(scenario, campaign)
    (first,) = populations.sets_of(results, populations.runs_of(mission, variant))
    for heading, statistic, saved in _saved_of(mission, variant, dispersions):
        expected = saved.sets[0]
        assert statistic(first) == pytest.approx(expected, rel=rel, abs=1e-9), heading


def _results(scenario, campaign):
    ends = eqx.tree_at(
        lambda c: c.flights.history, campaign, None, is_leaf=lambda x: x is None
    )
    return ends.to_xarray(scenario)


def _saved_of(mission, variant, dispersions):
    """Heading, statistic and what is saved of it, for each."""
    saved = populations.statistics()
    for heading, statistic in populations.statistics_of(mission, variant).items():
        yield heading, statistic, saved[mission, variant, dispersions, heading]
