"""Campaigns beside one another: pairs, differences, intervals, and the command."""

import json

import cheap
import numpy as np
import pytest
import xarray
from commands import assert_refused
from scipy import stats
from test_report import rows

from jentry.campaign import open_campaign
from jentry.plots.comparison import draw_comparison
from jentry.statistics.comparison import compared


def campaign(errors, mass=None, outcomes=None, **more):
    count = len(errors)
    outcomes = np.zeros(count) if outcomes is None else outcomes
    mass = np.arange(float(count)) if mass is None else mass
    columns = {"vehicle.mass": mass, "downrange_error": errors, **more}
    columns["outcome"] = np.asarray(outcomes, np.int8)
    return xarray.Dataset(
        {n: ("run", np.asarray(x), {"units": "m"}) for n, x in columns.items()},
        {"run": np.arange(count)},
    )


def pair(runs=300, seed=0, gain=0.5):
    draws = np.random.default_rng(seed)
    common = draws.normal(0.0, 1e3, runs)
    return common + draws.normal(0, 50, runs), gain * common + draws.normal(0, 50, runs)


def test_differences_are_those_of_the_magnitudes():
    one, other = pair()
    found = compared(campaign(one), campaign(other))
    assert found.paired and found.runs == 300 and found.left_out == 0
    (each,) = found.differences
    a, b = np.abs(one), np.abs(other)
    assert (each.first, each.second) == (a.mean(), b.mean())
    assert each.mean.value == pytest.approx(b.mean() - a.mean())
    spread = np.std(b, ddof=1) - np.std(a, ddof=1)
    assert each.standard_deviation.value == pytest.approx(spread)
    assert each.percentile.value == np.percentile(b, 95) - np.percentile(a, 95)
    assert each.words == "|downrange error|" and each.shown_unit == "km"
    # The paired interval is that of Student's t within the bootstrap's noise.
    t = stats.ttest_rel(b, a).confidence_interval(0.95)
    width = t.high - t.low
    assert each.mean.lower == pytest.approx(t.low, abs=0.1 * width)
    assert each.mean.upper == pytest.approx(t.high, abs=0.1 * width)
    assert each.smaller is not None
    share = stats.binomtest(int(np.sum(b < a)), 300).proportion_ci()
    assert each.smaller == pytest.approx((np.mean(b < a), *share), abs=1e-9)


def test_without_pairs_the_interval_is_wider():
    one, other = pair()
    mass = np.random.default_rng(9).normal(size=300)
    found = compared(campaign(one), campaign(other, mass))
    assert not found.paired and found.why == "vehicle.mass was drawn otherwise"
    (each,) = found.differences
    assert each.smaller is None
    t = stats.ttest_ind(np.abs(other), np.abs(one), equal_var=False)
    low, high = t.confidence_interval(0.95)
    assert each.mean.lower == pytest.approx(low, abs=0.1 * (high - low))
    assert each.mean.upper == pytest.approx(high, abs=0.1 * (high - low))
    (together,) = compared(campaign(one), campaign(other)).differences
    assert together.mean.upper - together.mean.lower < 0.8 * (high - low)


def test_a_campaign_is_no_different_from_itself():
    one, _ = pair()
    found = compared(campaign(one), campaign(one))
    (each,) = found.differences
    for interval in (each.mean, each.standard_deviation, each.percentile):
        assert interval == (0.0, 0.0, 0.0)
    assert each.smaller is not None and each.smaller.value == 0.5


def test_pairs_of_which_one_has_no_end_are_left_out():
    one, other = pair(6)
    outcomes = [0, 4, 0, 0, 0, 0]
    other[3] = np.nan
    found = compared(campaign(one, outcomes=outcomes), campaign(other))
    assert (found.runs, found.left_out) == (4, 2)
    (each,) = found.differences
    kept = [0, 2, 4, 5]
    expected = np.abs(other[kept]).mean() - np.abs(one[kept]).mean()
    assert each.mean.value == pytest.approx(expected)


def test_campaigns_of_unequal_length_and_other_inputs():
    """As far as both go; inputs and outputs of one of them alone are named."""
    one, other = pair(10)
    law = {"guidance.gain": np.ones(6), "peak_drag": np.ones(6)}
    found = compared(campaign(one), campaign(other[:6], **law))
    assert found.paired and found.runs == 6
    assert found.why == "1 input is the same in each run, 1 are of one of them alone"
    assert found.only_one == ["peak_drag"]
    nothing = campaign(other).drop_vars("vehicle.mass")
    assert (
        compared(campaign(one), nothing).why
        == "they have no input in common that varies"
    )


def test_one_flight_is_no_comparison():
    one, other = pair(3)
    with pytest.raises(ValueError, match="takes two finite flights"):
        compared(campaign(one[:1]), campaign(other[:1]))


