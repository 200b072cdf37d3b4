"""The worst runs, and rank correlations: against scipy and by hand."""

import math

import numpy as np
import pytest
import xarray
from scipy import stats

from jentry.flight import Outcome
from jentry.statistics.ranking import (
    ordered_by,
    rank_correlations,
    worst_runs,
)


def results(errors, outcomes=None, **inputs):
    count = len(errors)
    outcomes = np.zeros(count) if outcomes is None else outcomes
    columns = {f"vehicle.{name}": ("run", x, {}) for name, x in inputs.items()}
    columns["outcome"] = ("run", np.asarray(outcomes, np.int8), {})
    columns["downrange_error"] = ("run", np.asarray(errors, float), {"units": "m"})
    columns["peak_drag"] = ("run", np.asarray(errors, float), {"units": "m/s2"})
    return xarray.Dataset(columns, {"run": np.arange(count)})


def test_the_magnitude_of_an_error_counts():
    runs = results([3.0, -9.0, 5.0, -1.0], mass=np.array([7.0, 5.0, 6.0, 5.0]))
    found = worst_runs(runs, "downrange_error", 3)
    assert [(each.run, each.value) for each in found] == [(1, -9), (2, 5), (0, 3)]
    # Below 5, 5, 6, 7 are 0, 0, 2 and 3 of them, and half of the equal ones.
    assert [each.ranks["vehicle.mass"] for each in found] == [0.25, 0.625, 0.875]
    assert [each.inputs["vehicle.mass"] for each in found] == [5, 6, 7]
    small = worst_runs(runs, "downrange_error", 2, smallest=True)
    assert [each.run for each in small] == [3, 0]
    # Of what is no error the value itself.
    assert [r.run for r in worst_runs(runs, "peak_drag", 2)] == [2, 0]
    assert [r.run for r in worst_runs(runs, "peak_drag", 1, smallest=True)] == [1]
    assert len(worst_runs(runs, "peak_drag", 99)) == 4


def test_a_flight_without_an_end_is_the_worst():
    outcomes = [0, Outcome.NOT_FINITE, 0, Outcome.SINGULAR, 0]
    runs = results([3.0, 0.0, np.nan, 1.0, 99.0], outcomes)
    for smallest in (False, True):
        found = worst_runs(runs, "downrange_error", 4, smallest=smallest)
        assert [each.run for each in found][:3] == [1, 2, 3]
        assert all(math.isnan(each.value) for each in found[:3])
        assert found[3].value == (3.0 if smallest else 99.0)


def test_rank_correlations_are_those_of_scipy():
    draws = np.random.default_rng(0)
    mass, drag, lift = draws.normal(size=(3, 300))
    drag = np.round(drag, 1)  # with ties
    errors = np.exp(mass) - 3.0 * drag + draws.normal(size=300)
    runs = results(errors, mass=mass, drag=drag, lift=lift, constant=np.ones(300))
    for asked, values in (
        ("downrange_error", errors),
        ("|downrange_error|", np.abs(errors)),
    ):
        found, flights = rank_correlations(runs, asked)
        assert flights == 300 and set(found) == {
            f"vehicle.{n}" for n in ("mass", "drag", "lift")
        }
        for name, x in (("mass", mass), ("drag", drag), ("lift", lift)):
            expected = stats.spearmanr(x, values).statistic
            interval = found[f"vehicle.{name}"]
            assert interval.value == pytest.approx(expected, abs=1e-12)
            reach = 1.959963984540054 * math.sqrt(1.06 / 297)
            assert interval.lower == pytest.approx(
                math.tanh(math.atanh(expected) - reach)
            )
            assert interval.upper == pytest.approx(
                math.tanh(math.atanh(expected) + reach)
            )
        sizes = [abs(interval.value) for interval in found.values()]
        assert sizes == sorted(sizes, reverse=True)


def test_intervals_of_correlations_cover():
    """Of 1000 samples of 60: a rate of 95 % has a standard error of 0.7 %.

    Spearman's correlation of a bivariate normal is 6 / pi asin(r / 2).
    """
    draws, r = np.random.default_rng(1), 0.6
    truth = 6.0 / math.pi * math.asin(r / 2.0)
    covers = []
    for _ in range(1000):
        x, noise = draws.normal(size=(2, 60))
        y = r * x + math.sqrt(1.0 - r * r) * noise
        found, _ = rank_correlations(results(y, x=x), "downrange_error")
        covers.append(found["vehicle.x"].lower <= truth <= found["vehicle.x"].upper)
    assert 0.93 <= np.mean(covers) <= 0.97


def test_flights_that_are_not_finite_do_not_count():
    runs = results([1.0, np.nan, 2.0, 3.0], mass=np.array([1.0, -50.0, 2.0, 3.0]))
    found, flights = rank_correlations(runs, "downrange_error")
    assert flights == 3 and found["vehicle.mass"].value == pytest.approx(1.0)
    assert math.isnan(found["vehicle.mass"].lower)  # of three flights


def test_what_only_chooses_does_not_drive():
    runs = results([1.0, 2.0, 4.0, 3.0], seed=np.arange(4.0), mass=np.arange(4.0))
    runs["vehicle.seed"].attrs["choice"] = 1
    found, _ = rank_correlations(runs, "downrange_error")
    assert list(found) == ["vehicle.mass"]


def test_by_what_runs_are_the_worst():
    runs = results([1.0])
    assert ordered_by(runs) == "downrange_error"
    assert ordered_by(runs.assign(miss_distance=runs["peak_drag"])) == "miss_distance"
    with pytest.raises(ValueError, match="say by what"):
        ordered_by(runs.drop_vars("downrange_error"))
    with pytest.raises(ValueError, match="no output peak_drg; .*peak_drag"):
        worst_runs(runs, "peak_drg", 1)


def test_a_negative_count_is_refused():
    """It would count from the end."""
    runs = results([3.0, -9.0, 5.0, -1.0])
    with pytest.raises(ValueError, match="count is -1: it must be zero or more"):
        worst_runs(runs, "downrange_error", -1)
    assert worst_runs(runs, "downrange_error", 0) == []
