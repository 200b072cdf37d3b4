"""Two campaigns compared: pairs, differences, their intervals, and the figure."""

import numpy as np
import pytest
from compared_campaigns import campaign, pair
from scipy import stats

from jentry.cli.campaign_report import told_first
from jentry.cli.compare_report import print_alternatives
from jentry.plots.comparison import draw_comparison
from jentry.statistics.alternatives import alternatives_of
from jentry.statistics.comparison import compared
from jentry.statistics.summary import summarize


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


def test_runs_are_known_by_their_numbers():
    """Of which a campaign may have any, in any order."""
    one, other = pair(60)
    first, second = campaign(one), campaign(other)
    later = slice(15, None)
    found = compared(first.isel(run=later), second.isel(run=later))
    whole = compared(campaign(one[later]), campaign(other[later]))
    assert (found.paired, found.runs, found.left_out, found.beyond) == (True, 45, 0, 0)
    assert found.differences == whole.differences
    shifted = compared(first.isel(run=slice(50)), second.isel(run=later))
    assert (shifted.paired, shifted.runs, shifted.beyond) == (True, 35, 25)
    backwards = second.isel(run=slice(None, None, -1))
    assert compared(first, backwards) == compared(first, second)
    relabelled = backwards.assign_coords(run=second["run"])
    assert not compared(first, relabelled).paired
    apart = compared(first.isel(run=slice(30)), second.isel(run=slice(30, None)))
    assert (apart.paired, apart.why) == (False, "they have no run in common")
    three = {"a": first, "b": second.isel(run=later), "c": first.isel(run=slice(50))}
    rows = alternatives_of(three)
    assert [row.runs for row in rows.rows] == [35] * 3 and rows.beyond == 25 + 10 + 15
    three["c"] = first.isel(run=slice(10))
    none = alternatives_of(three)
    assert (none.same_draws, none.why) == (False, "no run is in all of them")


def test_a_unit_of_its_own_is_of_the_same_number():
    """Where a constraint names its unit, nothing is divided by another one."""
    named = {"units": "Pa", "shown_units": "Pa", "limit": 4500.0}
    made = [campaign(np.zeros(40)) for _ in range(2)]
    for pressure, results in zip((4e3, 5e3), made, strict=True):
        results["peak_stagnation"] = "run", np.full(40, pressure), named
    (_, each) = compared(*made).differences
    assert (each.shown_unit, each.shown_size, each.mean.value) == ("Pa", 1.0, 1e3)
    found = alternatives_of(dict(zip("ab", made, strict=True)), ["peak_stagnation"])
    assert [(x.shown_unit, x.shown_size) for x in found.outputs] == [("Pa", 1.0)]
    (*_, said) = told_first(summarize(made[1]))
    assert said == "40 of 40 flights exceed the limit of the peak stagnation, 4500 Pa"


def test_few_pairs_have_no_bounds(capsys):
    """By which a difference could be told: they would be too near."""
    one, other = pair(29)
    few = compared(campaign(one), campaign(other))
    for interval in (few.differences[0].mean, few.differences[0].percentile):
        assert np.isfinite(interval.value) and np.isnan(interval[1:]).all()
    one, other = pair(30)
    enough = compared(campaign(one), campaign(other))
    assert np.isfinite(enough.differences[0].mean).all()
    print_alternatives(
        alternatives_of({"a": campaign(one[:9]), "b": campaign(other[:9])})
    )
    assert "[-]" in capsys.readouterr().out


def test_one_flight_is_no_comparison():
    one, other = pair(3)
    with pytest.raises(ValueError, match="takes two finite flights"):
        compared(campaign(one[:1]), campaign(other[:1]))


@pytest.mark.slow
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


def test_the_figure_has_lost_runs_below_nothing():
    """Also where all are lost; and a legend that stays within it, of eight."""
    far = np.array([2e3, -4e3, 6e3, 8e3])
    some, none = campaign(far, outcomes=[0, 4, 0, 0]), campaign(far, outcomes=4 * [4])
    names = [f"a law with a long name, {i}" for i in range(6)]
    several = {"some": some, "none": none} | dict.fromkeys(names, campaign(far))
    figure = draw_comparison(several, ["downrange_error"])
    (axes,) = figure.axes
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [2, 2, 6, 8])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), [0, 25, 50, 75])
    assert not len(axes.lines[1].get_xdata())
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[:3] == [
        "some, 3 of 4 runs",
        "none, 0 of 4 runs",
        f"{names[0]}, 4 runs",
    ]
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
    looks = {(line.get_color(), line.get_linestyle()) for line in axes.lines[:8]}
    assert len(looks) == 8


def test_an_output_that_none_has_is_refused():
    one, other = map(campaign, pair(10))
    with pytest.raises(
        ValueError, match="output downrange_eror; nearest: downrange_er"
    ):
        compared(one, other, ["downrange_error", "downrange_eror"])
    # One of them is enough, as without a choice.
    more = other.assign(peak_drag=other["downrange_error"])
    found = compared(one, more, ["downrange_error", "peak_drag"])
    assert found.only_one == ["peak_drag"]
