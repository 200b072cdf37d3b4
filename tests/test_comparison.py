"""Campaigns beside one another: pairs, differences, intervals, and the command."""

import csv
import dataclasses
import functools
import json
import shutil

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from commands import assert_refused
from rich.console import Console
from scipy import stats
from test_report import rows

from jentry.campaign import monte_carlo, open_campaign
from jentry.campaign.outputs import is_output
from jentry.campaign.results import output_names
from jentry.cli.campaign_report import told_first
from jentry.cli.compare_report import print_alternatives, write_files
from jentry.flight import Outcome
from jentry.motion.constraints import HeatLoad, HeatRate
from jentry.plots.comparison import draw_comparison
from jentry.statistics.alternatives import alternatives_of
from jentry.statistics.comparison import compared
from jentry.statistics.summary import summarize


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


# Several of them.


def laws(runs=301):
    """Three on the same draws, of which the last fails in two ways."""
    draws = np.random.default_rng(3)
    common = draws.normal(0.0, 1e3, runs)
    errors = [common, 0.5 * common + 40.0, 2.0 * common]
    heat = [draws.uniform(9e5, 1e6, runs) for _ in range(3)]
    outcomes = np.zeros(runs)
    outcomes[:9] = Outcome.NOT_FINITE
    outcomes[9:12] = Outcome.CRASHED
    heat[2][20] = np.nan
    made = {
        name: campaign(errors[i], outcomes=outcomes if i == 2 else None)
        for i, name in enumerate(("paper's", "tuned", "other"))
    }
    for i, results in enumerate(made.values()):
        results["peak_heat_rate"] = "run", heat[i], {"units": "W/m2"}
    lost = (outcomes == Outcome.NOT_FINITE) | np.isnan(heat[2])
    return made, errors, heat, lost


def test_each_alternative_has_a_row():
    """A lost run counts as one that is larger than any: as one of 1e300."""
    made, errors, heat, lost = laws()
    percentiles = 5.0, 50.0, 95.0, 99.0
    found = alternatives_of(made, ["downrange_error", "peak_heat_rate"], percentiles)
    assert found.same_draws and found.beyond == 0
    assert [x.words for x in found.outputs] == ["|downrange error|", "peak heat rate"]
    assert [x.shown_unit for x in found.outputs] == ["km", "W/cm2"]
    assert [(x.failures, x.not_finite) for x in found.rows] == [
        (0, 0),
        (0, 0),
        (13, 10),
    ]
    assert found.rows[2].outcomes == {
        Outcome.REACHED: 289,
        Outcome.CRASHED: 3,
        Outcome.NOT_FINITE: 9,
    }
    infinite = 0
    for i, row in enumerate(found.rows):
        for name, values in (("downrange_error", errors), ("peak_heat_rate", heat)):
            counted = np.where(lost & (i == 2), 1e300, np.abs(values[i]))
            levels = row.levels[name]
            assert list(levels.percentiles) == list(percentiles)
            for p, value in levels.percentiles.items():
                expected = np.percentile(counted, p)
                infinite += expected > 1e200
                expected = np.inf if expected > 1e200 else expected
                assert value == pytest.approx(expected, rel=1e-12)
            assert levels.maximum == np.max(counted[counted < 1e200])
    assert infinite == 2  # the 99th percentiles of the last, which loses 10 of 301
    # The others less the first, as two are compared.
    assert list(found.differences) == [("paper's", "tuned"), ("paper's", "other")]
    alone = compared(made["paper's"], made["other"])
    assert found.differences["paper's", "other"] == alone
    assert alone.left_out == 10


def test_all_of_it_in_files():
    """Every digit; a percentile among the lost is inf, or null."""
    made, errors, _, _ = laws()
    found = alternatives_of(made)
    table = list(csv.DictReader(found.as_csv().splitlines()))
    assert [row["alternative"] for row in table] == list(made)
    assert [row["failures"] for row in table] == ["0", "0", "13"]
    column = "|downrange_error| percentile_99 (m)"
    levels = [row.levels["downrange_error"] for row in found.rows]
    assert [float(row[column]) for row in table] == [x.percentiles[99] for x in levels]
    assert table[2][column] == "inf"
    told = json.loads(found.as_json())
    assert told["same_draws"] and told["runs_left_out"] == 0
    last = told["alternatives"][2]
    assert (last["failures"], last["without_finite_flight"]) == (13, 10)
    (statistics,) = last["statistics"]
    assert statistics["quantity"] == "|downrange_error|" and statistics["unit"] == "m"
    assert statistics["percentiles"]["99"] is None
    assert statistics["percentiles"]["50"] == levels[2].percentiles[50.0]
    assert statistics["maximum"] == levels[2].maximum
    first = told["differences"][0]
    assert (first["first"], first["second"]) == ("paper's", "tuned")
    assert first["paired"] and first["runs"] == 301
    (error, _) = first["outputs"]
    means = [np.abs(x).mean() for x in errors[:2]]
    assert [error["first_mean"], error["second_mean"]] == means
    assert error["mean"]["value"] == pytest.approx(means[1] - means[0])


