"""`jentry optimize` and `jentry footprint`: asked, printed, written, flown again."""

import tomllib

import cheap
import numpy as np
import pytest
from commands import Arrived, assert_refused, intercepted

from jentry.flight import FixedStep
from jentry.motion.index import EnergyIndex, TimeIndex
from jentry.planning.flight_problem import AtEnd, FreeControl, Peak
from jentry.units import degree, km


ASKED = ("--maximize", "downrange", "--bank", "50deg:-90deg:90deg", "--nodes", 5)
ASKED += ("--angle-of-attack", "0deg:-1deg:1deg", "--step", 2)


@pytest.mark.slow
def test_optimize(command, tmp_path):
    """Printed and written; the file flies the same flight again, and begins there."""
    out = tmp_path / "best"
    words = (*ASKED, "--end", "altitude=8km:40km", "--out", out)
    code, printed, said = command("optimize", "cheap", *words)
    assert (code, said) == (0, "")
    assert "largest downrange at the end" in printed and "8 to 40" in printed
    assert (out / "figures" / "best-flight.png").stat().st_size > 10_000
    written = tomllib.loads((out / "optimized.toml").read_text())
    assert written["free_controls"]["nodes"] == 5
    assert written["free_controls"]["over"] == "energy"
    assert (
        written["optimized"]["objective"] > written["optimized"]["objective_at_start"]
    )
    for name in ("bank", "angle_of_attack"):
        # Those of the flight that it began with, which is not flown again for them.
        assert len(written["set"][f"guidance.{name}.breakpoints"]) == 3
        assert len(written["set"][f"guidance.{name}.coefficients"]) == 5
    config = ("--config", out / "optimized.toml", "--step", 2)
    code, flown, _ = command("fly", "cheap", *config)
    row = next(x for x in printed.splitlines() if "│ at best" in x)
    best = float(row.split("│")[2])
    assert best == pytest.approx(written["optimized"]["objective"] / km, abs=1e-5)
    row = next(x for x in flown.splitlines() if "downrange error" in x)
    error = float(row.split("│")[2])
    downrange = error + float(cheap.scenario().target.downrange) / km
    assert downrange == pytest.approx(best, abs=1e-5)
    # It is at the best already.
    words = ("--maximize", "downrange", "--bank", "50deg:-90deg:90deg")
    words += ("--angle-of-attack", "0deg:-1deg:1deg", "--end", "altitude=8km:40km")
    refused = command("optimize", "cheap", *words, *config, "--nodes", 9)
    assert_refused(refused, "--nodes or --over is given, and --config already has")
    code, again, _ = command("optimize", "cheap", *words, *config, "--out", out)
    begun = next(x for x in again.splitlines() if "│ at the start" in x)
    assert float(begun.split("│")[2]) == pytest.approx(best, abs=1e-5)


def test_every_option_of_optimize_arrives(command, monkeypatch, tmp_path):
    seen = intercepted(monkeypatch, "jentry.planning.flight_problem", "best_flight")
    config = tmp_path / "overrides.toml"
    config.write_text("[set]\nplanet.density_scale = 1.25")
    words = ("--law", "steep", "--set", "vehicle.mass=900", "--config", config)
    words += ("--minimize", "drag", "--end", "time=200s", "--end", "heading=0deg")
    words += ("--no-limits", "--bank", "10deg:-20deg:30deg", "--over", "time")
    words += ("--angle-of-attack", "1deg:0deg:2deg", "--nodes", 7, "--every", 3.5)
    with pytest.raises(Arrived):
        command("optimize", "cheap", *words, "--step", 2, "--out", tmp_path)
    scenario, problem, solver, begin = seen["given"]
    assert float(scenario.vehicle.mass) == 900.0
    assert float(scenario.planet.density_scale) == 1.25
    assert float(scenario.guidance.bank_angle) == 10 * degree
    assert problem.objective == Peak("drag") and problem.largest is False
    assert problem.bank == FreeControl(10 * degree, -20 * degree, 30 * degree)
    angle = FreeControl(1 * degree, 0 * degree, 2 * degree)
    assert problem.angle_of_attack == angle
    assert (problem.nodes, problem.history, problem.keeps_limits) == (7, 3.5, False)
    assert isinstance(problem.index, TimeIndex)
    assert list(problem.constraints) == ["time", "heading"]
    assert problem.constraints["time"].equals == 200.0
    assert problem.constraints["heading"].scale == degree
    assert solver == FixedStep(2.0) and begin is None


def test_every_option_of_footprint_arrives(command, monkeypatch, tmp_path):
    seen = intercepted(monkeypatch, "jentry.planning.landing_footprint", "footprint")
    words = ("--law", "steep", "--set", "vehicle.mass=900", "--directions", 9)
    words += ("--end", "time=200s", "--no-limits", "--bank", "10deg:-20deg:30deg")
    words += ("--over", "time", "--angle-of-attack", "1deg:0deg:2deg", "--nodes", 7)
    words += ("--every", 3.5, "--step", 2, "--out", tmp_path)
    with pytest.raises(Arrived):
        command("footprint", "cheap", *words)
    scenario, problem, directions, solver, _ = seen["given"]
    assert float(scenario.vehicle.mass) == 900.0
    assert problem.objective == AtEnd("downrange") and directions == 9
    assert problem.bank == FreeControl(10 * degree, -20 * degree, 30 * degree)
    assert (problem.nodes, problem.history, problem.keeps_limits) == (7, 3.5, False)
    assert isinstance(problem.index, TimeIndex) and list(problem.constraints) == [
        "time"
    ]
    assert solver == FixedStep(2.0)


