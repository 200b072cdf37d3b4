"""Acceptance: the table of Hanson and Beard, exact binomials, and simulated campaigns."""

import math

import numpy as np
import pytest
import xarray
from helpers import mars_scenario
from laws import predictor_corrector
from pages import assert_says
from scipy import stats

from jentry.flight import Outcome
from jentry.statistics.acceptance import (
    _FIXED,
    _SEQUENTIAL,
    Decision,
    Requirement,
    judged,
    overall,
    require_outputs,
    runs_needed,
)


# Runs of which k may fail: NASA/TP-2010-216447, and by the binomial distribution.
NEEDED = {
    (0.99, 0.90): (230, 388, 531, 667, 798, 926),
    (0.9973, 0.90): (852, 1440, 1970, 2473, 2959, 3433),
    (0.99865, 0.90): (1705, 2880, 3941, 4947, 5920, 6868),
    (0.999, 0.90): (2302, 3889, 5321, 6679, 7992, 9273),
    (0.9973, 0.95): (1109, 1756, 2330, 2870),
}


@pytest.mark.parametrize("share, confidence", NEEDED)
def test_runs_that_demonstrate_a_share(share, confidence):
    found = [
        runs_needed(k, share, confidence) for k in range(len(NEEDED[share, confidence]))
    ]
    assert tuple(found) == NEEDED[share, confidence]


def results(values, outcomes=None, unit="m", name="downrange_error", **attributes):
    """A campaign of one output."""
    values = np.asarray(values, float)
    outcomes = np.zeros(values.size) if outcomes is None else outcomes
    variables = {
        name: ("run", values, {"units": unit, **attributes}),
        "outcome": ("run", np.asarray(outcomes, np.int8), {"flag_values": [0]}),
    }
    return xarray.Dataset(variables, {"run": np.arange(values.size)})


def failing(failures, runs):
    values = np.zeros(runs)
    values[:failures] = 2e3
    return results(values)


def require(text="|downrange_error| < 1 km, 99 % at 90 %"):
    return Requirement.of(text)


@pytest.mark.parametrize(
    "failures, runs, bound",
    [(0, 1000, 0.00229994), (3, 2000, 0.00333732), (10, 8000, 0.00192518)],
)
def test_bounds_on_the_probability_of_failure(failures, runs, bound):
    """Hanson and Beard's, to the digits that they have."""
    verdict = judged(failing(failures, runs), require())
    assert verdict.bound == pytest.approx(bound, abs=5e-9)
    assert (verdict.failures, verdict.runs) == (failures, runs)


def test_the_number_of_runs_decides():
    """230 of 230 pass; of 229 one more is missing, and with one failure 388 less 229."""
    assert judged(failing(0, 230), require()).decision is Decision.PASSES
    verdict = judged(failing(0, 229), require())
    assert verdict.decision is Decision.NOT_ENOUGH_RUNS
    assert (verdict.more_runs, verdict.more_runs_at_this_rate) == (1, 1)
    verdict = judged(failing(1, 229), require())
    assert verdict.more_runs == 388 - 229
    # At a failure in 229, between 531 runs, of which 2 may fail, and 667, of which 3 may.
    more = np.arange(1, 1000)
    k, n = (229 + more) / 229, 229 + more
    first = more[np.argmax(stats.beta.sf(0.01, k + 1, n - k) <= 0.1)]
    assert verdict.more_runs_at_this_rate == first and 531 < 229 + first < 667
    passed = judged(failing(0, 300), require())
    assert passed.more_runs is passed.more_runs_at_this_rate is None


def test_too_many_failures_fail():
    """P(X >= 3 of 100) at 1 % is 7.9 %, and P(X >= 2) is 26 %."""
    assert judged(failing(3, 100), require()).decision is Decision.FAILS
    verdict = judged(failing(2, 100), require())
    assert verdict.decision is Decision.NOT_ENOUGH_RUNS
    assert verdict.more_runs == 531 - 100 and verdict.more_runs_at_this_rate is None


def test_all_that_fail_have_a_bound_of_one():
    verdict = judged(failing(4, 4), require())
    assert verdict.bound == 1.0 and verdict.decision is Decision.FAILS


