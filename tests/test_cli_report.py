"""`jentry report`: what it prints, writes and refuses, and how it ends."""

import json

import cheap
import numpy as np
import pytest
import xarray
from commands import EASY, LONG, assert_refused, monte_carlo, report

import jentry.plots
from jentry.campaign import CampaignError, open_campaign
from jentry.campaign.parts import digest_of, read_manifest
from jentry.cli.figures import store_histories, stored_histories
from jentry.missions.stored import (
    is_as_published,
    stored_mission,
    stored_scenario,
    stored_solver,
)
from jentry.statistics.acceptance import Requirement
from jentry.statistics.summary import summarize


HARD = "end_time < 1 s, 70 % at 60 %"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("stored") / "campaign"
    cheap.campaign(out, 5, mission="cheap", law="right")
    return out


def test_it_says_what_monte_carlo_has_said(command, tmp_path):
    out = tmp_path / "out"
    told = ("--percentiles", "50,97.5", "--require", EASY)
    _, first, _ = monte_carlo(command, "--runs", 5, "--out", out, *told)
    written = {
        name: (out / name).read_bytes() for name in ("summary.json", "summary.csv")
    }
    page = (out / "report.html").read_text()
    for name in (*written, "report.html"):
        (out / name).unlink()
    code, again, _ = report(command, out, *told)
    assert code == 0
    of_monte_carlo = [line for line in first.splitlines() if "stored" not in line]
    of_report = [line for line in again.splitlines() if "figures" not in line]
    assert of_report[:-1] == of_monte_carlo[1:]  # dispersions; page
    assert of_report[-1] == f"page: {out / 'report.html'}"
    for name, contents in written.items():
        assert (out / name).read_bytes() == contents
    assert (out / "report.html").read_text() == page
    assert "97.5 %" in again and "5 %" not in again.split("97.5 %")[0].split("50 %")[0]
    told = json.loads(written["summary.json"])
    assert list(told["statistics"][0]["percentiles"]) == ["50", "97.5"]
    expected = summarize(open_campaign(out), (50.0, 97.5), [Requirement.of(EASY)])
    assert written["summary.json"].decode() == expected.as_json()


def test_fewer_runs(command, folder):
    code, printed, _ = report(command, folder, "--runs", 3)
    assert code == 0 and "3 of 3 runs" in printed
    assert_refused(report(command, folder, "--runs", 6), "and ", 2)
    assert "flown with FixedStep(step=1.0), not with the mission's own" in printed
    assert_refused(report(command, folder, "--runs", 0), "must be 1 or more", 2)


def test_one_run_has_no_statistics(command, folder):
    """It does not vary, which says nothing of the mission."""
    code, printed, _ = report(command, folder, "--runs", 1)
    assert code == 0 and "one flight has no statistics; its numbers: " in printed
    assert "do not vary" not in printed and " mean " not in printed


def test_json_is_all_that_is_printed(command, folder):
    code, printed, said = report(command, folder, "--json")
    assert (code, said) == (0, "") and json.loads(printed)["runs"] == 5


def test_quiet_prints_nothing(command, folder, tmp_path):
    assert report(command, folder, "--quiet") == (0, "", "")
    out = tmp_path / "out"
    code, *rest = monte_carlo(command, "--runs", 2, "--out", out, "--quiet")
    assert (code, *rest) == (0, "", "") and (out / "summary.json").exists()
    code, printed, _ = monte_carlo(command, "--runs", 2, "--out", out, "--json")
    assert code == 0 and json.loads(printed)["runs"] == 2
    assert_refused(report(command, folder, "--quiet", "--json"), "give one of them")


@pytest.mark.parametrize(
    "requirements, code",
    [((EASY,), 0), ((HARD,), 5), ((LONG,), 6), ((LONG, EASY), 6), ((LONG, HARD), 5)],
)
def test_the_exit_code_is_the_decision(command, folder, tmp_path, requirements, code):
    words = [word for text in requirements for word in ("--require", text)]
    assert report(command, folder, *words)[0] == code
    file = tmp_path / "requirements.toml"
    file.write_text(f"require = {json.dumps(requirements)}")
    ended, printed, _ = report(command, folder, "--requirements", file)
    assert ended == code and all(f"│ {text}" in printed for text in requirements)


