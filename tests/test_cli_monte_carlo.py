"""`jentry monte-carlo`: campaigns, what is stored and drawn, how they end."""

import csv
import dataclasses
import errno
import json
import math
import os

import cheap
import numpy as np
import pytest
import xarray
from commands import (
    assert_refused,
    monte_carlo,
)
from helpers import free_scenario

import jentry.plots
from jentry.addresses import replace_leaves
from jentry.campaign import open_campaign, run_campaign
from jentry.cli.options import note_step
from jentry.flight import FixedStep
from jentry.units import degree


def test_monte_carlo(command, tmp_path):
    out = tmp_path / "new" / "folder"
    code, printed, said = monte_carlo(command, "--runs", 5, "--seed", 7, "--out", out)
    assert (code, said) == (0, "")  # no bar where nobody looks
    results = open_campaign(out)
    cheap.campaign(tmp_path / "same", 5)
    same = open_campaign(tmp_path / "same")
    xarray.testing.assert_equal(results, same)
    assert "5 of 5 runs reached the end of guided flight" in printed
    assert f"stored: {out}" in printed
    assert f"{results['downrange_error'].mean().item() / 1e3:.4g}" in printed
    assert "end time" not in printed and "report FOLDER --full" in printed
    # Published values stand beside sets of what they are of, not beside anything else.
    assert "A note" not in printed and "--runs 48 compares" in printed
    sets = monte_carlo(command, "--runs", 48, "--out", tmp_path / "sets")[1]
    assert "16 sets of 3 runs against A note" in sets
    _, other, _ = monte_carlo(
        command, "--runs", 5, "--dispersions", "mass-only", "--out", tmp_path / "other"
    )
    assert "A note" not in other and "published values are of" in other
    # The same command again: nothing to fly, the same to say.
    again = monte_carlo(command, "--runs", 5, "--seed", 7, "--out", out)
    assert again == (code, printed, said)
    # Fewer: the statistics of these.
    _, other, _ = monte_carlo(command, "--runs", 1, "--seed", 7, "--out", out)
    assert "1 of 1 runs" in other


@pytest.mark.slow
def test_every_option_of_monte_carlo_arrives(command, tmp_path):
    """All at once, each other than where it is not given: the same campaign by hand."""
    out, config = tmp_path / "out", tmp_path / "overrides.toml"
    config.write_text('law = "right"\n[set]\nplanet.density_scale = 1.25')
    words = ("--law", "steep", "--set", "vehicle.mass=900", "--config", config)
    how = ("--step", 1, "--history", 20, "--dispersions", "mass-only")
    many = ("--runs", 3, "--seed", 11, "--out", out)
    code, printed, _ = command(
        "monte-carlo", "cheap", *words, *how, *many, "--no-figures"
    )
    assert code == 0 and "figures" not in printed and not (out / "figures").exists()
    changed = {"vehicle.mass": 900.0, "planet.density_scale": 1.25}
    run_campaign(
        tmp_path / "same",
        replace_leaves(free_scenario(10 * degree), changed),
        cheap.mass_only(),
        11,
        3,
        solver=cheap.SOLVER,
        history=20.0,
        mission="cheap",
        law="steep",
    )
    results, same = open_campaign(out), open_campaign(tmp_path / "same")
    xarray.testing.assert_identical(results, same)
    assert results.sizes == {"run": 3, "time": 15}


def test_results_without_a_folder_named(command, tmp_path):
    code, printed, _ = monte_carlo(command, "--runs", 2)
    assert code == 0 and "stored: results/cheap" in printed
    assert open_campaign(tmp_path / "results" / "cheap").sizes["run"] == 2


MASS = """
[dispersions.mass]
address = "vehicle.mass"
distribution = "uniform"
lower = 900
upper = 901
"""

VELOCITY = """
[dispersions.velocity]
address = "initial_state.velocity"
distribution = "uniform"
lower = -10
upper = -5
apply = "add"
"""


def test_a_requirement_without_an_output_is_refused_before_anything_is_stored(
    command, tmp_path
):
    words = ("--out", tmp_path / "out", "--require", "peak_hat < 1, 99 % at 90 %")
    answer = monte_carlo(command, "--runs", 2, *words)
    assert_refused(answer, "will have no peak_hat; nearest")
    assert not (tmp_path / "out").exists()


