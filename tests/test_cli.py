"""The command: what it prints, what it writes, and how it ends."""

import csv
import errno
import importlib
import json
import os
import subprocess
import sys

import cheap
import pytest
import xarray
from helpers import fly_compiled, free_scenario
from typer.testing import CliRunner

from jentry.campaign import open_campaign
from jentry.cli import main
from jentry.missions import ALL
from jentry.units import degree


cli = importlib.import_module("jentry.cli.main")
design = importlib.import_module("jentry.cli.design")


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Runs the command in this process: its exit code, and what it printed."""
    monkeypatch.setitem(ALL, "cheap", cheap.MISSION)
    # What it settles holds for the whole process.
    for module in (cli, design):
        monkeypatch.setattr(module, "set_up", lambda *how, **options: None)
    monkeypatch.chdir(tmp_path)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["jentry", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return run


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


def test_fly_with_other_numbers_into_a_file(command, tmp_path):
    out = tmp_path / "flight.nc"
    angle = "guidance.bank_angle=10deg"
    code, printed, _ = command(
        "fly", "cheap", "--step", 1, "--set", angle, "--history", 20, "--out", out
    )
    assert code == 0 and f"written: {out}" in printed
    flight = fly_compiled(free_scenario(10 * degree), cheap.SOLVER)
    with xarray.open_dataset(out, engine="h5netcdf") as written:
        # Compiled apart: rounding, grown over the flight.
        assert written["end_time"].values == pytest.approx([flight.time.item()], 1e-11)
        # The arc cosine of a cosine.
        bank = written["bank_angle"].values[0, :3]
        assert bank == pytest.approx([10 * degree] * 3, rel=1e-12)
        described = json.loads(written.attrs["campaign"])
    assert described["solver"] == str(cheap.SOLVER)


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


def test_figures_are_drawn(command, tmp_path):
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
    assert_refused(foreign, "campaign.json is no campaign of jentry", 3)


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
    assert CliRunner().invoke(cli.app, words).exit_code == 2


@pytest.mark.parametrize("name", [None, "list", "show", "fly", "monte-carlo"])
def test_help(name):
    words = ["--help"] if name is None else [name, "--help"]
    result = CliRunner().invoke(cli.app, words)
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
        (("--runs", 1), "runs is 1"),
    ],
)
def test_tune_refuses(command, words, message):
    assert_refused(tune(command, *words), message)


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
def test_train_stores_networks_that_are_read_again(command, tmp_path):
    from jentry.missions.cav_h_networks import PURPOSES, network_predictor

    small = ("--flights", 150, "--again", 100, "--iterations", 20)
    code, printed, said = command("train", "cav-h", *small, "--out", "networks")
    assert code == 0
    assert "stored: L-BFGS, 20 iterations" in said
    for name, purpose in PURPOSES.items():
        assert name in printed
        assert network_predictor(name, tmp_path / "networks").inputs is purpose.inputs


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