@pytest.mark.parametrize(
    "contents, message",
    [
        ("", "write a list of strings"),
        ("require = 'x'", "write a list of strings"),
        ("require = []", "has no requirement"),
        ("requires = ['x']", "unknown key 'requires'"),
        ("require = ['x']", "is not understood"),
    ],
)
def test_a_file_of_requirements_that_is_none(
    command, folder, tmp_path, contents, message
):
    file = tmp_path / "requirements.toml"
    file.write_text(contents)
    assert_refused(report(command, folder, "--requirements", file), message)


@pytest.mark.parametrize(
    "words, message",
    [
        (("--percentiles", "50,100"), "above 0 and below 100"),
        (("--percentiles", "many"), "write numbers separated by commas"),
        (("--format", "gif"), "choose from png, pdf, svg"),
        (("--figures-only",), "give one of them"),
        (("--figures-only", "--json"), "prints nothing: leave out --json"),
        (("--figures-only", "--percentiles", "50"), "prints nothing: leave out"),
        (("--figures-only", "--require", "reached, 9 % at 9 %"), "prints nothing"),
        (("--require", "mass < 3, 9 % at 9 %"), "the results have no mass"),
    ],
)
def test_what_cannot_be_reported(command, folder, words, message):
    assert_refused(report(command, folder, *words), message)


def test_no_campaign(command, tmp_path):
    assert_refused(report(command, tmp_path), "holds no campaign", 3)


# Figures.


@pytest.mark.slow
def test_figures_are_drawn_again_without_flying(command, tmp_path, monkeypatch):
    """The same bytes from what is stored, and others where they are asked for."""
    out = tmp_path / "out"
    words = ("monte-carlo", "cheap", "--step", 1, "--runs", 4, "--out", out)
    figures = out / "figures"
    command(*words)
    assert [path.name for path in figures.glob("*.png")] == ["overview.png"]
    every = "jentry.cli.figures.with_overview_alone"
    monkeypatch.setattr(every, lambda mission: mission)
    command(*words)
    drawn = {path.name: path.read_bytes() for path in figures.glob("*.png")}
    for name in drawn:
        (figures / name).unlink()
    (figures / "of-another-time.png").write_bytes(b"")

    def never(*args, **kwargs):
        raise AssertionError("it flies")

    monkeypatch.setattr("jentry.campaign.campaign.over_blocks", never)
    monkeypatch.setattr("jentry.cli.figures.monte_carlo", never)
    code, printed, _ = command("report", out, "--figures-only", "--format", "svg,pdf")
    assert code == 0 and printed == f"figures: {figures}\n"
    again = {path.name: path.read_bytes() for path in figures.glob("*.png")}
    assert set(again) == set(drawn)
    # In single precision: hardly a pixel differs.
    for name, contents in again.items():
        assert len(contents) == pytest.approx(len(drawn[name]), rel=0.02), name
    for name in drawn:
        stem = name.removesuffix(".png")
        assert (figures / f"{stem}.svg").read_text().startswith("<?xml")
        assert (figures / f"{stem}.pdf").read_bytes().startswith(b"%PDF")
    command("report", out)
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == len(drawn)
    # Of fewer runs: their figures alone, and none where none are drawn.
    seen = []
    draw = jentry.plots.campaign_figures
    monkeypatch.setattr(
        "jentry.plots.campaign_figures",
        lambda data, figures: seen.append(data) or draw(data, figures),
    )
    command("report", out, "--runs", 2)
    assert seen[0].results.sizes["run"] == seen[0].trajectories.sizes["run"] == 2
    assert not list(figures.glob("*.svg"))
    command("report", out, "--runs", 2, "--no-figures")
    assert "data:image/png" not in (out / "report.html").read_text()
    (figures / "histories.nc").unlink()
    code, printed, _ = command("report", out)
    assert code == 0 and "without those of histories" in printed