def test_what_all_have_is_compared():
    """The runs of the shortest; and every campaign with every one before it, if asked."""
    made, *_ = laws()
    made["tuned"] = made["tuned"].isel(run=slice(200))
    found = alternatives_of(made, all_pairs=True)
    assert [row.runs for row in found.rows] == 3 * [200] and found.beyond == 202
    assert [x.name for x in found.outputs] == ["downrange_error"]
    pairs = [("paper's", "tuned"), ("paper's", "other"), ("tuned", "other")]
    assert list(found.differences) == pairs
    both = compared(made["tuned"], made["other"].isel(run=slice(200)))
    assert found.differences["tuned", "other"] == both


def test_other_draws_are_told_and_a_law_that_loses_all(capsys):
    made, *_ = laws()
    mass = np.random.default_rng(9).normal(size=20)
    made["tuned"] = campaign(np.ones(20), mass)
    made["other"]["outcome"][1:] = Outcome.NOT_FINITE
    found = alternatives_of(made)
    assert not found.same_draws and found.beyond == 0
    assert found.why == "tuned: vehicle.mass was drawn otherwise"
    assert [row.runs for row in found.rows] == [301, 20, 301]
    assert not found.differences["paper's", "tuned"].paired
    assert list(found.untold) == [("paper's", "other")]
    assert "takes two finite flights" in found.untold["paper's", "other"]
    levels = found.rows[2].levels["downrange_error"]
    assert levels.percentiles[50.0] == np.inf
    (untold,) = json.loads(found.as_json())["without_differences"]
    assert (untold["first"], untold["second"]) == ("paper's", "other")
    print_alternatives(found)
    printed = capsys.readouterr().out
    assert "3 alternatives NOT on the same draws (tuned: vehicle.mass was" in printed
    assert rows(printed)["other"][:3] == ["301", "301", "no end"]
    assert "other less paper's is not told: a comparison takes two finite" in printed


def test_what_is_left_out_is_printed(capsys):
    made, *_ = laws()
    made["tuned"] = made["tuned"].isel(run=slice(200))
    print_alternatives(alternatives_of(made))
    printed = capsys.readouterr().out
    assert "202 runs that not all of them have are left out" in printed
    assert "10 left out: not finite, or without an end" in printed


def test_the_figure_is_of_the_runs_of_the_table(tmp_path, monkeypatch):
    made, *_ = laws()
    made["tuned"] = made["tuned"].isel(run=slice(200))
    drawn = {}
    monkeypatch.setattr(
        "jentry.cli.compare_report.save_figures",
        lambda figures, folder: drawn.update(figures) or [],
    )
    write_files(tmp_path, made, alternatives_of(made, ["peak_heat_rate"]))
    (told,) = [legend.get_texts() for legend in drawn["comparison"].legends]
    assert all("200 runs" in text.get_text() for text in told)


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


def test_alternatives_that_are_refused():
    made, *_ = laws()
    with pytest.raises(ValueError, match="takes two campaigns: there are 1"):
        alternatives_of({"one": made["tuned"]})
    with pytest.raises(ValueError, match="percentile is 100: it must be above 0"):
        alternatives_of(made, percentiles=(50.0, 100.0))
    with pytest.raises(
        ValueError, match="paper's has no output downrange; nearest: down"
    ):
        alternatives_of(made, ["downrange"])
    with pytest.raises(ValueError, match="no output is to be compared"):
        alternatives_of(made, [])
    bare = campaign(np.zeros(5))
    assert [x.name for x in alternatives_of({"a": bare, "b": bare}).outputs] == [
        "downrange_error"
    ]
    bare = bare.drop_vars("downrange_error")
    with pytest.raises(ValueError, match="no output in common"):
        alternatives_of({"a": bare, "b": bare})


# The command.


def test_variants_on_the_same_draws(command, tmp_path):
    out = tmp_path / "out"
    words = ("--law", "right", "--law", "steep", "--runs", 4, "--seed", 7)
    code, printed, said = command("compare", "cheap", *words, "--step", 1, "--out", out)
    assert (code, said) == (0, "")
    cheap.campaign(tmp_path / "same", 4)
    right, steep = open_campaign(out / "right"), open_campaign(out / "steep")
    xarray.testing.assert_equal(right, open_campaign(tmp_path / "same"))
    assert json.loads(steep.attrs["campaign"])["law"] == "steep"
    assert "steep less right: 4 pairs, since 5 inputs are the same" in printed
    row = rows(printed)["end time"]
    times = right["end_time"].values, steep["end_time"].values
    assert row[1:3] == [f"{x.mean():.4f}" for x in times]
    assert row[3].startswith(f"{np.mean(times[1] - times[0]):+.4f} [")
    row = rows(printed)["steep"]
    failures = int(np.sum(steep["outcome"].values != Outcome.REACHED))
    assert row[:2] == ["4", str(failures)]
    distances = steep["miss_distance"].values / 1e3
    assert row[2:6] == [
        f"{x:.4f}" for x in (*np.percentile(distances, (50, 95, 99)), distances.max())
    ]
    assert (out / "comparison.png").exists()
    # Stored ones likewise, and no files unless a folder is given.
    code, again, _ = command("compare", out / "right", out / "steep")
    assert code == 0 and again.splitlines() == printed.splitlines()[:-1]
    code, fewer, _ = command("compare", out / "right", out / "steep", "--runs", 3)
    assert code == 0 and "3 pairs" in fewer
    words = ("compare", out / "right", out / "steep", "--quiet")
    assert command(*words) == (0, "", "")