def test_a_mission_has_problems_of_its_own(command, monkeypatch, tmp_path):
    seen = intercepted(monkeypatch, "jentry.planning.flight_problem", "best_flight")
    with pytest.raises(Arrived):
        command("optimize", "shuttle")
    problem = seen["given"][1]
    assert problem.objective == AtEnd("latitude") and problem.nodes == 40
    assert isinstance(problem.index, EnergyIndex) and problem.published
    with pytest.raises(Arrived):
        command(
            "optimize", "shuttle", "--problem", "footprint", "--minimize", "downrange"
        )
    problem = seen["given"][1]
    assert problem.objective == AtEnd("downrange") and not problem.largest
    assert problem.bank.most == 89 * degree and not problem.published
    seen = intercepted(monkeypatch, "jentry.planning.landing_footprint", "footprint")
    with pytest.raises(Arrived):
        command("footprint", "shuttle")
    assert seen["given"][1].bank.most == 89 * degree


@pytest.mark.slow
def test_footprint(command, tmp_path):
    words = (*ASKED[2:], "--directions", 1, "--out", tmp_path, "--every", 20)
    ends = ("--set", "target.downrange=700km")
    code, printed, said = command("footprint", "cheap", *words, *ends)
    assert code == 0, said
    rows = np.genfromtxt(tmp_path / "footprint.csv", delimiter=",", names=True)
    assert rows.dtype.names == ("downrange_m", "crossrange_m", "time_s")
    assert len(rows) == 5
    for along in rows["downrange_m"] / km:
        assert f"{along:.3f} km" in printed
    assert (tmp_path / "figures" / "footprint.png").stat().st_size > 10_000


REFUSED = {
    "nothing asked": (("optimize", "cheap"), "mission cheap has no problem: give"),
    "both": (
        ("optimize", "cheap", "--maximize", "time", "--minimize", "time"),
        "give --maximize or --minimize",
    ),
    "quantity": (
        ("optimize", "cheap", "--maximize", "downrnge", "--bank", "0:0:1"),
        "no quantity 'downrnge' at the end, and no path constraint; nearest: downrange",
    ),
    "end": (
        ("optimize", "cheap", *ASKED, "--end", "altitud=8km"),
        "no quantity 'altitud' at the end; nearest: altitude",
    ),
    "end without value": (
        ("optimize", "cheap", *ASKED, "--end", "altitude"),
        "write QUANTITY=VALUE",
    ),
    "end in another unit": (
        ("optimize", "cheap", *ASKED, "--end", "altitude=8s"),
        "--end altitude=8s: ",
    ),
    "end twice": (
        ("optimize", "cheap", *ASKED, "--end", "time=8s", "--end", "time=9s"),
        "--end time is given twice",
    ),
    "end turned round": (
        ("optimize", "cheap", *ASKED, "--end", "altitude=9km:8km"),
        "the first must be the smaller",
    ),
    "control": (
        ("optimize", "cheap", "--maximize", "time", "--bank", "50deg"),
        "--bank 50deg: write its start",
    ),
    "control outside": (
        ("optimize", "cheap", "--maximize", "time", "--bank", "50deg:0deg:40deg"),
        "the start must lie between",
    ),
    "degrees": (
        ("optimize", "cheap", "--maximize", "time", "--bank", "50:0:90"),
        "did you mean 50deg?",
    ),
    "every": (("optimize", "cheap", *ASKED, "--every", 0), "--every is 0.0 s"),
    "problem": (
        ("optimize", "shuttle", "--problem", "range"),
        "mission shuttle has no problem 'range': choose from cross-range, footprint",
    ),
}


@pytest.mark.parametrize(("words", "message"), REFUSED.values(), ids=REFUSED)
def test_refused(command, words, message):
    assert_refused(command(*words), message)


TABLES = {
    "unknown key": ('bank = "0"\nnode = 4', "unknown key 'node' in [free_controls]"),
    "no bank": ("nodes = 4", "[free_controls] lacks bank"),
    "nodes": ('bank = "0"\nnodes = 4.5', "free_controls.nodes is 4.5"),
    "few nodes": ('bank = "0"\nnodes = 2', "nodes is 2: a cubic has 4 or more"),
    "over": ('bank = "0"\nover = "mach"', "no index 'mach': choose from time"),
    "over a number": ('bank = "0"\nover = 3', "free_controls.over is 3"),
    "unit": ('bank = "3 km"', "free_controls.bank: '3 km' is"),
}


@pytest.mark.parametrize(("lines", "message"), TABLES.values(), ids=TABLES)
def test_tables_that_are_refused(command, tmp_path, lines, message):
    config = tmp_path / "wrong.toml"
    config.write_text(f"[free_controls]\n{lines}\n")
    assert_refused(command("fly", "cheap", "--config", config), message)
    config.write_text('free_controls = "energy"')
    refused = command("fly", "cheap", "--config", config)
    assert_refused(refused, "free_controls is 'energy': write a table")
