"""The command: what it prints, what it writes, and how it ends."""

import csv
import dataclasses
import errno
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import typer
import xarray
from helpers import fly_compiled, free_scenario
from typer.testing import CliRunner

import jentry.plots
from jentry.addresses import leaves_by_address, replace_leaves
from jentry.campaign import open_campaign, run_campaign
from jentry.cli.options import app
from jentry.flight import FixedStep
from jentry.missions import ALL
from jentry.tuning.smoothing import smooth_switching
from jentry.units import degree


SETTLING = ("monte-carlo", "tune", "sensitivity", "train")
"""Commands that take a number of workers"""


def monte_carlo(command, *words):
    return command("monte-carlo", "cheap", "--step", 1, "--no-figures", *words)


def assert_refused(result, message, code=2):
    """In one line, without a traceback."""
    ended, _, said = result
    assert ended == code
    assert message in said
    assert said.startswith("jentry: ") and said.count("\n") == 1


def test_list(command):
    code, printed, said = command("list")
    assert (code, said) == (0, "")
    for mission in ALL.values():
        assert mission.name in printed and mission.title in printed
        assert all(
            name in printed for name in [*mission.variants, *mission.dispersions]
        )


def test_show(command):
    code, printed, _ = command("show", "cheap", "--set", "vehicle.mass=900")
    assert code == 0
    lines = [line for line in printed.splitlines() if "vehicle.mass" in line]
    assert len(lines) == 1 and "900" in lines[0] and "kg" in lines[0]
    assert "-14.4" not in printed  # SI throughout
    assert str(round(-14.4 * degree, 9)) in printed


def test_show_a_variant_and_a_file(command, tmp_path):
    config = tmp_path / "overrides.toml"
    config.write_text('variant = "steep"\n[set]\nvehicle.mass = 900')
    _, printed, _ = command("show", "cheap", "--config", config)
    assert str(round(10 * degree, 10)) in printed and "900" in printed
    _, printed, _ = command("show", "cheap", "--config", config, "--variant", "right")
    assert str(round(50 * degree, 10)) in printed


def test_fly(command, tmp_path):
    code, printed, said = command("fly", "cheap", "--step", 1)
    assert (code, said) == (0, "")
    flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
    assert f"{float(flight.time):.4f}" in printed
    assert f"{float(flight.state.altitude) / 1e3:.6f}" in printed
    assert "cheap: reached the end of guided flight (velocity)" in printed


def test_every_option_of_fly_arrives(command, tmp_path):
    """All at once, each other than where it is not given: the same flight by hand."""
    out, config = tmp_path / "flight.nc", tmp_path / "overrides.toml"
    config.write_text('variant = "right"\n[set]\nplanet.density_scale = 1.25')
    words = ("--variant", "steep", "--set", "vehicle.mass=900", "--config", config)
    how = ("--step", 1, "--history", 20, "--out", out)
    code, printed, _ = command("fly", "cheap", *words, *how)
    assert code == 0 and f"written: {out}" in printed
    changed = {"vehicle.mass": 900.0, "planet.density_scale": 1.25}
    scenario = replace_leaves(free_scenario(10 * degree), changed)
    flight = fly_compiled(scenario, cheap.SOLVER)
    with xarray.open_dataset(out, engine="h5netcdf") as written:
        # Compiled apart: rounding, grown over the flight.
        assert written["end_time"].values == pytest.approx([flight.time.item()], 1e-11)
        altitude = flight.state.altitude.item()
        assert written["end_altitude"].values == pytest.approx([altitude], 1e-9)
        # The arc cosine of a cosine.
        bank = written["bank_angle"].values[0, :3]
        assert bank == pytest.approx([10 * degree] * 3, rel=1e-12)
        assert written["time"].values.tolist() == [20.0 * i for i in range(15)]
        described = json.loads(written.attrs["campaign"])
    assert described["solver"] == str(cheap.SOLVER)
    assert described["mission"] == "cheap" and described["history_interval"] == 20.0


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
    assert f"{results['end_time'].mean().item():.4f}" in printed
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


