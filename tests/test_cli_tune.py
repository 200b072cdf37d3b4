"""`jentry tune`: what is asked, found, printed and written."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace

import cheap
import jax
import jax.numpy as jnp
import pytest
from commands import (
    OVERRIDES,
    Arrived,
    assert_overridden,
    assert_refused,
    intercepted,
    monte_carlo,
)
from helpers import fly_compiled

from jentry.addresses import leaves_by_address
from jentry.flight import misses
from jentry.tuning import (
    AutomaticDifferentiation,
    Bounds,
    Budget,
    CentralDifferences,
    DampingBelow,
    Scale,
    smooth_reversals,
    smooth_switching,
)


TUNE = ("--gains", "guidance.bank_angle", "--runs", 16, "--held-out", 32, "--step", 1)


def tune(command, *words):
    return command("tune", "cheap", *TUNE, *words)


@pytest.mark.slow
def test_tune_writes_what_monte_carlo_flies(command, tmp_path):
    code, printed, said = tune(command, "--steps", 3)
    assert code == 0
    assert said.count("step ") == 3 and "best" in said
    assert "guidance.bank_angle" in printed and "100 %" in printed
    assert "32 held-out draws" in printed and "95 % interval" in printed
    folder = tmp_path / "results" / "cheap-tuned"
    assert (folder / "course.png").read_bytes().startswith(b"\x89PNG")
    with open(folder / "course.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["1", "2", "3"]
    losses = [float(row["loss"]) for row in rows]
    best = rows[losses.index(min(losses))]
    given = ("--config", folder / "tuned.toml", "--runs", 4, "--out", "flown")
    assert monte_carlo(command, *given)[0] == 0
    described = json.loads((tmp_path / "flown" / "campaign.json").read_text())
    flown = described["scenario"]["guidance.bank_angle"]["value"]
    assert flown == float(best["guidance.bank_angle"])


def test_every_option_of_tune_arrives(command, monkeypatch, tmp_path, density):
    seen = intercepted(monkeypatch, "jentry.tuning.tuning", "tune")
    words = ("--gains", "guidance.bank_angle,vehicle.nose_radius", "--runs", 16)
    words += ("--steps", 3, "--loss", "cvar", "--of", "altitude=500m")
    words += ("--out", "there", "--optimizer", "adam", "--learning-rate", 0.3)
    words += ("--bounds", "guidance.bank_angle=0.1:1.5", "--fresh-draws", "--smooth")
    words += ("--patience", 4, "--held-out", 32, "--scale", "vehicle.nose_radius=50cm")
    with pytest.raises(Arrived):
        command("tune", "cheap", *words, *OVERRIDES, *density)
    scenario, where, loss, optimizer, draws = seen["given"]
    assert_overridden(scenario, draws.dispersions, draws.key, seen["solver"])
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
    assert seen["ranges"] == {
        "guidance.bank_angle": Bounds(0.1, 1.5),
        "vehicle.nose_radius": Scale(0.5),
    }
    assert seen["gradient"] == AutomaticDifferentiation(surrogate=smooth_switching)
    assert (draws.runs, draws.held_out, draws.fresh) == (16, 32, True)
    assert seen["budget"] == Budget(steps=3, patience=4)
    assert seen["record"].path.parent == Path("there")
    assert seen["record"].labels["learning_rate"] == 0.3


def test_a_damping_and_peaks_arrive(command, monkeypatch):
    seen = intercepted(monkeypatch, "jentry.tuning.tuning", "tune")
    words = ("--least-damping", 0.25, "--faster-than", 0.01)
    words += ("--of", "load_factor=5", "--of", "altitude=1km")
    with pytest.raises(Arrived):
        tune(command, *words)
    penalty = seen["penalty"]
    assert isinstance(penalty, DampingBelow)
    assert penalty.least == 0.25 and penalty.damping.faster_than == 0.01
    missed = SimpleNamespace(altitude=jnp.array([1e3, -1e3]))
    outputs = {**vars(missed), "load_factor": jnp.array([5.0, 10.0])}
    loss = seen["given"][2]
    assert loss(outputs) == pytest.approx(1.0 + (1.0 + 4.0) / 2.0)
    flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
    found = seen["outputs"](cheap.scenario(), flight)
    missed = vars(misses(cheap.scenario(), flight))
    assert set(found) == {n for n, x in missed.items() if x is not None} | {
        "load_factor"
    }
    assert float(found["altitude"]) == float(missed["altitude"])
    assert float(found["load_factor"]) == float(flight.peaks["load_factor"])


@pytest.mark.slow
def test_a_mission_says_what_its_tuning_is_of(command, monkeypatch):
    """And an option says otherwise."""
    seen = intercepted(monkeypatch, "jentry.tuning.tuning", "tune")
    peaks = {
        "drag_deviation": jnp.array([8e-4]),
        "angle_of_attack_deviation": jnp.array([0.0]),
        "downrange": jnp.array([5e3]),
    }
    for words, expected in (((), 4.0), (("--of", "downrange=1km"), 25.0)):
        with pytest.raises(Arrived):
            command("tune", "rlv", "--runs", 4, "--held-out", 4, *words)
        assert seen["given"][2](peaks) == pytest.approx(expected)


def test_no_damping_is_looked_at_unless_asked(command, monkeypatch):
    seen = intercepted(monkeypatch, "jentry.tuning.tuning", "tune")
    with pytest.raises(Arrived):
        tune(command)
    assert seen["penalty"] is None and seen["outputs"] is misses


@pytest.mark.slow
def test_tuning_tells_damping_and_peaks(command, tmp_path):
    """Of an open-loop law, whose phugoid no gain damps."""
    words = ("--least-damping", 0.01, "--faster-than", 1e-4)
    code, printed, _ = tune(command, *words, "--of", "load_factor=5", "--steps", 1)
    assert code == 0
    assert "peak load factor, mean" in printed
    assert "least damping of modes faster than 0.0001 rad/s, frozen: " in printed
    assert "penalty within the loss " in printed
    assert (
        "penalty_at_start = "
        in (tmp_path / "results/cheap-tuned/tuned.toml").read_text()
    )


def test_differences_arrive_with_their_surrogate(command, monkeypatch):
    seen = intercepted(monkeypatch, "jentry.tuning.tuning", "tune")
    with pytest.raises(Arrived):
        tune(command, "--differences", 0.03, "--smooth-reversals")
    assert seen["gradient"] == CentralDifferences(0.03, smooth_reversals)


@pytest.mark.slow
def test_tune_resumes_and_refuses_another_run(command):
    assert tune(command, "--steps", 2)[0] == 0
    _, _, said = tune(command, "--steps", 3)
    assert said.count("step ") == 1
    result = tune(command, "--steps", 3, "--of", "altitude=500m")
    assert_refused(result, "holds another tuning run")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--loss", "least"), "loss is 'least': choose from mean-square, power"),
        (("--optimizer", "newton"), "optimizer is 'newton': choose from lbfgs"),
        (("--gains", "guidance.bank"), "no leaf 'guidance.bank'"),
        (("--of", "range=1km"), "no miss or path constraint 'range'; nearest"),
        (("--least-damping", 0), "--least-damping is 0.0: it must be above 0"),
        (("--least-damping", 1.1), "--least-damping is 1.1: it must be above 0"),
        (("--least-damping", 0.3), "--least-damping needs --faster-than 0.1"),
        (
            ("--least-damping", 0.3, "--faster-than", -1),
            "faster_than is -1.0: it must not be negative",
        ),
        (("--of", "altitude=-1km"), "the scale must be greater than zero"),
        (("--bounds", "guidance.bank_angle=1"), "write ADDRESS=LOW:HIGH"),
        (("--bounds", "guidance.bank_angle=2:3"), "on both sides of its value"),
        (("--smooth",), "has no field of the type AbstractSwitching"),
        (("--smooth-reversals",), "has no field of the type AbstractSwitching"),
        (("--smooth", "--smooth-reversals"), "not both"),
        (("--scale", "guidance.bank_angle"), "write ADDRESS=VALUE"),
        (("--scale", "vehicle.mass=3"), "vehicle.mass has a Scale and is not tuned"),
        (("--gains", "initial_state.latitude"), "latitude is 0, from which no scale"),
        (("--differences", 0), "the step of the differences is 0.0"),
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
    with open(tmp_path / "results" / "cheap-tuned" / "course.csv") as file:
        (row,) = csv.DictReader(file)
    error = float(row["gradient_error"])
    assert 0.0 < error < float(row["gradient_norm"])
    assert f"+- {error:.2g}" in said


@pytest.mark.slow
def test_tune_prints_what_it_warns_of(command):
    bounds = ("--bounds", "guidance.bank_angle=0.8726:1.2")
    code, printed, said = tune(command, "--steps", 1, *bounds)
    assert code == 0 and "warn" not in said.lower()
    assert printed.count("guidance.bank_angle starts within") == 1
    assert "NOTE: guidance.bank_angle starts within" in printed