def test_the_step_that_is_flown_is_told(capsys):
    """Steps fill the intervals of the history: 0.2 s do not fill 0.3."""
    scenario = cheap.scenario()
    note_step(scenario, FixedStep(0.2), 0.3)
    assert "step: 0.15 s is flown in place of 0.2 s" in capsys.readouterr().out
    for step, history in ((0.2, None), (0.2, 0.4), (None, 0.3)):
        note_step(scenario, FixedStep(step), history)
        assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_dispersions_of_a_file_change_those_of_a_reading(command, tmp_path):
    """One is changed, in its place, and one added; the others are drawn as they were."""
    config = tmp_path / "overrides.toml"
    config.write_text(MASS + VELOCITY)
    out, words = tmp_path / "out", ("--runs", 2, "--seed", cheap.SEED)
    code, printed, _ = monte_carlo(command, *words, "--out", out, "--config", config)
    assert code == 0
    table = [line.split() for line in printed.splitlines() if line.startswith("│")]
    marks = {row[1]: row[-2] for row in table if row[-2] in ("changed", "added")}
    assert marks == {"mass": "changed", "velocity": "added"}
    assert "dispersions: all, changed by --config" in printed
    results = open_campaign(out)
    cheap.campaign(tmp_path / "own", 2)
    own = open_campaign(tmp_path / "own")
    assert np.all(np.abs(results["vehicle.mass"] - 900.5) <= 0.5)
    assert np.all(np.abs(results["initial_state.velocity"] - 6742.5) <= 2.5)
    others = [str(n) for n in own.data_vars if "." in str(n) and n != "vehicle.mass"]
    assert len(others) == 4
    for name in others:
        np.testing.assert_array_equal(results[name], own[name])
    stored = json.loads((out / "campaign.json").read_text())["dispersions"]
    assert list(stored) == [*cheap.dispersions(), "velocity"]
    assert stored["mass"]["lower"] == 900.0 and stored["mass"]["apply"].endswith(
        "place"
    )
    assert stored["velocity"]["addresses"] == ["initial_state.velocity"]


def test_dispersions_of_a_reading_or_of_a_file_alone(command, tmp_path):
    config = tmp_path / "overrides.toml"
    config.write_text("[dispersions]\nreplace = true\n" + MASS)
    read = ("--dispersions", "mass-only")
    for name, words, least, most in (
        ("file", ("--config", config), 900.0, 901.0),
        ("base", read, 0.95 * 992.0, 1.05 * 992.0),
    ):
        out = tmp_path / name
        assert monte_carlo(command, "--runs", 2, "--out", out, *words)[0] == 0
        results = open_campaign(out)
        assert {str(n) for n in results.data_vars if "." in str(n)} == {"vehicle.mass"}
        assert least <= results["vehicle.mass"].min()
        assert results["vehicle.mass"].max() <= most
    assert_refused(
        monte_carlo(command, "--config", config, *read, "--out", tmp_path / "both"),
        "dispersions are given by --dispersions and by --config, whose replace = true",
    )
    config.write_text(config.read_text().replace("vehicle.mass", "vehicle.mas"))
    assert_refused(
        monte_carlo(command, "--config", config, "--out", tmp_path / "none"),
        "dispersions.mass.address: no leaf 'vehicle.mas' in this scenario; "
        "nearest: vehicle.mass",
    )


@pytest.mark.parametrize(("words", "runs"), [((), 3), (("--runs", 2), 2)], ids=str)
def test_given_inputs(command, tmp_path, words, runs):
    path = tmp_path / "inputs.csv"
    masses = [900.0, 950.0, 1000.0]
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([["vehicle.mass"], *([mass] for mass in masses)])
    out = tmp_path / "out"
    code, printed, _ = monte_carlo(command, "--inputs", path, "--out", out, *words)
    assert code == 0 and f"{runs} of {runs} runs" in printed
    assert open_campaign(out)["vehicle.mass"].values.tolist() == masses[:runs]


UNITS = {"km": 1e3, "m/s": 1.0, "m/s²": 1.0, "deg": math.pi / 180.0, "s": 1.0}
"""SI value of each unit on an axis"""


def in_si(label, values):
    """What an axis shows, by the unit in its label."""
    return np.asarray(values) * UNITS[label.rpartition("(")[2].rstrip(")")]