def test_every_option_of_monte_carlo_arrives(command, tmp_path):
    """All at once, each other than where it is not given: the same campaign by hand."""
    out, config = tmp_path / "out", tmp_path / "overrides.toml"
    config.write_text('variant = "right"\n[set]\nplanet.density_scale = 1.25')
    words = ("--variant", "steep", "--set", "vehicle.mass=900", "--config", config)
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
        variant="steep",
    )
    results, same = open_campaign(out), open_campaign(tmp_path / "same")
    xarray.testing.assert_identical(results, same)
    assert results.sizes == {"run": 3, "time": 15}


@pytest.mark.parametrize(
    ("name", "words", "expected"),
    [
        *((name, (), (None, False)) for name in SETTLING),
        *((name, ("--workers", 3), (3, False)) for name in SETTLING),
        *((name, ("--fast",), (None, True)) for name in ("monte-carlo", "tune")),
        *((name, (), (1, False)) for name in ("fly", "show")),
    ],
)
def test_workers_and_fast_arrive(command, monkeypatch, name, words, expected):
    settled = []

    def setup(workers=None, *, fast=False):
        settled.append((workers, fast))
        raise ValueError("enough")

    monkeypatch.setattr("jentry._setup.setup", setup)
    assert_refused(command(name, "cheap", *words), "enough")
    assert settled == [expected]


def test_results_without_a_folder_named(command, tmp_path):
    code, printed, _ = monte_carlo(command, "--runs", 2)
    assert code == 0 and "stored: results/cheap" in printed
    assert open_campaign(tmp_path / "results" / "cheap").sizes["run"] == 2


def test_dispersions_of_a_reading_and_of_a_file(command, tmp_path):
    config = tmp_path / "overrides.toml"
    config.write_text(
        "[dispersions.mass]\naddress = 'vehicle.mass'\n"
        "distribution = 'uniform'\nlower = 900\nupper = 901"
    )
    read = ("--dispersions", "mass-only")
    for name, words, least, most in (
        ("file", ("--config", config), 900.0, 901.0),
        ("reading", read, 0.95 * 992.0, 1.05 * 992.0),
    ):
        out = tmp_path / name
        assert monte_carlo(command, "--runs", 2, "--out", out, *words)[0] == 0
        results = open_campaign(out)
        assert {str(n) for n in results.data_vars if "." in str(n)} == {"vehicle.mass"}
        assert least <= results["vehicle.mass"].min()
        assert results["vehicle.mass"].max() <= most
    assert_refused(
        monte_carlo(command, "--config", config, *read, "--out", tmp_path / "both"),
        "dispersions are given by --dispersions and by --config",
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


UNITS = {"km": 1e3, "km/s": 1e3, "m/s²": 1.0, "deg": math.pi / 180.0, "s": 1.0}
"""SI value of each unit on an axis"""


def in_si(label, values):
    """What an axis shows, by the unit in its label."""
    return np.asarray(values) * UNITS[label.rpartition("(")[2].rstrip(")")]


def shown(axes, x, y):
    """A line or points of a figure in SI units."""
    return in_si(axes.get_xlabel(), x), in_si(axes.get_ylabel(), y)


def test_figures_are_drawn(command, tmp_path, monkeypatch):
    """Of the runs of the campaign, in the units that their axes name."""
    drawn = {}
    save = jentry.plots.save_figures

    def keep(figures, folder):
        drawn.update(figures)
        return save(figures, folder)

    monkeypatch.setattr("jentry.plots.save_figures", keep)
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
        "footprint",
        "overview",
    }
    results = open_campaign(tmp_path / "out")
    axes = {name: figure.axes[0] for name, figure in drawn.items()}
    nominal = {}
    for name in ("altitude", "drag", "bank"):
        (line,) = [x for x in axes[name].lines if x.get_label() == "nominal"]
        nominal[name] = shown(axes[name], *line.get_data())
    # The entry, as the scenario has it: 126.1 km, 6750 m/s, 50 deg, at t = 0.
    assert [x[0] for x in nominal["altitude"]] == pytest.approx([6750.0, 126100.0])
    assert [x[0] for x in nominal["bank"]] == pytest.approx([0.0, math.radians(50.0)])
    # Every 0.5 s to the end, at which it has slowed to 503 m/s.
    time, bank = nominal["bank"]
    assert np.diff(time) == pytest.approx(0.5) and np.ptp(bank) < 1e-12
    least, most = results["end_time"].values.min(), results["end_time"].values.max()
    assert least - 1.0 < time[-1] < most + 1.0
    velocity, drag = nominal["drag"]
    assert 503.0 < velocity[-1] < 510.0  # of which it loses some 10 m/s a second
    # Drag is half of the density times the velocity squared over the ballistic
    # coefficient: 0.0158 kg/m3 exp(-h/9354.5 m), 115 kg/m2, in Mars' atmosphere.
    density = 0.0158 * np.exp(-nominal["altitude"][1] / 9354.5)
    assert drag == pytest.approx(0.5 * density * velocity**2 / 115.0, rel=1e-12)
    # Bands of the runs: all have this bank; their largest drag is about their peaks.
    edges = axes["bank"].collections[0].get_paths()[0].vertices[:, 1]
    assert in_si(axes["bank"].get_ylabel(), edges) == pytest.approx(math.radians(50.0))
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