# What a requirement says.


@pytest.mark.parametrize(
    "text, kept",
    [
        ("downrange_error < 1 km, 50 % at 60 %", [1, 1, 0, 0]),
        ("|downrange_error| < 1 km, 50 % at 60 %", [0, 1, 0, 0]),
        ("|downrange error| <= 1000, 50 % at 60 %", [0, 1, 1, 0]),
        ("downrange-error > -2km, 50 % at 60 %", [0, 1, 1, 1]),
        ("downrange_error >= -2000 m, 50 % at 60 %", [1, 1, 1, 1]),
        ("downrange_error>1e3,50%at 60%", [0, 0, 0, 1]),
        ("downrange_error < 0.6213711922373339 mile, 50 % at 60 %", [1, 1, 0, 0]),
    ],
)
def test_what_is_kept(text, kept):
    verdict = judged(results([-2e3, 500.0, 1e3, 3e3]), require(text))
    assert verdict.failures == 4 - sum(kept)


def test_runs_without_an_end_fail():
    """Whatever their numbers are; one that skips out or times out has numbers."""
    outcomes = [0, Outcome.NOT_FINITE, Outcome.SINGULAR, Outcome.SKIPPED_OUT, 0]
    verdict = judged(results([0.0, 0.0, 0.0, 0.0, np.nan], outcomes), require())
    assert (verdict.failures, verdict.without_end) == (3, 3)
    larger = require("downrange_error > -1 km, 99 % at 90 %")
    assert judged(results([0.0, np.nan, 0.0, np.inf]), larger).failures == 2


def test_the_outcome_itself():
    outcomes = [0, Outcome.SKIPPED_OUT, Outcome.NOT_FINITE, Outcome.TIMED_OUT]
    verdict = judged(results(np.zeros(4), outcomes), require("reached, 99 % at 90 %"))
    assert (verdict.failures, verdict.without_end) == (3, 1)


def test_a_number_in_the_unit_in_which_it_is_shown():
    """A load factor is a plain number that tables call g; a gram is no load factor."""
    loads = results([1.0, 3.0], unit="1", name="peak_load_factor", shown_units="g")
    verdict = judged(loads, require("peak_load_factor < 2 g, 50 % at 60 %"))
    assert verdict.failures == 1
    with pytest.raises(ValueError, match="expected a plain number"):
        judged(loads, require("peak_load_factor < 2 km, 50 % at 60 %"))


def test_it_is_written_as_it_is_read():
    for text in (
        "|downrange_error| < 10 km, 99 % at 90 %",
        "peak_heat_rate >= 1.5e6, 99.865 % at 50 %",
        "reached, 99.9999 % at 90 %",
    ):
        assert Requirement.of(text).text == text
        assert Requirement.of(Requirement.of(text).text) == Requirement.of(text)


def test_a_sign_that_may_surprise_is_told():
    assert "has a sign" in str(require("downrange_error < 1 km, 9 % at 9 %").caution)
    assert require().caution is None
    assert require("peak_drag < 1, 9 % at 9 %").caution is None


@pytest.mark.parametrize(
    "text, message",
    [
        ("downrange_error < 10 km", "is not understood"),
        ("downrange_error < 10 km, 99 %", "is not understood"),
        ("downrange_error = 10 km, 99 % at 90 %", "is not understood"),
        ("-1 km < downrange_error < 1 km, 99 % at 90 %", "is not understood"),
        ("downrange_error, 99 % at 90 %", "reached stands alone"),
        ("reached < 3, 99 % at 90 %", "reached stands alone"),
        ("|reached|, 99 % at 90 %", "reached stands alone"),
        ("x < 1 km, 100 % at 90 %", "share of the flights is 100 %"),
        ("x < 1 km, 99 % at 0 %", "confidence is 0 %"),
        ("x < 1 km, much % at 9 %", "share of the flights is much %"),
        ("x < nan, 99 % at 90 %", "must be a finite number"),
        ("|x| < -10 km, 99 % at 90 %", "a magnitude is never below zero"),
        ("|x| > -1, 99 % at 90 %", "x without the bars"),
        ("x < ten km, 99 % at 90 %", "is not a number"),
        ("", "is not understood"),
    ],
)
def test_what_is_no_requirement_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        Requirement.of(text)


