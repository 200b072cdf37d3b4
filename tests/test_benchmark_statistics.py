"""Statistics of a benchmark: lost flights, sets, ranks, profiles and control effort."""

import numpy as np
import pytest
import scipy.stats
import xarray
from compared_campaigns import campaign

from jentry.flight import Outcome
from jentry.statistics.benchmark import (
    BROKEN,
    FACTORS,
    FAILURES,
    Flown,
    percentile_name,
    shares_within,
    statistics_of_case,
)
from jentry.statistics.control_effort import mean_rates, reversals
from jentry.statistics.lost_flights import (
    MISS_OVER_GROUND,
    magnitudes,
    percentile_with_lost,
    runs_needed,
)
from jentry.statistics.ranks import rank_intervals, ranks_of


def banked(angles, step=2.0, **more):
    """Histories of the bank and the angle of attack, one row for each flight."""
    angles = np.asarray(angles, dtype=float)
    return xarray.Dataset(
        {
            "bank_angle": (("run", "time"), angles),
            "angle_of_attack": (
                ("run", "time"),
                np.where(np.isnan(angles), angles, 0.3),
            ),
            **more,
        },
        {"time": step * np.arange(angles.shape[1])},
    )


def flown(errors, outcomes=None, **more):
    results = campaign(errors, outcomes=outcomes, **more)
    results["crossrange_error"] = xarray.zeros_like(results["downrange_error"])
    nominal = results.isel(run=[0]).assign_coords(run=[99]).drop_vars("vehicle.mass")
    histories = xarray.merge(
        [banked([[0.1, -0.1]]), nominal.assign_coords(run=[0])], join="outer"
    )
    every = xarray.concat([histories, histories], dim="run")
    return Flown(results, every)


def test_lost_flights_are_worst_and_do_not_vanish():
    errors = np.array([3.0, -4.0, np.nan, 1.0, 0.5])
    outcomes = [0, 0, Outcome.REACHED, Outcome.CRASHED, Outcome.NOT_FINITE]
    results = campaign(errors, outcomes=outcomes)
    found = magnitudes(results, "downrange_error")
    assert found.tolist() == [3.0, 4.0, np.inf, np.inf, np.inf]
    with pytest.raises(ValueError, match="no output crossrange_error"):
        magnitudes(results, MISS_OVER_GROUND)
    results["crossrange_error"] = "run", np.array([4.0, 3.0, 0.0, 0.0, 0.0])
    found = magnitudes(results, MISS_OVER_GROUND)
    assert found.tolist() == [5.0, 5.0, np.inf, np.inf, np.inf]


@pytest.mark.parametrize("percentile", [1.0, 50.0, 95.0, 99.9])
def test_percentiles_are_those_of_numpy_without_lost_flights(percentile):
    ordered = np.sort(np.random.default_rng(0).exponential(size=(3, 77)), axis=1)
    found = percentile_with_lost(ordered, percentile)
    np.testing.assert_allclose(found, np.percentile(ordered, percentile, axis=1), 1e-14)


def test_a_percentile_among_lost_flights_is_infinite():
    ordered = np.array([1.0, 2.0, 3.0, np.inf, np.inf])
    assert percentile_with_lost(ordered, 50.0) == 3.0
    assert percentile_with_lost(ordered, 51.0) == np.inf
    assert percentile_with_lost(ordered, 99.0) == np.inf


@pytest.mark.parametrize(
    ("percentile", "runs"),
    [(50.0, 2), (95.0, 20), (99.0, 100), (99.9, 1000), (99.87, 770)],
)
def test_runs_that_a_percentile_needs(percentile, runs):
    assert runs_needed(percentile) == runs


def test_ranks_share_equal_values_as_those_of_scipy():
    values = np.array([[3.0, np.inf, 1.0], [1.0, np.inf, 1.0], [3.0, 2.0, 0.0]])
    np.testing.assert_array_equal(
        ranks_of(values), scipy.stats.rankdata(values, axis=0)
    )


def test_intervals_of_ranks():
    """Equal laws share a rank; a law that is always worse is last in every resample."""
    draws = np.random.default_rng(1)
    one = draws.exponential(size=200)
    sizes = np.stack([one, one, 3.0 * one + 1.0])
    assert rank_intervals(sizes, 95.0) == [(1.5, 1.5, 1.5)] * 2 + [(3.0, 3.0, 3.0)]
    # Two laws that differ by chance exchange their ranks.
    sizes = draws.exponential(size=(2, 200))
    assert [x[1:] for x in rank_intervals(sizes, 95.0)] == 2 * [(1.0, 2.0)]
    (few, _) = rank_intervals(sizes[:, :25], 95.0)
    assert np.isfinite(few.value) and np.isnan(few.lower)
    assert np.isnan(rank_intervals(sizes[:, :19], 95.0)[0].value)