REFUSED = {
    "mission": (("fly", "chaep"), "no mission 'chaep'; nearest: cheap"),
    "variant": (
        ("fly", "cheap", "--variant", "left"),
        "mission cheap has no variant 'left': choose from right, steep",
    ),
    "reading": (
        ("monte-carlo", "cheap", "--dispersions", "none"),
        "no dispersions 'none': choose from all, mass-only",
    ),
    "address": (
        ("fly", "cheap", "--set", "vehicle.mas=900"),
        "no leaf 'vehicle.mas' in this scenario; nearest: vehicle.mass",
    ),
    "value": (
        ("show", "cheap", "--set", "vehicle.mass=much"),
        "'much' is not a number",
    ),
    "no value": (("show", "cheap", "--set", "vehicle.mass"), "write ADDRESS=VALUE"),
    "mass": (
        ("fly", "cheap", "--set", "vehicle.mass=-1"),
        "vehicle.mass is -1 kg: it must be greater than zero",
    ),
    "not finite": (
        ("monte-carlo", "cheap", "--set", "vehicle.mass=nan"),
        "vehicle.mass is nan: it must be a finite number",
    ),
    "runs": (("monte-carlo", "cheap", "--runs", "0"), "no runs to fly: runs is 0"),
    "fewer runs": (("monte-carlo", "cheap", "--runs", "-2"), "runs is -2"),
    "step": (("fly", "cheap", "--step", "0"), "step is 0.0 s: it must be positive"),
    "history": (
        ("monte-carlo", "cheap", "--runs", "2", "--history", "-1"),
        "history is -1.0 s: the interval must be positive",
    ),
}


@pytest.mark.parametrize(("words", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_input_is_refused_in_one_line(command, tmp_path, words, message):
    assert_refused(command(*words), message)
    assert not list(tmp_path.glob("**/*.nc"))


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"", "no rows"),
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


@pytest.mark.parametrize(
    "words",
    [
        ["monte-carlo", "cheap", "--runs", "many"],
        ["monte-carlo", "cheap", "--inputs", "nowhere.csv"],
        ["fly", "cheap", "--config", "nowhere.toml"],
        ["fly"],
        ["flie", "cheap"],
        [],
    ],
    ids=" ".join,
)
def test_options_that_do_not_exist(words):
    assert CliRunner().invoke(app, words).exit_code == 2


@pytest.mark.parametrize("name", [None, "list", "show", "fly", "monte-carlo"])
def test_help(name):
    words = ["--help"] if name is None else [name, "--help"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0 and "Usage" in result.output


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["list"], 0, ""),
        (["fly", "mars"], 2, "jentry: no mission 'mars'; nearest: "),
        (["monte-carlo", "mars", "--workers", "0"], 2, "jentry: workers is 0"),
    ],
)
def test_exit_codes_of_the_process(words, code, said, tmp_path):
    run = subprocess.run(
        [sys.executable, "-W", "error", "-m", "jentry", *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "JENTRY_CACHE": str(tmp_path)},
    )
    assert run.returncode == code
    assert run.stderr.startswith(said) and run.stderr.count("\n") == (code != 0)
    assert bool(run.stdout) == (code == 0)


# Design.

TUNE = ("--gains", "guidance.bank_angle", "--runs", 16, "--held-out", 32, "--step", 1)


def tune(command, *words):
    return command("tune", "cheap", *TUNE, *words)