def shown(axes, x, y):
    """A line or points of a figure in SI units."""
    return in_si(axes.get_xlabel(), x), in_si(axes.get_ylabel(), y)


@pytest.mark.slow
def test_figures_are_drawn(command, tmp_path, monkeypatch):
    """Of the runs of the campaign, in the units that their axes name."""
    drawn = {}
    save = jentry.plots.save_figures

    def keep(figures, folder, formats):
        drawn.update(figures)
        return save(figures, folder, formats)

    monkeypatch.setattr("jentry.plots.save_figures", keep)
    # All of them at once, of histories in double precision.
    every = "jentry.cli.figures.with_overview_alone"
    monkeypatch.setattr(every, lambda mission: mission)
    code, printed, said = command(
        "monte-carlo", "cheap", "--step", 1, "--runs", 4, "--out", tmp_path / "out"
    )
    assert (code, said) == (0, "")
    figures = tmp_path / "out" / "figures"
    assert f"figures: {figures}" in printed
    assert {path.stem for path in figures.glob("*.png")} == {
        "altitude",
        "bank",
        "downrange",
        "drag",
        "drag_deviation",
        "ends",
        "footprint",
        "overview",
    }
    results = open_campaign(tmp_path / "out")
    axes = {name: figure.axes[0] for name, figure in drawn.items()}
    assert axes["ends"].get_xlabel() == "ConstantBank"
    (line,) = axes["ends"].lines
    altitude = in_si(axes["ends"].get_ylabel(), line.get_ydata())
    assert altitude == pytest.approx(results["end_altitude"].values)
    nominal = {}
    for name in ("altitude", "drag", "bank"):
        (line,) = [x for x in axes[name].lines if x.get_label() == "nominal"]
        nominal[name] = shown(axes[name], *line.get_data())
    # The entry, as the scenario has it: 126.1 km, 6750 m/s, 50 deg, at t = 0.
    assert [x[0] for x in nominal["altitude"]] == pytest.approx([6750.0, 126100.0])
    assert [x[0] for x in nominal["bank"]] == pytest.approx([0.0, math.radians(50.0)])
    # At every step to the end, at which it has slowed to 503 m/s.
    time, bank = nominal["bank"]
    assert np.diff(time) == pytest.approx(1.0) and np.ptp(bank) < 1e-12
    least, most = results["end_time"].values.min(), results["end_time"].values.max()
    assert least - 1.0 < time[-1] < most + 1.0
    velocity, drag = nominal["drag"]
    assert 503.0 < velocity[-1] < 515.0  # of which it loses some 10 m/s a second
    # Drag is half of the density times the velocity squared over the ballistic
    # coefficient: 0.0158 kg/m3 exp(-h/9354.5 m), 115 kg/m2, in Mars' atmosphere.
    density = 0.0158 * np.exp(-nominal["altitude"][1] / 9354.5)
    assert drag == pytest.approx(0.5 * density * velocity**2 / 115.0, rel=1e-12)
    # The runs: all have this bank; their largest drag is about their peaks.
    banks = [x for x in axes["bank"].lines if x.get_label() != "nominal"]
    assert len(banks) == 4
    for drawn in banks:
        bank = in_si(axes["bank"].get_ylabel(), drawn.get_ydata())
        assert bank[np.isfinite(bank)] == pytest.approx(math.radians(50.0))
    (median,) = [x for x in axes["drag"].lines if x.get_label() == "median"]
    peak = in_si(axes["drag"].get_ylabel(), median.get_ydata()).max()
    peaks = results["peak_drag"].values
    assert 0.98 * peaks.min() < peak < 1.02 * peaks.max()
    # The ends: each run's own, and the mean of the histogram's heading.
    points = axes["footprint"].collections[0].get_offsets()
    ends = shown(axes["footprint"], *points.T)
    assert ends[0] == pytest.approx(results["downrange_error"].values)
    assert ends[1] == pytest.approx(results["altitude_error"].values)
    marked = [line.get_xdata()[0] for line in axes["downrange"].lines]
    mean = in_si(axes["downrange"].get_xlabel(), marked).mean()
    assert mean == pytest.approx(results["downrange_error"].values.mean())
    assert sum(bar.get_height() for bar in axes["downrange"].patches) == 4


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"", "empty; expected a line"),
        (b"\xff\xfe", "decode"),
        (b"vehicle.mass\nheavy\n", "heavy"),
        (b"vehicle.mas\n900\n", "nearest: vehicle.mass"),
        (b"vehicle.mass\n0\n", "vehicle.mass is 0 kg"),
    ],
)
def test_unreadable_inputs_are_refused(command, tmp_path, contents, message):
    path = tmp_path / "inputs.csv"
    path.write_bytes(contents)
    assert_refused(monte_carlo(command, "--inputs", path), message)
    assert not (tmp_path / "results").exists()