def test_histories_of_another_campaign_or_damaged(folder, tmp_path):
    digest = digest_of(read_manifest(folder))
    flown = xarray.Dataset({"altitude": (("run", "time"), np.ones((2, 300)))})
    store_histories(tmp_path, flown, digest)
    found = stored_histories(tmp_path, digest)
    assert found is not None
    np.testing.assert_array_equal(found["altitude"], flown["altitude"])
    # Fewer of the same campaign do not take their place.
    store_histories(tmp_path, flown.isel(run=[0]), digest)
    assert stored_histories(tmp_path, digest).sizes["run"] == 2
    with pytest.raises(CampaignError, match="of another campaign"):
        stored_histories(tmp_path, "another")
    path = tmp_path / "figures" / "histories.nc"
    path.write_bytes(path.read_bytes()[:-700])
    with pytest.raises(CampaignError, match="cannot be read"):
        stored_histories(tmp_path, digest)
    path.unlink()
    assert stored_histories(tmp_path, digest) is None


# What was flown, made again.


def test_what_was_flown_is_made_again(folder):
    description = read_manifest(folder)
    mission = cheap.MISSION
    scenario = stored_scenario(description, mission)
    assert str(scenario) == str(cheap.scenario())
    assert stored_solver(description) == cheap.SOLVER
    assert is_as_published(description, mission)
    assert not is_as_published(description | {"sampler": "Sobol"}, mission)
    assert not is_as_published(description | {"law": "steep"}, mission)
    assert not is_as_published(description | {"inputs": {"vehicle.mass": [1]}}, mission)
    changed = json.loads(json.dumps(description))
    changed["scenario"]["vehicle.mass"]["value"] *= 1 + 1e-15
    assert not is_as_published(changed, mission)
    # Numbers are those of the description, and structures are not.
    assert float(stored_scenario(changed, mission).vehicle.mass) != float(
        scenario.vehicle.mass
    )
    for broken, message in (
        (description | {"law": "left"}, "of left"),
        (description | {"structure": "another"}, "structure"),
        (
            description | {"scenario": {**changed["scenario"], "a.b": {"value": 1.0}}},
            "a.b is given only there",
        ),
    ):
        with pytest.raises(CampaignError, match=message):
            stored_scenario(broken, mission)
    with pytest.raises(CampaignError, match="Adaptive"):
        stored_solver(description | {"solver": "Adaptive(rtol=1e-9)"})


def test_a_campaign_of_no_known_mission(monkeypatch, folder):
    from jentry.missions import ALL

    monkeypatch.setitem(ALL, "cheap", cheap.MISSION)
    description = read_manifest(folder)
    assert stored_mission(description) is cheap.MISSION
    with pytest.raises(CampaignError, match="names no mission"):
        stored_mission({})
    with pytest.raises(CampaignError, match="--mission FILE.py"):
        stored_mission({"mission": "mine", "code": {"mine.py": "1"}})
    with pytest.raises(CampaignError, match="are not those"):
        stored_mission(description | {"code": {"mine.py": "1"}}, "cheap")
    with pytest.raises(CampaignError, match="is of mine"):
        stored_mission({"mission": "mine"}, "cheap")


def test_a_campaign_of_python_is_reported_without_its_mission(command, tmp_path):
    cheap.campaign(tmp_path / "own", 3)
    code, printed, _ = command("report", tmp_path / "own")
    assert code == 0 and "3 of 3 runs" in printed
    assert "no figures: the campaign was flown in Python" in printed
    result = command("report", tmp_path / "own", "--figures-only")
    assert_refused(result, "names no mission", 3)


@pytest.mark.parametrize("sampler", ["sobol", "latin-hypercube"])
def test_runs_that_are_spread_evenly_are_no_independent_ones(
    command, tmp_path, sampler
):
    """Their intervals say so, and they are not judged."""
    out = tmp_path / "out"
    words = ("--runs", 4, "--sampler", sampler, "--out", out)
    code, printed, _ = monte_carlo(command, *words)
    assert code == 0 and "those of independent draws" in printed
    assert "those of independent draws" in (out / "report.html").read_text()
    told = json.loads((out / "summary.json").read_text())
    assert "independent" in told["intervals"]["caution"]
    assert "sampler" in told["campaign"]
    result = monte_carlo(command, *words, "--require", EASY)
    assert_refused(result, "judged from independent runs")
    assert_refused(report(command, out, "--require", EASY), "fly plain draws")
    assert not is_as_published(read_manifest(out), cheap.MISSION)
    code, printed, _ = report(command, out, "--runs", 2)
    cut = "these are 2 of the 4 runs" in " ".join(printed.split())
    assert code == 0 and cut == (sampler == "latin-hypercube")