def test_tune_writes_what_monte_carlo_flies(command, tmp_path):
    code, printed, said = tune(command, "--steps", 3)
    assert code == 0
    assert said.count("step ") == 3 and "best" in said
    assert "guidance.bank_angle" in printed and "100 %" in printed
    assert "32 held-out draws" in printed and "95 % interval" in printed
    folder = tmp_path / "results" / "cheap-tuned"
    with open(folder / "history.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["1", "2", "3"]
    losses = [float(row["loss"]) for row in rows]
    best = rows[losses.index(min(losses))]
    given = ("--config", folder / "tuned.toml", "--runs", 4, "--out", "flown")
    assert monte_carlo(command, *given)[0] == 0
    described = json.loads((tmp_path / "flown" / "campaign.json").read_text())
    flown = described["scenario"]["guidance.bank_angle"]["value"]
    assert flown == float(best["guidance.bank_angle"])


class Arrived(Exception):
    """Ends a command where it would begin to compute."""


def intercepted(monkeypatch, module, name):
    """Keeps what a function of a module is called with, and ends the command there."""
    seen = {}

    def function(*given, **options):
        seen.update(options, given=given)
        raise Arrived

    monkeypatch.setattr(sys.modules[module], name, function)
    return seen


OVERRIDES = ("--variant", "steep", "--set", "vehicle.mass=900", "--step", 2)
OVERRIDES += ("--dispersions", "mass-only", "--seed", 11)


def assert_overridden(scenario, table, key, solver):
    """What `OVERRIDES` and a density by a file come to."""
    leaves = leaves_by_address(scenario)
    assert leaves["vehicle.mass"] == 900.0
    assert leaves["planet.density_scale"] == 1.25
    assert leaves["guidance.bank_angle"] == 10 * degree
    assert table == cheap.mass_only()
    assert jax.random.key_data(key).tolist() == [0, 11]
    assert solver == FixedStep(2.0)


@pytest.fixture
def density(tmp_path):
    config = tmp_path / "overrides.toml"
    config.write_text('variant = "right"\n[set]\nplanet.density_scale = 1.25')
    return "--config", config


def test_every_option_of_tune_arrives(command, monkeypatch, tmp_path, density):
    seen = intercepted(monkeypatch, "jentry.tuning.tuning", "tune")
    words = ("--gains", "guidance.bank_angle,vehicle.nose_radius", "--runs", 16)
    words += ("--steps", 3, "--loss", "cvar", "--of", "altitude=500m")
    words += ("--out", "there", "--optimizer", "adam", "--learning-rate", 0.3)
    words += ("--bounds", "guidance.bank_angle=0.1:1.5", "--fresh-draws", "--smooth")
    words += ("--patience", 4, "--held-out", 32)
    with pytest.raises(Arrived):
        command("tune", "cheap", *words, *OVERRIDES, *density)
    scenario, where, loss, optimizer, table, key = seen["given"]
    assert_overridden(scenario, table, key, seen["solver"])
    leaves = leaves_by_address(scenario)
    two = [leaves["guidance.bank_angle"], leaves["vehicle.nose_radius"]]
    assert jax.tree.leaves(where(scenario)) == two
    # The worst twentieth of twenty, where only the altitude counts, in units of 500 m.
    far, none = jnp.linspace(-2e3, 1e3, 20), jnp.full(20, 1e9)
    missed = SimpleNamespace(altitude=far, downrange=none, crossrange=none)
    assert loss(missed) == pytest.approx(2e3 / 500.0)
    # Its first step is the learning rate.
    step, _ = optimizer.update({"x": jnp.ones(())}, optimizer.init({"x": jnp.ones(())}))
    assert step["x"] == pytest.approx(-0.3)
    assert seen["bounds"] == {"guidance.bank_angle": (0.1, 1.5)}
    assert seen["fresh_draws"] and seen["surrogate"] is smooth_switching
    numbers = {name: seen[name] for name in ("runs", "steps", "patience", "held_out")}
    assert numbers == {"runs": 16, "steps": 3, "patience": 4, "held_out": 32}
    assert seen["record"].parent == Path("there")


def test_every_option_of_sensitivity_arrives(command, monkeypatch, density):
    module = "jentry.analysis.covariance"
    seen = intercepted(monkeypatch, module, "linear_covariance")
    words = ("--scale", 0.25, "--runs", 16)
    with pytest.raises(Arrived):
        command("sensitivity", "cheap", *words, *OVERRIDES, *density)
    scenario, scaled = seen["given"]
    # A quarter as wide about the mean: 0.95 to 1.05 becomes 0.9875 to 1.0125.
    uniform = scaled["mass"].distribution
    assert [uniform.lower, uniform.upper] == pytest.approx([0.9875, 1.0125])
    as_it_is = cheap.mass_only()["mass"].distribution
    table = {"mass": dataclasses.replace(scaled["mass"], distribution=as_it_is)}
    assert_overridden(scenario, table, seen["key"], seen["solver"])
    assert seen["runs"] == 16
    seen = intercepted(monkeypatch, "jentry.analysis.sensitivities", "sensitivity")
    with pytest.raises(Arrived):
        command("sensitivity", "cheap", "--wrt", "vehicle.mass", *OVERRIDES, *density)
    (scenario,) = seen["given"]
    assert jax.tree.leaves(seen["wrt"](scenario)) == [900.0]
    assert seen["solver"] == FixedStep(2.0)


def test_every_option_of_train_arrives(command, monkeypatch):
    seen = {}

    def train(folder, seed, **options):
        seen.update(options, folder=folder, seed=seed)
        raise Arrived

    able = dataclasses.replace(cheap.MISSION, train=train)
    monkeypatch.setitem(ALL, "cheap", able)
    words = ("--out", "there", "--seed", 11, "--flights", 150, "--again", 120)
    with pytest.raises(Arrived):
        command("train", "cheap", *words, "--iterations", 7)
    del seen["report"]
    numbers = {"seed": 11, "flights": 150, "again": 120, "iterations": 7}
    assert seen == {"folder": Path("there"), **numbers}


RUN = {"variant", "set", "config", "step"}

ARRIVE = {
    "list": set(),
    "show": {"variant", "set", "config"},
    "fly": RUN | {"history", "out"},
    "monte-carlo": RUN
    | {"runs", "seed", "out", "workers", "dispersions", "inputs", "history", "fast"}
    | {"no-fast", "figures", "no-figures"},
    "tune": RUN
    | {"gains", "runs", "steps", "loss", "of", "out", "optimizer", "learning-rate"}
    | {"bounds", "smooth", "no-smooth", "fresh-draws", "no-fresh-draws", "patience"}
    | {"held-out", "seed", "workers", "dispersions", "fast", "no-fast"}
    | {"scale", "differences", "smooth-reversals", "no-smooth-reversals"},
    "train": {"out", "seed", "flights", "again", "iterations", "workers"},
    "sensitivity": RUN
    | {"wrt", "scale", "runs", "seed", "workers", "dispersions", "differences"}
    | {"no-differences"},
}


def test_every_option_is_in_a_test_of_what_arrives():
    """Those above, each with all options of its command; add yours there, and here."""
    commands = typer.main.get_command(app).commands
    options = {
        name: {
            word.removeprefix("--")
            for parameter in command.params
            for word in (*parameter.opts, *parameter.secondary_opts)
            if word.startswith("--") and word != "--help"
        }
        for name, command in commands.items()
    }
    assert options == ARRIVE


def test_tune_resumes_and_refuses_another_run(command):
    assert tune(command, "--steps", 2)[0] == 0
    _, _, said = tune(command, "--steps", 3)
    assert said.count("step ") == 1
    result = tune(command, "--steps", 3, "--of", "altitude=500m")
    assert_refused(result, "holds another tuning run")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--loss", "least"), "loss is 'least': choose from mean-square, cvar"),
        (("--optimizer", "newton"), "optimizer is 'newton': choose from lbfgs"),
        (("--gains", "guidance.bank"), "no leaf 'guidance.bank'"),
        (("--of", "range=1km"), "no miss 'range'; nearest"),
        (("--of", "altitude=-1km"), "the scale must be greater than zero"),
        (("--bounds", "guidance.bank_angle=1"), "write ADDRESS=LOW:HIGH"),
        (("--bounds", "guidance.bank_angle=2:3"), "on both sides of its value"),
        (("--smooth",), "has no field of the type AbstractSwitching"),
        (("--smooth-reversals",), "has no field of the type AbstractSwitching"),
        (("--smooth", "--smooth-reversals"), "not both"),
        (("--scale", "guidance.bank_angle"), "write ADDRESS=VALUE"),
        (("--scale", "vehicle.mass=3"), "vehicle.mass has a scale and is not tuned"),
        (("--gains", "initial_state.latitude"), "latitude is 0, which does not tell"),
        (("--differences", 0), "difference_step is 0.0"),
        (("--runs", 1), "runs is 1"),
    ],
)
def test_tune_refuses(command, words, message):
    assert_refused(tune(command, *words), message)