@pytest.mark.parametrize(
    "text, message",
    [
        ("downrnge_error < 1 km, 9 % at 9 %", "no downrnge_error; .*downrange_error"),
        ("downrange_error < 1 deg, 9 % at 9 %", "'1 deg'"),
        ("outcome < 1, 9 % at 9 %", "the results have no outcome"),
    ],
)
def test_what_cannot_be_judged_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        judged(failing(0, 3), Requirement.of(text))


def test_a_requirement_without_an_output_is_refused_before_the_first_flight():
    """Outputs, what is dispersed and what a law says of its decisions are known then."""
    scenario = mars_scenario(predictor_corrector())

    def known(quantity):
        asked = [require(f"{quantity} < 1, 99 % at 90 %")]
        require_outputs(asked, scenario, ["planet.density_scale"])

    for quantity in ("|downrange_error|", "peak_drag", "planet.density_scale"):
        known(quantity)
    known("decisions_without_prediction")
    require_outputs([require("reached, 99 % at 90 %")], scenario, [])
    for quantity in ("downrnge_error", "vehicle.mass", "heading_error"):
        with pytest.raises(ValueError, match=f"will have no {quantity}; nearest"):
            known(quantity)


def test_no_runs_cannot_be_judged():
    with pytest.raises(ValueError, match="no runs to judge"):
        judged(results([]), require())


def test_a_limit_that_was_meant_in_kilometres_is_refused():
    """10 m would pass for an altitude of 12 km, and fail for errors of 3 km."""
    altitudes = results([12e3, 9e3, np.nan, 13e3], name="end_altitude")
    said = r"median of the runs is 12 km: did you mean 10km\? .* 10 km or 10 m$"
    for text in (
        "end_altitude > 10, 50 % at 50 %",
        "|end_altitude| < 10, 50 % at 50 %",
    ):
        with pytest.raises(ValueError, match=said):
            judged(altitudes, require(text))
    for text, failures in (("10 km", 2), ("10 m", 1), ("1000", 1), ("0", 1)):
        found = judged(altitudes, require(f"end_altitude > {text}, 50 % at 50 %"))
        assert found.failures == failures
    signed = results([-3e3, -2e3, 1e3])
    with pytest.raises(ValueError, match="did you mean 2km"):
        judged(signed, require("downrange_error < 2, 50 % at 50 %"))
    lost = results([np.nan, np.nan])
    assert judged(lost, require("downrange_error < 2, 50 % at 50 %")).failures == 2


def test_an_angle_that_was_meant_in_degrees_is_refused():
    with pytest.raises(ValueError, match="did you mean 10deg"):
        judged(results([0.0], unit="rad"), require("downrange_error < 10, 9 % at 9 %"))


def test_several_requirements():
    passes, fails, few = (
        judged(failing(*counts), require()) for counts in ((0, 230), (9, 100), (0, 9))
    )
    assert overall([]) is overall([passes]) is Decision.PASSES
    assert overall([few, passes]) is Decision.NOT_ENOUGH_RUNS
    assert overall([few, fails, passes]) is Decision.FAILS


# Decisions are wrong at most as often as promised.

ALLOWED, RISK = 0.05, 0.10
TRUTHS = (0.01, 0.03, 0.049, 0.05, 0.051, 0.08, 0.2)


@pytest.mark.parametrize("runs", [45, 100, 500])
def test_the_fixed_test_errs_as_promised(runs):
    """Exactly: the probability of each number of failures is binomial."""
    failures = np.arange(runs + 1)
    passes = [_FIXED.passes(int(k), runs, ALLOWED, RISK) for k in failures]
    fails = [_FIXED.fails(int(k), runs, ALLOWED, RISK) for k in failures]
    assert not np.any(np.logical_and(passes, fails))
    for truth in TRUTHS:
        likely = stats.binom.pmf(failures, runs, truth)
        wrong = likely[passes if truth > ALLOWED else fails].sum()
        assert wrong <= RISK
    # And it is not timid: at the boundary it uses what the next number would exceed.
    at = stats.binom.cdf(failures, runs, ALLOWED)
    np.testing.assert_array_equal(passes, at <= RISK)
    np.testing.assert_array_equal(
        fails, stats.binom.sf(failures - 1, runs, ALLOWED) <= RISK
    )