def test_intervals_of_differences_cover():
    """400 pairs of campaigns: a rate of 95 % has a standard error of 1.1 %."""
    covers = []
    for seed in range(400):
        one, other = pair(100, seed)
        (each,) = compared(campaign(one), campaign(other)).differences
        # Means of the magnitudes of normal numbers: s sqrt(2 / pi).
        sizes = np.sqrt([1e6 + 50**2, 0.25e6 + 50**2])
        truth = np.diff(sizes * np.sqrt(2.0 / np.pi))[0]
        covers.append(each.mean.lower <= truth <= each.mean.upper)
    assert 0.91 <= np.mean(covers) <= 0.98


def test_the_figure_has_one_unit_for_all():
    """Of errors that are below 10 m in one campaign and kilometres in the other."""
    far = np.array([2e3, -4e3, 6e3, 8e3])
    figure = draw_comparison(
        {"near": campaign(far / 1e3), "far": campaign(far)}, ["downrange_error"]
    )
    (axes,) = figure.axes
    assert axes.get_xlabel() == "|Downrange error| (km)"
    near, distant = axes.lines[:2]
    np.testing.assert_allclose(near.get_xdata()[1:], [2e-3, 4e-3, 6e-3, 8e-3])
    np.testing.assert_allclose(distant.get_xdata()[1:], [2, 4, 6, 8])
    np.testing.assert_allclose(distant.get_ydata(), [0, 25, 50, 75, 100])
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["near, 4 runs", "far, 4 runs"]


# The command.


def test_variants_on_the_same_draws(command, tmp_path):
    out = tmp_path / "out"
    words = ("--variant", "right", "--variant", "steep", "--runs", 4, "--seed", 7)
    code, printed, said = command("compare", "cheap", *words, "--step", 1, "--out", out)
    assert (code, said) == (0, "")
    cheap.campaign(tmp_path / "same", 4)
    right, steep = open_campaign(out / "right"), open_campaign(out / "steep")
    xarray.testing.assert_equal(right, open_campaign(tmp_path / "same"))
    assert json.loads(steep.attrs["campaign"])["variant"] == "steep"
    assert "steep less right: 4 pairs, since 5 inputs are the same" in printed
    row = rows(printed)["end time"]
    times = right["end_time"].values, steep["end_time"].values
    assert row[1:3] == [f"{x.mean():.4f}" for x in times]
    assert row[3].startswith(f"{np.mean(times[1] - times[0]):+.4f} [")
    assert (out / "comparison.png").exists()
    # Stored ones likewise, and no figure unless a folder is given.
    code, again, _ = command("compare", out / "right", out / "steep")
    assert code == 0 and again.splitlines() == printed.splitlines()[:-1]
    code, fewer, _ = command("compare", out / "right", out / "steep", "--runs", 3)
    assert code == 0 and "3 pairs" in fewer
    words = ("compare", out / "right", out / "steep", "--quiet")
    assert command(*words) == (0, "", "")


def test_a_configuration_beside_the_mission(command, tmp_path):
    config = tmp_path / "heavy.toml"
    config.write_text('[set]\n"planet.density_scale" = 1.01')
    words = ("--config", config, "--runs", 2, "--dispersions", "mass-only", "--quiet")
    code, printed, _ = command("compare", "cheap", *words, "--step", 1)
    assert (code, printed) == (0, "")
    assert (tmp_path / "results" / "cheap-compared" / "comparison.png").exists()
    folder = tmp_path / "results" / "cheap-compared"
    described = json.loads(open_campaign(folder / "heavy").attrs["campaign"])
    assert described["scenario"]["planet.density_scale"]["value"] == 1.01


@pytest.mark.parametrize(
    "words, message",
    [
        (("cheap",), "takes two"),
        (("cheap", "--variant", "right"), "takes two"),
        (("cheap", "--variant", "right", "--variant", "left"), "left: mission cheap"),
        (("cheap", "steep"), "holds no campaign"),
        (("a", "a"), "given twice"),
        (("a", "b", "--variant", "right"), "compared as they are"),
        (("a", "b", "--seed", 3), "compared as they are"),
        (("a", "b", "--runs", 1), "takes 2 or more"),
    ],
)
def test_what_cannot_be_compared(command, words, message):
    result = command("compare", *words)
    assert_refused(result, message, 3 if "holds" in message else 2)


def test_what_does_not_fit_is_said(command, tmp_path):
    """A dispersion of a leaf that one of the variants does not have."""
    config = tmp_path / "bank.toml"
    config.write_text(
        '[dispersions.bank]\naddress = "guidance.bank_angl"\n'
        'distribution = "uniform"\nlower = 0.1\nupper = 0.2\n'
    )
    words = ("--variant", "right", "--config", config)
    assert_refused(
        command("compare", "cheap", *words), "bank: dispersions.bank.address"
    )