def test_tune_by_differences_prints_their_error(command, tmp_path):
    """Of two numbers, of which one is zero and has a scale."""
    latitude = "initial_state.latitude"
    given = ("--gains", latitude, "--scale", f"{latitude}=0.01")
    code, _, said = tune(command, "--steps", 1, "--differences", 0.02, *given)
    assert code == 0 and " +- " in said
    with open(tmp_path / "results" / "cheap-tuned" / "history.csv") as file:
        (row,) = csv.DictReader(file)
    error = float(row["gradient_error"])
    assert 0.0 < error < float(row["gradient_norm"])
    assert f"+- {error:.2g}" in said


def test_tune_prints_what_it_warns_of(command):
    bounds = ("--bounds", "guidance.bank_angle=0.8726:1.2")
    code, printed, said = tune(command, "--steps", 1, *bounds)
    assert code == 0 and "warn" not in said.lower()
    assert printed.count("guidance.bank_angle starts within") == 1
    assert "NOTE: guidance.bank_angle starts within" in printed


def test_sensitivity_by_differences_prints_their_errors(command):
    given = ("--differences", "--step", 1, "--scale", 1, "--runs", 0)
    code, printed, said = command("sensitivity", "cheap", *given)
    assert (code, said) == (0, "")
    assert "predicted from mean differences" in printed and "+-" in printed


