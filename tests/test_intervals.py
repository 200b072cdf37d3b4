"""Intervals of statistics: against arithmetic, scipy, and how often they cover."""

from statistics import NormalDist

import numpy as np
import pytest
from scipy import stats

from jentry.statistics.intervals import (
    CONFIDENCE,
    FEWEST,
    Interval,
    _accelerated,
    _without_each,
    moment_intervals,
    percentile_interval,
)


def test_values_are_those_of_numpy():
    values = np.random.default_rng(0).lognormal(size=(3, 400)) * [[1.0], [1e6], [1e-9]]
    for row, (mean, deviation) in zip(values, moment_intervals(values), strict=True):
        assert mean.value == np.mean(row)
        assert deviation.value == np.std(row, ddof=1)
        assert mean.lower < mean.value < mean.upper
        assert deviation.lower < deviation.value < deviation.upper
        ordered = np.sort(row)
        for p in (1.0, 50.0, 99.0):
            assert percentile_interval(ordered, p).value == np.percentile(row, p)


def test_the_bootstrap_is_that_of_scipy():
    """Of 2000 resamples each: a bound has a standard error of about 3 % of the width."""
    values = np.random.default_rng(1).gamma(2.0, size=120)
    ours = moment_intervals(values[None])[0]
    for found, statistic in zip(
        ours, (np.mean, lambda x, axis: np.std(x, axis=axis, ddof=1)), strict=True
    ):
        theirs = stats.bootstrap(
            (values,),
            statistic,
            n_resamples=50_000,
            method="BCa",
            rng=np.random.default_rng(2),
        ).confidence_interval
        width = theirs.high - theirs.low
        assert found.lower == pytest.approx(theirs.low, abs=0.1 * width)
        assert found.upper == pytest.approx(theirs.high, abs=0.1 * width)


def test_statistics_without_each_of_the_runs():
    values = np.random.default_rng(6).exponential(size=(2, 7))
    means, deviations = _without_each(values)
    for i in range(7):
        left = np.delete(values, i, axis=1)
        np.testing.assert_allclose(means[:, i], left.mean(axis=1))
        np.testing.assert_allclose(deviations[:, i], left.std(axis=1, ddof=1))


def test_bias_and_acceleration_by_hand():
    """Efron's formula, of resamples that are the numbers from 0 to 1000: a percentile is
    ten times itself. 30 % of them are below 300, and the skewness is that of the sample."""
    left_out = np.array([1.0, 1.2, 0.9, 1.1, -2.0])
    pull = left_out.mean() - left_out
    skew = np.sum(pull**3) / (6 * np.sum(pull**2) ** 1.5)
    normal = NormalDist()
    bias = normal.inv_cdf((300 + 0.5) / 1001)
    expected = []
    for end in (0.025, 0.975):
        moved = bias + normal.inv_cdf(end)
        expected.append(1000 * normal.cdf(bias + moved / (1 - skew * moved)))
    found = _accelerated(300.0, np.arange(1001.0), left_out, 0.95)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_order_statistics_are_those_of_scipy():
    """scipy's test of a quantile inverts the same binomial distribution."""
    for runs in (5, 30, 299, 2000):
        ordered = np.sort(np.random.default_rng(runs).normal(size=runs))
        for percentile in (1.0, 30.0, 50.0, 99.0, 99.87):
            ours = percentile_interval(ordered, percentile)
            theirs = stats.quantile_test(
                ordered, p=percentile / 100
            ).confidence_interval(CONFIDENCE)
            np.testing.assert_array_equal(ours[1:], theirs)


def test_too_few_runs_have_no_bound():
    """The largest of 100 lies below the percentile with 0.9987^100 = 88 %: no bound. Fewer
    than 99 lie below it with 0.8 %, fewer than 100 with 12 %."""
    interval = percentile_interval(np.arange(100.0), 99.87)
    assert np.isnan(interval.upper) and interval.lower == 98.0
    # 0.9987^2835 is just above, and 0.9987^2836 just below 2.5 %.
    assert np.isnan(percentile_interval(np.arange(2835.0), 99.87).upper)
    assert percentile_interval(np.arange(2836.0), 99.87).upper == 2835.0


