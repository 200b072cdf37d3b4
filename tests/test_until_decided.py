"""`--until-decided` adds runs until a requirement is decided."""

import numpy as np
import pytest
import xarray
from commands import EASY, LONG, assert_refused, monte_carlo, report

from jentry.campaign import open_campaign
from jentry.cli.until_decided import further_runs
from jentry.statistics.acceptance import Requirement, judged


def runs_of(values):
    count = len(values)
    columns = {
        "peak_drag": ("run", np.asarray(values, float), {"units": "m/s2"}),
        "outcome": ("run", np.zeros(count, np.int8), {"flag_values": [0]}),
    }
    return xarray.Dataset(columns, {"run": np.arange(count)})


def test_how_many_runs_are_flown_next():
    """Twice as many at most, fewer where fewer decide, none beyond the most."""
    one = [Requirement.of("peak_drag < 1, 99 % at 90 %")]
    assert further_runs(one, runs_of(np.zeros(100)), 10_000) == 100
    enough = judged(runs_of(np.zeros(300)), one[0], sequential=True).more_runs
    assert enough is not None and 0 < enough < 300
    assert further_runs(one, runs_of(np.zeros(300)), 10_000) == enough
    assert further_runs(one, runs_of(np.zeros(300)), 310) == 10
    assert further_runs(one, runs_of(np.zeros(300)), 300) == 0
    assert further_runs(one, runs_of(np.zeros(300 + enough)), 10_000) == 0
    failing = [Requirement.of("peak_drag > 1, 99 % at 90 %")]
    assert further_runs(failing + one, runs_of(np.zeros(100)), 10_000) == 0


@pytest.mark.slow
def test_more_runs_until_it_is_decided(command, tmp_path):
    out, same = tmp_path / "out", tmp_path / "same"
    words = ("--runs", 2, "--until-decided", "--require", EASY)
    code, printed, _ = monte_carlo(command, *words, "--out", out)
    assert code == 0 and "sequential, valid at whatever number of runs" in printed
    count = open_campaign(out).sizes["run"]
    assert 3 < count < 40
    verdict = judged(open_campaign(out, count), Requirement.of(EASY), sequential=True)
    assert verdict.decision.value == "passes"
    # The same runs as in one go, and what is said of them stays sequential.
    monte_carlo(command, "--runs", count, "--out", same)
    xarray.testing.assert_equal(open_campaign(out), open_campaign(same))
    code, printed, _ = report(command, out)
    assert code == 0 and "sequential" in printed and f"│ {EASY}" in printed
    code, printed, _ = report(command, same, "--require", EASY)
    assert code == 0 and "chosen beforehand" in printed
    # Merged, it is still one that was added to.
    command("merge", tmp_path / "merged", out)
    assert "sequential" in report(command, tmp_path / "merged")[1]
    (out / "until-decided.json").write_text("{}")
    assert_refused(report(command, out), "is not as it was written", 3)


def test_what_has_decided_belongs_to_its_campaign(command, tmp_path):
    """A folder without runs is taken over, and what lies there is of nobody."""
    out = tmp_path / "out"
    words = ("--runs", 2, "--until-decided", "--require", LONG, "--most-runs", 3)
    assert monte_carlo(command, *words, "--out", out)[0] == 6
    for path in out.glob("runs-*"):
        path.unlink()
    code, printed, _ = monte_carlo(command, "--runs", 2, "--seed", 9, "--out", out)
    assert code == 0 and "acceptance" not in printed


@pytest.mark.slow
def test_it_stops_at_the_most(command, tmp_path):
    words = ("--runs", 2, "--until-decided", "--require", LONG, "--most-runs", 5)
    code, printed, _ = monte_carlo(command, *words, "--out", tmp_path / "out")
    assert code == 6 and "5 of 5 runs" in printed and "more runs if none" in printed


def test_the_most_runs_are_of_a_campaign_that_is_extended(command, tmp_path):
    out = "--out", tmp_path / "out"
    result = monte_carlo(command, "--most-runs", 5, *out)
    assert_refused(result, "--most-runs needs --until-decided")
    words = ("--runs", 2, "--until-decided", "--require", LONG, "--most-runs", 1)
    assert_refused(monte_carlo(command, *words, *out), "--most-runs is 1, and --runs")
    assert not (tmp_path / "out").exists()


def test_until_decided_needs_a_requirement(command, tmp_path):
    result = monte_carlo(command, "--until-decided", "--out", tmp_path)
    assert_refused(result, "needs a requirement")
    inputs = tmp_path / "inputs.csv"
    inputs.write_text("vehicle.mass\n900\n")
    words = ("--until-decided", "--require", EASY, "--inputs", inputs)
    assert_refused(monte_carlo(command, *words), "has no more")