def test_sensitivity_prints_derivatives_and_spreads(command):
    given = ("--wrt", "initial_state.velocity,vehicle.mass", "--runs", 40)
    code, printed, said = command(
        "sensitivity", "cheap", "--step", 1, "--scale", 0.1, *given
    )
    assert (code, said) == (0, "")
    for words in ("initial_state.velocity", "vehicle.mass", "dispersions x 0.1"):
        assert words in printed
    assert "holds" in printed and "one std of" in printed


def test_sensitivity_refuses_a_scale_of_nothing(command):
    result = command("sensitivity", "cheap", "--step", 1, "--scale", 0)
    assert_refused(result, "scale is 0: it must be greater than zero")


# Networks.


def test_train_is_for_missions_with_networks(command):
    assert_refused(
        command("train", "mars-drag-tracking"), "has no networks to train: cav-h has"
    )
    assert_refused(command("train", "cav-h", "--flights", 3), "--flights is 3")
    assert_refused(command("train", "cav-h", "--iterations", 0), "--iterations is 0")


@pytest.mark.slow
def test_train_stores_networks_that_are_read_again(command, monkeypatch, tmp_path):
    """One of them: the others take as long."""
    from jentry.missions.cav_h.training import PURPOSES, network_predictor

    for name in set(PURPOSES) - {"stored"}:
        monkeypatch.delitem(PURPOSES, name)
    small = ("--flights", 150, "--again", 100, "--iterations", 20)
    code, printed, said = command("train", "cav-h", *small, "--out", "networks")
    assert code == 0
    assert "stored: L-BFGS, 20 iterations" in said
    for name, purpose in PURPOSES.items():
        assert name in printed
        assert network_predictor(name, tmp_path / "networks").inputs is purpose.inputs


@pytest.mark.slow
def test_a_mission_with_a_guidance_cycle_that_varies(command, tmp_path):
    """Its campaign is stored, resumed and drawn like any other."""
    words = ("monte-carlo", "cav-h", "--variant", "stored", "--runs", 3)
    words += ("--out", "glides", "--dispersions", "normal")
    code, printed, _ = command(*words, "--no-figures")
    assert code == 0
    assert "3 of 3 runs reached the end of guided flight" in printed
    assert "miss distance" in printed and "heading error" in printed
    assert command(*words, "--no-figures")[0] == 0


@pytest.mark.slow
def test_its_figures(command, tmp_path):
    words = ("monte-carlo", "cav-h", "--variant", "stored", "--runs", 3)
    assert command(*words, "--out", "glides", "--dispersions", "normal")[0] == 0
    assert (tmp_path / "glides" / "figures" / "end_errors.png").exists()
    assert (tmp_path / "glides" / "figures" / "controls.png").exists()