def test_the_mixture_by_quadrature():
    """The averaged ratio of likelihoods, on both sides of the allowed probability."""
    for k, n in ((0, 40), (3, 60), (30, 100)):
        for below, (low, high) in ((True, (0, ALLOWED)), (False, (ALLOWED, 1))):
            nodes, weights = np.polynomial.legendre.leggauss(200)
            q = low + 0.5 * (high - low) * (nodes + 1)
            ratio = (q / ALLOWED) ** k * ((1 - q) / (1 - ALLOWED)) ** (n - k)
            expected = math.log(0.5 * np.sum(weights * ratio))
            found = _SEQUENTIAL._evidence(k, n, ALLOWED, below)
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("truth", TRUTHS)
def test_the_sequential_test_errs_as_promised_however_often_one_looks(truth):
    """2000 campaigns, looked at after every one of 1500 runs.

    A rate of 10 % has a standard error of 0.67 % over 2000: three of them are 2 %.
    """
    runs = np.arange(1, 1501)
    passing = np.full(runs.size, -1)
    failing_from = np.full(runs.size, runs.size + 1)
    # Failures with which it passes or fails, by bisection over what is monotone.
    most = least = 0
    for i, n in enumerate(runs):
        while _SEQUENTIAL.passes(most, int(n), ALLOWED, RISK):
            most += 1
        passing[i] = most - 1
        while least <= n and not _SEQUENTIAL.fails(least, int(n), ALLOWED, RISK):
            least += 1
        failing_from[i] = least
    draws = np.random.default_rng(5).random((2000, runs.size)) < truth
    failures = np.cumsum(draws, axis=1)
    passes, fails = failures <= passing, failures >= failing_from
    never = runs.size
    first = lambda said: np.where(said.any(axis=1), said.argmax(axis=1), never)
    passed, failed = first(passes) < first(fails), first(fails) < first(passes)
    wrong = np.mean(passed) if truth > ALLOWED else np.mean(failed)
    assert wrong <= RISK + 0.02
    if truth in (0.01, 0.2):  # far from what is allowed it decides, and rightly
        assert np.mean(passed | failed) > 0.99


def test_what_looking_as_often_as_one_likes_costs():
    """Runs of which k may fail, over those of a number that was chosen beforehand."""
    for (share, confidence), needed in NEEDED.items():
        if confidence == 0.9:
            for k in (0, 1, 3):
                passes = lambda n, k=k, q=1 - share: _SEQUENTIAL.passes(k, n, q, 0.1)
                first = next(n for n in range(needed[k], 2 * needed[k]) if passes(n))
                assert round(first / needed[k], 1) in (1.4, 1.5, 1.6)
    assert_says("It takes 1.4 to 1.6 times as many", 1.4, 1.6)


def test_the_sequential_test_takes_more_runs():
    """And its bound is where it would pass."""
    text = "|downrange_error| < 1 km, 99 % at 90 %"
    verdict = judged(failing(0, 230), require(text), sequential=True)
    assert verdict.decision is Decision.NOT_ENOUGH_RUNS and verdict.sequential
    assert verdict.more_runs is not None
    enough = 230 + verdict.more_runs
    assert judged(failing(0, enough), require(text), sequential=True).decision is (
        Decision.PASSES
    )
    assert not _SEQUENTIAL.passes(0, enough - 1, 0.01, 0.1)
    bound = _SEQUENTIAL.bound(5, 400, 0.1)
    assert _SEQUENTIAL.passes(5, 400, bound * 1.0001, 0.1)
    assert not _SEQUENTIAL.passes(5, 400, bound * 0.9999, 0.1)
