"""Several alternatives compared: their table, files, and what is left out."""

import csv
import functools
import json

import numpy as np
import pytest
from compared_campaigns import campaign, laws
from rich.console import Console
from test_report import rows

from jentry.cli.compare_report import print_alternatives, write_files
from jentry.flight import Outcome
from jentry.statistics.alternatives import alternatives_of
from jentry.statistics.comparison import compared


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
    assert "other less paper's is not known: a comparison takes two finite" in printed


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