def test_one_run_and_equal_runs():
    ((mean, deviation),) = moment_intervals(np.array([[3.0]]))
    assert mean.value == 3.0 and np.isnan([*mean[1:], *deviation]).all()
    ((mean, deviation),) = moment_intervals(np.full((1, FEWEST), -2.0))
    assert (mean, deviation) == (Interval(-2, -2, -2), Interval(0, 0, 0))
    with pytest.raises(ValueError, match="one run or more"):
        moment_intervals(np.empty((1, 0)))


def test_a_bootstrap_of_few_runs_has_no_bounds():
    values = np.random.default_rng(2).normal(size=(2, FEWEST))
    for runs in (2, FEWEST - 1):
        for row, pair in zip(values, moment_intervals(values[:, :runs]), strict=True):
            expected = row[:runs].mean(), row[:runs].std(ddof=1)
            np.testing.assert_allclose([x.value for x in pair], expected, rtol=1e-12)
            assert all(np.isnan(x[1:]).all() for x in pair)
    assert all(np.isfinite(x).all() for x in moment_intervals(values))


@pytest.mark.parametrize("percentile", [0.0, 100.0, -3.0, np.nan])
def test_what_is_no_percentile_is_refused(percentile):
    with pytest.raises(ValueError, match="above 0 and below 100"):
        percentile_interval(np.arange(9.0), percentile)


def test_a_shift_and_a_scale_move_the_intervals_along():
    values = np.random.default_rng(3).normal(size=(1, 50))
    ((mean, deviation),) = moment_intervals(values)
    ((moved, scaled),) = moment_intervals(1e7 - 1e3 * values)
    # Down instead of up: the bounds change places; seven digits are gone to the shift.
    np.testing.assert_allclose(
        moved, 1e7 - 1e3 * np.array(mean)[[0, 2, 1]], rtol=0, atol=20.0
    )
    np.testing.assert_allclose(scaled, 1e3 * np.array(deviation), rtol=1e-6)


POPULATIONS = {
    "normal": (stats.norm(3.0, 2.0), 200),
    "uniform": (stats.uniform(-1.0, 2.0), 100),
    "exponential": (stats.expon(), 500),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", POPULATIONS)
def test_intervals_cover_at_their_rate(name):
    """2000 samples: a rate of 95 % has a standard error of 0.49 %, three are 1.5 %.

    The bootstrap is exact for large samples only: of an exponential distribution, whose
    fourth moment is what makes the error of its standard deviation, 500 runs cover 2 %
    less than they say (Efron and Tibshirani have the like of their examples).
    """
    population, runs = POPULATIONS[name]
    samples = population.rvs((2000, runs), random_state=np.random.default_rng(4))
    moments = moment_intervals(samples)
    truths = population.mean(), population.std()
    for which, truth in enumerate(truths):
        covers = [m[which].lower <= truth <= m[which].upper for m in moments]
        least = 0.92 if name == "exponential" else 0.935
        assert least <= np.mean(covers) <= 0.965, which
    ordered = np.sort(samples, axis=1)
    for p in (50.0, 95.0):
        truth = population.ppf(p / 100)
        found = [percentile_interval(row, p) for row in ordered]
        # Conservative by up to one order statistic.
        covers = [i.lower <= truth <= i.upper for i in found]
        assert 0.935 <= np.mean(covers) <= 0.985, p


@pytest.mark.slow
def test_fewer_runs_would_be_covered_less(monkeypatch):
    """Why there is a smallest number of runs. The rates are those of 8000 other samples."""
    monkeypatch.setattr("jentry.statistics.intervals.FEWEST", 2)
    draws = np.random.default_rng(5).normal(size=(2000, FEWEST))
    for runs, rates in ((10, (0.902, 0.821)), (FEWEST, (0.931, 0.910))):
        moments = moment_intervals(draws[:, :runs])
        for which, (truth, rate) in enumerate(zip((0.0, 1.0), rates, strict=True)):
            covers = [m[which].lower <= truth <= m[which].upper for m in moments]
            deviation = np.sqrt(rate * (1.0 - rate) / 2000)
            assert np.mean(covers) == pytest.approx(rate, abs=3.0 * deviation)