def test_what_no_flight_has_is_refused_before_any_is_flown(command, tmp_path):
    words = ("--law", "right", "--law", "steep", "--out", tmp_path / "out")
    code, _, said = command("compare", "cheap", *words, "--outputs", "downrange_eror")
    assert code == 2
    assert "right has no output downrange_eror; nearest: downrange_error" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("heading", [None, jnp.asarray(0.1)])
def test_outputs_are_known_by_their_names_without_a_flight(heading):
    scenario = cheap.scenario()
    target = dataclasses.replace(scenario.target, heading=heading)
    scenario = dataclasses.replace(scenario, target=target)
    if heading is not None:
        constraints = {"peak": HeatRate(), "heat_load": HeatLoad()}
        scenario = dataclasses.replace(
            scenario, constraints=constraints, located_peaks=("peak",)
        )
    flown = monte_carlo(
        scenario, inputs={"vehicle.mass": [900.0]}, solver=cheap.SOLVER
    ).to_xarray(scenario)
    assert sorted(output_names(scenario)) == sorted(filter(is_output, flown.data_vars))


@pytest.mark.slow
def test_three_of_which_all_pairs_are_asked(command, tmp_path):
    cheap.campaign(tmp_path / "one", 3)
    for name in ("two", "three"):
        shutil.copytree(tmp_path / "one", tmp_path / name)
    words = ("compare", "one", "two", "three", "--outputs", "peak_drag,downrange_error")
    words += ("--percentiles", "50,90", "--out", "files")
    code, printed, _ = command(*words)
    assert code == 0
    drag = open_campaign(tmp_path / "one")["peak_drag"].values
    middle, high = np.percentile(drag, (50, 90))
    expected = ["3", "0", *(f"{x:.4f}" for x in (middle, high, drag.max()))]
    for name in ("one", "two", "three"):
        assert rows(printed)[name][:5] == expected
    assert "two less one" in printed and "three less one" in printed
    assert "three less two" not in printed and "end time" not in printed
    code, told, _ = command(*words, "--all-pairs", "--json")
    assert code == 0 and told == (tmp_path / "files" / "comparison.json").read_text()
    pairs = [(x["first"], x["second"]) for x in json.loads(told)["differences"]]
    assert pairs == [("one", "two"), ("one", "three"), ("two", "three")]
    with (tmp_path / "files" / "comparison.csv").open() as file:
        (first, *_) = csv.DictReader(file)
    assert float(first["peak_drag maximum (m/s2)"]) == drag.max()


def test_how_many_of_each_are_not_paired(command, tmp_path):
    """All of both are compared; a number that one has not is refused."""
    cheap.campaign(tmp_path / "one", 5)
    cheap.campaign(tmp_path / "two", 3, seed=cheap.SEED + 1)
    words = "compare", "one", "two", "--outputs", "|downrange error|"
    code, printed, _ = command(*words)
    assert code == 0 and "two less one: 3 and 5 flights, not paired" in printed
    told = json.loads(command(*words, "--json")[1])["differences"][0]
    assert (told["flights"], told["runs"]) == ([5, 3], 3)
    assert_refused(command(*words, "--runs", 4), "--runs is 4, and two has 3")


def test_a_narrow_terminal_has_the_table_in_pieces(monkeypatch, capsys):
    """Each piece with the names of the alternatives, and no number cut."""
    made, *_ = laws()
    console = functools.partial(
        Console, width=60, force_terminal=True, color_system=None
    )
    monkeypatch.setattr("jentry.cli.compare_report.new_console", console)
    found = alternatives_of(made, ["downrange_error", "peak_heat_rate"])
    print_alternatives(found)
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 60
    assert printed.count("│ tuned") >= 2 and "…" not in printed
    for row in found.rows:
        for output in found.outputs:
            size = row.levels[output.name].maximum / output.shown_size
            assert f"{size:.4f}" in printed
    assert "other: 3 of 301 met the surface" in printed
    assert "10 of other" in printed and "no end" in printed


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
        (("cheap", "--law", "right"), "takes two"),
        (("cheap", "--law", "right", "--law", "left"), "left: mission cheap"),
        (("cheap", "steep"), "holds no campaign"),
        (("a", "a"), "given twice"),
        (("a", "b", "--law", "right"), "compared as they are"),
        (("a", "b", "--seed", 3), "compared as they are"),
        (("a", "b", "--runs", 1), "takes 2 or more"),
        (("a", "b", "--json", "--quiet"), "give one of them"),
        (("a", "b", "--percentiles", "0"), "above 0 and below 100"),
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
    words = ("--law", "right", "--config", config)
    assert_refused(
        command("compare", "cheap", *words), "bank: dispersions.bank.address"
    )
