"""The first sets of runs of the populations that the README has the statistics of."""

import importlib.util
from pathlib import Path

import equinox as eqx
import pytest


def benchmark(name):
    """A program of the folder of benchmarks, as a module."""
    path = Path(__file__).parents[1] / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


populations = benchmark("populations")
"""The benchmark that flies many sets of runs"""


def assert_first_set(mission, variant, dispersions, scenario, campaign, rel=1e-6):
    """The runs of a campaign are those of the first set, to what is saved of it.

    Another compiler's order of rounding is below the relative difference, but for flights
    that hang on a thread, as where Newton's method does not converge.
    """
    campaign = eqx.tree_at(
        lambda c: c.flights.history, campaign, None, is_leaf=lambda x: x is None
    )
    results = campaign.to_xarray(scenario)
    (first,) = populations.sets_of(results, populations.runs_of(mission, variant))
    saved = populations.saved()
    for heading, statistic in populations.statistics_of(mission, variant).items():
        expected = saved[mission, variant, dispersions, heading][0]
        assert statistic(first) == pytest.approx(expected, rel=rel, abs=1e-9), heading