def test_a_folder_of_another_campaign(command, tmp_path):
    out = tmp_path / "out"
    assert monte_carlo(command, "--runs", 2, "--out", out)[0] == 0
    other = monte_carlo(command, "--runs", 2, "--out", out, "--seed", 1)
    assert_refused(other, "seed is 0 there and 1 now", 3)
    (out / "campaign.json").write_text("{}")
    foreign = monte_carlo(command, "--runs", 2, "--out", out)
    assert_refused(foreign, "campaign.json is damaged, of an earlier jentry", 3)


def test_a_full_disk(command, tmp_path, monkeypatch):
    def no_space(file):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    result = monte_carlo(command, "--runs", 2, "--out", tmp_path / "out")
    assert_refused(result, "No space left on device; free some space", 4)
    assert not list((tmp_path / "out").iterdir())


def test_a_folder_that_cannot_be_made(command, tmp_path):
    (tmp_path / "file").write_text("")
    result = monte_carlo(command, "--runs", 2, "--out", tmp_path / "file" / "out")
    assert_refused(result, "Not a directory", 4)


def test_an_interruption(command, monkeypatch):
    def interrupted(*given, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("jentry.campaign.store.run_campaign", interrupted)
    result = monte_carlo(command, "--runs", 2)
    assert_refused(result, "interrupted; the same command resumes", 130)


@pytest.mark.slow
def test_a_mission_with_a_guidance_cycle_that_varies(command, tmp_path):
    """Its campaign is stored, resumed and drawn like any other."""
    words = ("monte-carlo", "cav-h", "--law", "stored", "--runs", 3)
    words += ("--out", "glides", "--dispersions", "normal")
    code, printed, _ = command(*words, "--no-figures")
    assert code == 0
    assert "3 of 3 runs reached the end of guided flight" in printed
    assert "miss distance" in printed and "heading error" in printed
    assert command(*words)[0] == 0
    drawn = (tmp_path / "glides" / "figures").glob("*.png")
    assert [path.stem for path in drawn] == ["end_errors"]  # it has no overview
    assert command("report", "glides", "--quiet")[0] == 0
    assert (tmp_path / "glides" / "figures" / "controls.png").exists()


def test_inputs_of_a_mission_without_dispersions(command, tmp_path, monkeypatch):
    """Which has nothing else to fly."""
    from jentry.missions import ALL

    plain = dataclasses.replace(cheap.MISSION, name="plain", dispersions={})
    monkeypatch.setitem(ALL, "plain", plain)
    inputs, out = tmp_path / "inputs.csv", tmp_path / "out"
    inputs.write_text("vehicle.mass\n900\n950\n")
    words = ("--inputs", inputs, "--step", 1, "--no-figures", "--out", out)
    code, printed, _ = command("monte-carlo", "plain", *words)
    assert code == 0 and "2 of 2 runs" in printed
    assert open_campaign(out)["vehicle.mass"].values.tolist() == [900.0, 950.0]
    assert_refused(command("monte-carlo", "plain"), "has no dispersions")


def test_a_number_that_is_set_and_drawn_is_refused(command, tmp_path):
    """Each run would have the drawn one. What is drawn about a number may be set."""
    out = "--out", tmp_path / "out"
    words = "--runs", 2, "--no-figures", "--set"
    result = monte_carlo(command, *words, "planet.density_scale=1.1", *out)
    assert_refused(result, "planet.density_scale is set, but every run draws it")
    variants = "compare", "cheap", "--law", "right", "--law", "steep"
    result = command(*variants, "--set", "planet.density_scale=1.1", *out)
    assert_refused(result, "every run draws it from the dispersion 'density'")
    assert not (tmp_path / "out").exists()
    assert monte_carlo(command, *words, "vehicle.mass=900", *out)[0] == 0