def test_shares_within_a_factor_of_the_best():
    sizes = np.array([[1.0, 10.0, np.inf, np.inf], [2.0, 5.0, 7.0, np.inf]])
    one, other = shares_within(sizes, 0.0)
    assert (one[0], one[-1]) == (0.25, 0.5) and (other[0], other[-1]) == (0.5, 0.75)
    at_two = np.searchsorted(FACTORS, 2.0)
    assert one[at_two] == 0.5 and other[at_two] == 0.75
    # Below the resolution all are equally good.
    assert shares_within(sizes, 3.0)[:, 0].tolist() == [0.25, 0.75]
    assert shares_within(sizes, 20.0)[:, 0].tolist() == [0.5, 0.75]


def test_statistics_are_those_of_numpy_set_by_set():
    draws = np.random.default_rng(2)
    errors = draws.normal(0.0, 1e3, 400)
    outcomes = np.zeros(400)
    outcomes[[7, 8, 130]] = Outcome.TIMED_OUT
    found, other = statistics_of_case(
        {"one": flown(errors, outcomes), "other": flown(2.0 * errors)},
        MISS_OVER_GROUND,
        1.0,
        4,
    )
    large = np.where(outcomes == 0, np.abs(errors), 1e99)
    for percentile in (50.0, 95.0):
        statistic = found.statistics[percentile_name(MISS_OVER_GROUND, percentile)]
        expected = np.percentile(large, percentile)
        np.testing.assert_allclose(statistic.all_runs.value, expected, 1e-14)
        sets = np.percentile(large.reshape(4, 100), percentile, axis=1)
        np.testing.assert_allclose(statistic.sets, sets, 1e-14)
        np.testing.assert_allclose(statistic.mean, np.mean(sets), 1e-14)
        np.testing.assert_allclose(statistic.deviation, np.std(sets, ddof=1), 1e-12)
    statistic = found.statistics[percentile_name(MISS_OVER_GROUND, 99.0)]
    assert np.isfinite(statistic.all_runs.value)
    # A set that lost two of its 100 flights has no 99th percentile, and so no spread.
    assert np.isinf(statistic.sets[0]) and np.isfinite(statistic.sets[2])
    assert np.isinf(statistic.mean) and np.isnan(statistic.deviation)
    statistic = found.statistics[percentile_name(MISS_OVER_GROUND, 99.9)]
    assert statistic.needs == 1000 and np.isnan(statistic.all_runs.value)
    assert statistic.sets == ()
    statistic = found.statistics[FAILURES]
    assert statistic.all_runs.value == 3 / 400
    assert statistic.sets == (0.02, 0.01, 0.0, 0.0)
    exact = scipy.stats.binomtest(3, 400).proportion_ci(0.95)
    np.testing.assert_allclose(statistic.all_runs[1:], exact, 1e-9)
    assert BROKEN not in found.statistics
    assert other.statistics[FAILURES].all_runs.value == 0.0
    assert (found.rank.value, other.rank.value) == (1.0, 2.0)
    assert found.draws == other.draws and found.other_draws == other.other_draws == ""


def test_other_draws_are_reported():
    errors = np.arange(40.0)
    one, other = statistics_of_case(
        {"one": flown(errors), "other": flown(errors, mass=errors[::-1].copy())},
        MISS_OVER_GROUND,
        1.0,
        2,
    )
    assert one.draws != other.draws
    assert (one.other_draws, other.other_draws) == (
        "",
        "vehicle.mass was drawn otherwise",
    )


def test_flights_beyond_a_limit():
    """A peak that is not finite is beyond; one at the limit is not."""
    peaks = np.tile([1.0, 2.0, 2.5, np.nan], 10)
    each = flown(np.arange(40.0), peak_heat_rate=peaks, peak_drag=peaks)
    each.results["peak_heat_rate"].attrs["limit"] = 2.0
    (found,) = statistics_of_case({"one": each}, MISS_OVER_GROUND, 1.0, 2)
    assert found.statistics[BROKEN].all_runs.value == 0.5
    assert found.statistics[f"{BROKEN}_heat_rate"].sets == (0.5, 0.5)
    assert f"{BROKEN}_drag" not in found.statistics


def test_control_effort():
    flights = [
        [0.5, 0.5, -0.5, 0.5, np.nan],  # two reversals, 2 rad in 6 s
        [0.2, 0.0, 0.2, 0.0, -0.2],  # one reversal; zero is no side
        [3.1, -3.1, 3.1, np.nan, np.nan],  # the shorter way around, two reversals
        [0.1, np.nan, np.nan, np.nan, np.nan],
    ]
    histories = banked(flights)
    assert reversals(histories).tolist() == [2.0, 1.0, 2.0, 0.0]
    around = 2.0 * (2.0 * np.pi - 6.2) / 4.0
    expected = [2.0 / 6.0, 0.8 / 8.0, around, np.nan]
    np.testing.assert_allclose(mean_rates(histories, "bank_angle"), expected, 1e-12)
    # The command counts, not the attitude that follows it.
    commanded = ("run", "time"), np.zeros((4, 5))
    histories = banked(flights, commanded_bank_angle=commanded)
    assert reversals(histories).tolist() == 4 * [0.0]
