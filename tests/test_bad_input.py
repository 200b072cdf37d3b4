"""Wrong input is refused: an exit code, the word that tells what is wrong, nothing written.

A table over the commands and over what is called from Python, and texts that nobody wrote.
"""

import dataclasses
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import cheap
import equinox as eqx
import hypothesis
import jax
import numpy as np
import pytest
from hypothesis import strategies as st

import jentry
from jentry.addresses import leaves_by_address, unit_of
from jentry.campaign.dispersions import check_dispersions, key_of
from jentry.cli.options import chosen_scenario, dispersion_table
from jentry.flight import Adaptive, FixedStep, Termination, VelocityBelow, fly
from jentry.missions import ALL
from jentry.units import degree, parse_quantity
from jentry.world import TabulatedAtmosphere, TabulatedWind


# Commands. Each case: words, exit code, and what must be said.

STATE = "initial_state."

SET = {
    # no quantity
    "vehicle.mass": "write ADDRESS=VALUE",
    "": "write ADDRESS=VALUE",
    "vehicle.mass=": "vehicle.mass: '' is not a number",
    "vehicle.mass=heavy": "'heavy' is not a number",
    "vehicle.mass=1,5": "'1,5' is not a number",
    "vehicle.mass=1 2": "'1 2' is not a number",
    "vehicle.mass==900": "'=900' is not a number",
    "vehicle.mass=900 900kg": "is not a number",
    "vehicle.mass=1 kg**9**9**9": "is not a number",
    "vehicle.mass=[900]": "is not a number",
    "vehicle.mass=900 stone": "'stone'",
    "vehicle.mass=900 KG": "'KG'",
    "vehicle.mass=900 kg/": "not known",
    # no leaf
    "=3": "no leaf ''",
    "vehicle=900": "no leaf 'vehicle'",
    "vehicle.mas=900": "nearest: vehicle.mass",
    "vehicle.mass.x=900": "nearest: vehicle.mass",
    "Vehicle.Mass=900": "no leaf 'Vehicle.Mass'",
    "dynamics=1": "no leaf 'dynamics'",
    "termination.time_limit=100": "no leaf 'termination.time_limit'",
    "termination.conditions.0.velocity=1": "no leaf",
    "guidance.__class__=1": "no leaf",
    # another dimension
    "vehicle.mass=900km": "[length]",
    "vehicle.mass=900 %": "without a dimension",
    "vehicle.mass=9 N": "[mass] * [length] / [time] ** 2",
    "vehicle.reference_area=16m": "a number in m2",
    "vehicle.nose_radius=1 m2": "[length] ** 2",
    "vehicle.lift_scale=1m": "a plain number",
    "planet.density_scale=1deg": "a plain number",
    "planet.density_scale=1 kg/m3": "a plain number",
    "planet.rotation_rate=1 rad": "a number in rad/s",
    "planet.rotation_rate=1 Hz": "a number in rad/s",
    "planet.radius=3397 deg": "[angle]",
    "planet.gravity.gravitational_parameter=4e4 km2": "m3/s2",
    "planet.atmosphere.scale_height=9 s": "[time]",
    "planet.atmosphere.surface_density=1 kg/m2": "kg/m3",
    "planet.atmosphere.gas_constant=287 J/kg": "J/(kg K)",
    "planet.heating_coefficient=1 kg/m": "kg^0.5/m",
    STATE + "altitude=126deg": "a number in m",
    STATE + "longitude=1km": "a number in rad",
    STATE + "latitude=1 %": "a number in rad",
    STATE + "velocity=5km": "a number in m/s",
    STATE + "flight_path_angle=-14.2 m": "a number in rad",
    STATE + "heading=90 deg/s": "a number in rad",
    "termination.conditions.velocity.velocity=503m": "a number in m/s",
    "target.altitude=10 km/s": "a number in m",
    "guidance.bank_angle=3 %": "a number in rad",
    # degrees forgotten
    STATE + "flight_path_angle=-14.2": "did you mean -14.2deg?",
    STATE + "heading=90": "did you mean 90deg?",
    STATE + "longitude=137.4": "did you mean 137.4deg?",
    STATE + "latitude=2": "did you mean 2deg?",
    STATE + "latitude=-4.5": "did you mean -4.5deg?",
    "guidance.bank_angle=50": "did you mean 50deg?",
    "vehicle.trim_angle_of_attack=11": "did you mean 11deg?",
    # out of range
    "vehicle.mass=0": "vehicle.mass is 0 kg: it must be greater than zero",
    "vehicle.mass=-1 kg": "greater than zero",
    "vehicle.mass=nan": "vehicle.mass is nan: it must be a finite number",
    "vehicle.mass=inf": "a finite number",
    "vehicle.mass=1e999": "a finite number",
    "vehicle.mass=1e308 t": "a finite number",
    "vehicle.drag_scale=-0.0": "greater than zero",
    "vehicle.nose_radius=-1ft": "greater than zero",
    "vehicle.aerodynamics.drag_coefficient=0": "greater than zero",
    "planet.density_scale=-5 %": "greater than zero",
    "planet.radius=0": "greater than zero",
    STATE + "altitude=-1": "altitude is -1 m: it must be zero or more",
    STATE + "altitude=-10000km": "zero or more",
    STATE + "latitude=91deg": "between -90 and 90 deg",
    STATE + "latitude=-90.1deg": "between -90 and 90 deg",
    STATE + "flight_path_angle=91deg": "between -90 and 90 deg",
    STATE + "flight_path_angle=-1.6": "between -90 and 90 deg",
    STATE + "heading=361deg": "between -360 and 360 deg",
    STATE + "longitude=-400deg": "between -360 and 360 deg",
    STATE + "velocity=0": "greater than zero",
    STATE + "velocity=-6750": "greater than zero",
    "guidance.bank_angle=7 rad": "between -360 and 360 deg",
    "termination.conditions.velocity.velocity=-503": "greater than zero",
}

UNIFORM = {
    "address": '"vehicle.mass"',
    "distribution": '"uniform"',
    "lower": "900",
    "upper": "1000",
}


def dispersion(name="x", **changes):
    """A table of one, in which something is wrong."""
    entries = {k: v for k, v in (UNIFORM | changes).items() if v is not None}
    lines = [f"{key} = {value}" for key, value in entries.items()]
    return "\n".join([f'[dispersions."{name}"]', *lines, ""])


def normal(mean, width, **changes):
    numbers = {"mean": mean, "standard_deviation": width, "lower": None, "upper": None}
    return dispersion(distribution='"normal"', **(numbers | changes))


CONFIG = {
    "law = ": "no valid TOML",
    "[set]\n[set]": "no valid TOML",
    "set = " + "[" * 5000: "nested too deep",
    "set." + ".".join("a" * 5000) + " = 1": "nested too deep",
    "set.a = " + "9" * 5000: "no valid TOML",
    "lwa = 'a'": "nearest: law",
    "[sets]": "unknown key 'sets'",
    "law = 3": "law is 3: it must be a name",
    "law = ''": "no law ''",
    "law = 'left'": "no law 'left'",
    "law = ['right']": "it must be a name",
    "[law]\nname = 'right'": "it must be a name",
    "dispersions = 3": "dispersions is 3",
    "dispersions = []": "it must be a name",
    "[dispersions]": "[dispersions] is empty",
    "set = 3": "write a table, [set]",
    "set = []": "write a table, [set]",
    "[set]\nvehicle.mass = true": "vehicle.mass is True: it must be a number",
    "[set]\nvehicle.mass = 1979-05-27": "it must be a number",
    "[set]\nvehicle.mass = 'much'": "'much' is not a number",
    "[set]\nvehicle.mass = '900 km'": "[length]",
    "[set]\nvehicle.mass = nan": "vehicle.mass is nan",
    "[set]\nvehicle.mass = 1" + "0" * 400: "vehicle.mass: ",
    "[set]\nvehicle.mass = [900]": "vehicle.mass has shape ()",
    "[set]\nvehicle.mass = []": "vehicle.mass has shape ()",
    "[set]\nvehicle = 900": "no leaf 'vehicle'",
    "[set]\nvehicle.mass = 9\n'vehicle.mass' = 9": "vehicle.mass is given twice",
    "[set]\ninitial_state.latitude = 12": "did you mean 12deg?",
    "[set]\ninitial_state.heading = ['5', [1, 2]]": "rows of unequal length",
    "[dispersions]\nx = 3": "write a table, [dispersions.x]",
    dispersion(distribution=None): "dispersions.x.distribution is None",
    dispersion(distribution='"unifrom"'): "choose from normal, uniform",
    dispersion(upper=None): "[dispersions.x] lacks upper",
    dispersion(uper=3): "nearest: upper",
    dispersion(upper='"much"'): "dispersions.x.upper: 'much' is not a number",
    dispersion(upper='"1 km"'): "dispersions.x.upper: '1 km' is [length]",
    dispersion(upper="true"): "dispersions.x.upper is True",
    dispersion(address=None): "lacks address",
    dispersion(address="[]"): "dispersions.x.address is []",
    dispersion(address="3"): "dispersions.x.address is 3",
    dispersion(address='"vehicle"'): "no leaf 'vehicle'",
    dispersion(address='"vehicle.mas"'): "nearest: vehicle.mass",
    dispersion(apply='"plus"'): "apply is 'plus'",
    dispersion(apply='"multiply"', upper='"1 kg"'): "a plain number",
    dispersion(address='["vehicle.mass", "vehicle.drag_scale"]'): "different units",
    dispersion(address='"initial_state.heading"', lower="89"): "did you mean 89deg?",
}
"""By what is written: these are refused by every command that reads a configuration."""

ALONE = "[dispersions]\nreplace = true\n"

DISPERSED = {
    dispersion(lower="1000", upper="900"): "lower is 1000: it must be below upper",
    dispersion(lower="900", upper="900"): "it must be below upper",
    dispersion(upper="inf"): "dispersions.x.upper is inf",
    normal("1000", "0"): "standard_deviation is 0",
    normal("1000", "-5"): "standard_deviation is -5",
    normal("nan", "5"): "dispersions.x.mean is nan",
    normal("1", "0.1", lower="4.9", upper="5").replace(
        "normal", "truncated_normal"
    ): "dispersions.x.mean is 39 standard deviations",
    dispersion(
        address='["vehicle.mass", "vehicle.mass"]'
    ): "reaches vehicle.mass twice",
    normal("1", "0.1", address='"planet.rotation_rate"', apply='"multiply"'): (
        "a factor on planet.rotation_rate, which is zero"
    ),
    normal("1", "0.1", address='"vehicle.trim_angle_of_attack"'): "has no effect",
    normal("1", "0.1", address='"planet.atmosphere.gas_constant"'): "has no effect",
    dispersion("a") + dispersion("b"): "'b' replaces vehicle.mass",
    dispersion("plumless") + dispersion("buckeroo", apply='"add"'): "CRC-32",
}

INPUTS = {
    b"": "empty; expected a line with the names of the columns",
    b"vehicle.mass\n\n": "0 rows of numbers below",
    b"\xff\xfe": "decode",
    b"vehicle.mass\nheavy\n": "heavy",
    b"vehicle.mass\n900 kg\n": "900 kg",
    b"vehicle.mas\n900\n": "nearest: vehicle.mass",
    b"vehicle.mass,vehicle.mass\n900,900\n": "'vehicle.mass' appears more than once",
    b"vehicle.mass,planet.density_scale\n900\n": "line 2: 1 values; expected 2",
    b"vehicle.mass\n0\n": "vehicle.mass is 0 kg",
    b"vehicle.mass\nnan\n": "line 2: vehicle.mass is 'nan'; expected a finite",
    b"initial_state.latitude\n91\n": "initial_state.latitude is 91 rad",
    b"initial_state.flight_path_angle\n-14.2\n": "did you mean -14.2deg?",
    b"initial_state.altitude\n-1\n": "zero or more",
}

FLIGHT = {
    "--step 0": "step is 0.0 s: it must be positive",
    "--step -1": "step is -1.0 s",
    "--step nan": "step is nan s",
    "--step inf": "step is inf s: it must be positive and finite",
    "--step 1e-320": "step is 1e-320 s",
    "--step 1e-9": "more than 1e+09 steps",
    "--history 0": "history is 0.0 s: the interval must be positive",
    "--history -1": "history is -1.0 s",
    "--history nan": "history is nan s",
    "--history inf": "history is inf s",
    "--history 1e-9": "history is 1e-09 s: of a flight of 300 s",
}

CAMPAIGN = {
    "--runs 0": "no runs to fly",
    "--runs -2": "runs is -2",
    "--runs 4294967297": "2^32 - 1",
    "--runs 1000000000000000000000000": "runs is 1000000000000000000000000",
    "--runs many": "--runs",
    "--runs 1.5": "--runs",
    "--seed 9223372036854775808": "the seed is 9223372036854775808",
    "--seed 18446744073709551616": "the seed is 18446744073709551616",
    "--seed -9223372036854775809": "the seed is -9223372036854775809",
    "--seed 1e3": "--seed",
    "--dispersions none": "choose from all, mass-only",
    "--inputs nowhere.csv": "nowhere.csv",
    "--workers two": "--workers",
    "--figure": "--figure",
}

TUNE = {
    "--loss least": "loss is 'least'",
    "--optimizer newton": "optimizer is 'newton'",
    "--optimizer=": "optimizer is ''",
    "--set planet.density_scale=1.1": "every run draws it anew by the dispersion",
    "--gains guidance.bank": "no leaf 'guidance.bank'",
    "--gains=": "no leaf ''",
    "--gains vehicle.mass": "the dispersion 'mass' moves it",
    "--of range=1km": "no miss or path constraint 'range'",
    "--of altitude=-1km": "the scale must be greater than zero",
    "--of altitude=inf": "the scale must be greater than zero",
    "--of altitude=5kg": "a number in m",
    "--of altitude=5km --of altitude=6km": "altitude is given twice",
    "--of velocity": "write velocity=SCALE",
    "--of heading=50": "did you mean 50deg?",
    "--bounds guidance.bank_angle=1": "write ADDRESS=LOW:HIGH",
    "--bounds guidance.bank_angle=2:3": "on both sides of its value",
    "--bounds guidance.bank_angle=1km:2km": "a number in rad",
    "--bounds guidance.bank_angle=10:90": "did you mean 10deg?",
    "--bounds guidance.bank=0:1": "no leaf 'guidance.bank'",
    "--bounds vehicle.mass=1:a": "'a' is not a number",
    "--smooth": "AbstractSwitching",
    "--runs 1": "runs is 1",
    "--steps 0": "steps is 0",
    "--held-out 1": "held_out is 1",
    "--patience 0": "patience is 0",
    "--learning-rate 0": "--learning-rate is 0.0",
    "--learning-rate nan": "--learning-rate is nan",
    "--seed 9223372036854775808": "the seed is 9223372036854775808",
    "--step inf": "step is inf s",
}

OTHERS = {
    "": "Usage",
    "flie cheap": "flie",
    "list chaep": "no mission 'chaep'",
    "show": "Missing argument",
    "fly": "Missing argument",
    "show cheap mars": "mars",
    "show cheap --laws right": "--laws",
    "show cheap --config nowhere.toml": "nowhere.toml",
    "show cheap --config .": "directory",
    "fly cheap --step one": "--step",
    "show cheap --set vehicle.mass=1 --set vehicle.mass=2": "vehicle.mass is given twice",
    "train mars-drag-tracking": "no networks to train: see mars-range-tracking, cav-h",
    "train cav-h --flights 3": "--flights is 3",
    "train cav-h --again 99": "--again is 99",
    "train cav-h --iterations 0": "--iterations is 0",
    "train cav-h --seed 9223372036854775808": "the seed is 9223372036854775808",
    "sensitivity cheap --scale 0": "scale is 0: it must be greater than zero",
    "sensitivity cheap --scale 1 --scale -1": "scale is -1",
    "sensitivity cheap --scale inf": "scale is inf",
    "sensitivity cheap --scale nan": "scale is nan",
    "sensitivity cheap --wrt vehicle.mas": "nearest: vehicle.mass",
    "sensitivity cheap --wrt=": "no leaf ''",
    "sensitivity cheap --seed 9223372036854775808": "the seed is",
    "sensitivity cheap --runs 1": "runs is 1",
}
for _name in ("show", "fly", "monte-carlo", "tune", "train", "sensitivity"):
    OTHERS[f"{_name} chaep"] = "no mission 'chaep'; nearest"
    OTHERS[f"{_name} mars\n"] = "no mission"
for _name in ("show", "fly", "monte-carlo", "tune", "sensitivity"):
    OTHERS[f"{_name} cheap --law left"] = "no law 'left': choose from right"
    OTHERS[f"{_name} cheap --law="] = "no law ''"
for _name in ("monte-carlo", "tune", "sensitivity"):
    OTHERS[f"{_name} cheap --dispersions="] = "no dispersions ''"

COMMANDS = (
    [(["show", "cheap", f"--set={text}"], {}, word) for text, word in SET.items()]
    + [
        (["show", "cheap", "--config", "x.toml"], {"x.toml": text}, word)
        for text, word in CONFIG.items()
    ]
    + [
        (["monte-carlo", "cheap", "--config", "x.toml"], {"x.toml": ALONE + text}, word)
        for text, word in DISPERSED.items()
    ]
    + [
        (["monte-carlo", "cheap", "--inputs", "x.csv"], {"x.csv": text}, word)
        for text, word in INPUTS.items()
    ]
    + [
        ([command, "cheap", *words.split()], {}, word)
        for command in ("fly", "monte-carlo")
        for words, word in FLIGHT.items()
    ]
    + [
        (["monte-carlo", "cheap", *words.split()], {}, w)
        for words, w in CAMPAIGN.items()
    ]
    + [
        (["tune", "cheap", "--gains", "guidance.bank_angle", *words.split()], {}, word)
        for words, word in TUNE.items()
        if "--gains" not in words
    ]
    + [
        (["tune", "cheap", *words.split()], {}, word)
        for words, word in TUNE.items()
        if "--gains" in words
    ]
    + [(words.split(" ") if words else [], {}, word) for words, word in OTHERS.items()]
)
GIVEN = {"x.csv": b"vehicle.mass\n900\n950\n"}
COMMANDS += [
    (["monte-carlo", "cheap", "--inputs", "x.csv", *words.split()], GIVEN | more, word)
    for words, more, word in (
        ("--runs 3", {}, "--runs is 3, and x.csv has 2"),
        ("--runs 0", {}, "no runs to fly"),
        ("--dispersions all", {}, "--inputs takes the place of dispersions"),
        ("--dispersions=", {}, "--inputs takes the place"),
        ("--config x.toml", {"x.toml": dispersion()}, "--inputs takes the place"),
        ("--config x.toml", {"x.toml": "dispersions = 'all'"}, "--inputs takes the pl"),
    )
]


def shown(words):
    """Of a long text the beginning."""
    return " ".join(words)[:60]


@pytest.mark.parametrize(
    ("words", "files", "word"),
    COMMANDS,
    ids=[
        f"{shown(words)} {' '.join(map(str, f.values()))[:30]!r}"
        for words, f, _ in COMMANDS
    ],
)
def test_a_command_refuses(command, tmp_path, words, files, word):
    for name, contents in files.items():
        contents = contents.encode() if isinstance(contents, str) else contents
        (tmp_path / name).write_bytes(contents)
    code, printed, said = command(*words)
    assert code == 2, said
    assert word in said + printed * (not words)
    assert "Traceback" not in said
    if not said.startswith("Usage") and words:
        assert said.startswith("jentry: ") and not printed
    assert {path.name for path in tmp_path.rglob("*")} == set(files)


def test_there_are_more_than_150():
    assert len(COMMANDS) + len(CALLS) > 250


FOLDERS = {
    "a file for a folder": ("file", 3, "file is a file: give a folder"),
    "a folder in a file": ("file/out", 4, "Not a directory"),
}


@pytest.mark.parametrize(("out", "code", "word"), FOLDERS.values(), ids=FOLDERS)
def test_a_place_that_cannot_be_written_to(command, tmp_path, out, code, word):
    (tmp_path / "file").write_text("mine")
    result = command("monte-carlo", "cheap", "--runs", 2, "--out", out)
    assert result[0] == code and word in result[2]
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"


# From Python.


def with_leaf(where, value):
    return eqx.tree_at(where, cheap.scenario(), jax.numpy.asarray(value, dtype=float))


def fly_with(where, value):
    return lambda: fly(with_leaf(where, value), cheap.SOLVER)


def campaign(dispersions=None, key=0, runs=2, **options):
    key = None if key is None else jax.random.key(key)
    return lambda: jentry.monte_carlo(
        cheap.scenario(), dispersions, key, runs, **options
    )


def moved(where, distribution=None, apply=jentry.campaign.add):
    distribution = distribution or jentry.Uniform(0.9, 1.1)
    return campaign({"x": jentry.Dispersion(where, distribution, apply)})


def by_mass(distribution):
    return moved(lambda s: s.vehicle.mass, distribution)


INCREASING = [0.0, 2.0, 1.0]

CALLS = {
    "mission": (lambda: jentry.find_mission("mars"), "no mission 'mars'"),
    "law": (lambda: cheap.MISSION.scenario(""), "no law ''"),
    "reading": (lambda: cheap.MISSION.dispersion_table("x"), "no dispersions 'x'"),
    "workers": (lambda: jentry.setup(workers=0), "workers is 0"),
    "seed": (lambda: key_of(2**64), "the seed is 18446744073709551616"),
    "no quantity": (lambda: parse_quantity("x", "m"), "'x' is not a number"),
    "step 0": (lambda: FixedStep(0.0), "step is 0.0 s"),
    "step nan": (lambda: FixedStep(math.nan), "step is nan s"),
    "step inf": (lambda: FixedStep(math.inf), "step is inf s"),
    "short step": (lambda: fly(cheap.scenario(), FixedStep(1e-320)), "1e-320"),
    "history 0": (lambda: fly(cheap.scenario(), cheap.SOLVER, 0.0), "history is 0.0"),
    "history inf": (
        lambda: fly(cheap.scenario(), cheap.SOLVER, math.inf),
        "history is",
    ),
    "long history": (lambda: fly(cheap.scenario(), cheap.SOLVER, 1e-9), "1e-09"),
    "tolerance 0": (lambda: Adaptive(0.0), "tolerance is 0.0"),
    "tolerance nan": (lambda: Adaptive(math.nan), "tolerance is nan"),
    "no steps": (lambda: Adaptive(max_steps=0), "max_steps is 0"),
    "time limit 0": (lambda: Termination({}, 0.0), "time_limit is 0.0"),
    "time limit inf": (lambda: Termination({}, math.inf), "time_limit is inf"),
    "time limit nan": (lambda: Termination({}, math.nan), "time_limit is nan"),
    "mass 0": (fly_with(lambda s: s.vehicle.mass, 0.0), "vehicle.mass is 0 kg"),
    "mass nan": (fly_with(lambda s: s.vehicle.mass, np.nan), "vehicle.mass is nan"),
    "below ground": (fly_with(lambda s: s.initial_state.altitude, -1.0), "altitude"),
    "latitude": (fly_with(lambda s: s.initial_state.latitude, 1.6), "latitude is 1.6"),
    "path": (
        fly_with(lambda s: s.initial_state.flight_path_angle, -14.2),
        "did you mean -14.2deg",
    ),
    "heading": (fly_with(lambda s: s.initial_state.heading, 90.0), "mean 90deg"),
    "bank": (fly_with(lambda s: s.guidance.bank_angle, 50.0), "mean 50deg"),
    "nothing dispersed": (campaign(), "nothing is dispersed"),
    "no dispersions": (campaign({}), "nothing is dispersed"),
    "no key": (campaign(cheap.mass_only(), None), "need a key"),
    "both": (campaign(cheap.mass_only(), inputs={"vehicle.mass": [1.0]}), "not both"),
    "no runs": (campaign(cheap.mass_only(), runs=0), "no runs to fly"),
    "no indices": (campaign(cheap.mass_only(), runs=[]), "no runs to fly"),
    "half a run": (campaign(cheap.mass_only(), runs=np.array(1.5)), "runs is 1.5"),
    "run -1": (campaign(cheap.mass_only(), runs=[-1]), "run -1 was asked for"),
    "run 2^32": (campaign(cheap.mass_only(), runs=[2**32]), "run 4294967296"),
    "no inputs": (campaign(inputs={}), "the inputs are empty"),
    "inputs of two lengths": (
        campaign(inputs={"vehicle.mass": [1.0], "planet.density_scale": [1.0, 1.0]}),
        "unequal length",
    ),
    "input of a table": (
        campaign(inputs={"vehicle.mass": [[1.0]]}),
        "one number a run",
    ),
    "input of no leaf": (campaign(inputs={"vehicle.mas": [1.0]}), "nearest"),
    "input out of range": (
        campaign(inputs={"initial_state.latitude": [0.0, 45.0]}),
        "did you mean 45deg",
    ),
    "fewer inputs than runs": (
        campaign(inputs={"vehicle.mass": [900.0]}, runs=2),
        "run 1 was asked for, of 1 given",
    ),
    "step of a campaign": (
        campaign(cheap.mass_only(), solver=FixedStep(1e-320)),
        "1e-320",
    ),
    "history of a campaign": (campaign(cheap.mass_only(), history=-1.0), "history is"),
    "a whole module": (moved(lambda s: s.vehicle), "a whole Vehicle"),
    "no such field": (moved(lambda s: s.vehicle.mas), "dispersion 'x'"),
    "what is no leaf": (moved(lambda s: s.termination.names), "reaches no leaf"),
    "one leaf twice": (moved(lambda s: (s.vehicle.mass,) * 2), "vehicle.mass twice"),
    "two units": (
        moved(lambda s: (s.vehicle.mass, s.planet.radius)),
        "different units",
    ),
    "no effect": (moved(lambda s: s.planet.atmosphere.gas_constant), "no effect"),
    "factor on zero": (
        moved(lambda s: s.planet.rotation_rate, apply=jentry.campaign.multiply),
        "which is zero",
    ),
    "normal without width": (
        by_mass(jentry.Normal(1.0, 0.0)),
        "standard_deviation is 0",
    ),
    "bounds": (by_mass(jentry.Uniform(2.0, 1.0)), "lower is 2"),
    "far bounds": (
        by_mass(jentry.TruncatedNormal(0.0, 1.0, 40.0, 50.0)),
        "is 40 stand",
    ),
    "no campaign": (lambda: jentry.open_campaign("nowhere"), "holds no campaign"),
    "seed of a stored campaign": (
        lambda: cheap.campaign("stored", 2, seed=2**64),
        "the seed is 18446744073709551616",
    ),
    "history of a stored campaign": (
        lambda: cheap.campaign("stored", 2, history=1e-9),
        "history is 1e-09",
    ),
    "end without velocity": (
        lambda: fly(
            dataclasses.replace(
                cheap.scenario(),
                termination=Termination({"slow": VelocityBelow(0.0)}, 300.0),
            )
        ),
        "termination.conditions.slow.velocity is 0 m/s",
    ),
    "altitudes of an atmosphere": (
        lambda: TabulatedAtmosphere(INCREASING, [1.0, 1.0, 1.0]),
        "altitudes",
    ),
    "altitudes of a wind": (
        lambda: TabulatedWind(INCREASING, [0.0] * 3, [0.0] * 3),
        "altitudes",
    ),
    "altitudes put in later": (
        lambda: fly(
            eqx.tree_at(
                lambda s: s.planet.wind.altitudes,
                eqx.tree_at(
                    lambda s: s.planet.wind,
                    cheap.scenario(),
                    TabulatedWind([0.0, 1.0, 2.0], [0.0] * 3, [0.0] * 3),
                ),
                jax.numpy.asarray(INCREASING),
            )
        ),
        "planet.wind.altitudes must increase",
    ),
}


@pytest.mark.parametrize(("call", "word"), CALLS.values(), ids=CALLS)
def test_a_call_refuses(call, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, jentry.CampaignError)) as raised:
        call()
    assert word in str(raised.value)
    assert not list(tmp_path.iterdir())


# Values on the edge of a range are taken.

TAKEN = [
    "initial_state.latitude=90deg",
    "initial_state.latitude=-90deg",
    "initial_state.flight_path_angle=-90deg",
    "initial_state.heading=360deg",
    "initial_state.heading=-360deg",
    "initial_state.longitude=6.2831",
    "initial_state.altitude=0",
    "initial_state.altitude=126.1 km",
    "initial_state.velocity=15e3 mph",
    "planet.rotation_rate=-15 deg/h",
    "target.altitude=-3 km",
    "vehicle.lift_scale=-5 %",
]


@pytest.mark.parametrize("text", TAKEN)
def test_what_can_be_flown_is_taken(command, text):
    text = text.replace("mph", "mi/h")
    code, printed, said = command("show", "cheap", f"--set={text}")
    assert (code, said) == (0, "")
    assert text.partition("=")[0] in printed


def test_what_is_allowed_is_shown(command):
    printed = command("show", "cheap")[1].splitlines()
    for address, words in (
        ("vehicle.mass", "greater than zero"),
        ("initial_state.latitude", "between -90 and 90 deg"),
        ("initial_state.altitude", "zero or more"),
    ):
        assert any(address in line and words in line for line in printed)


# Texts that nobody wrote: taken, or refused in words.

ADDRESSES = sorted(leaves_by_address(cheap.scenario()))
UNITS = ["", " ", "km", "deg", "%", "m/s2", "kg^0.5/m", "1/", "**", "(", ")", "9", "K"]

some_address = st.sampled_from(ADDRESSES) | st.text(max_size=8)
some_number = (
    st.floats().map(repr)
    | st.integers().map(str)
    | st.sampled_from(["1e", ".", "-", "0x1", "1_0", "١", "1e-400", "nan", "+.5"])
)
some_unit = st.lists(st.sampled_from(UNITS) | st.text(max_size=2), max_size=4)
some_quantity = st.tuples(some_number, some_unit.map("".join)).map("".join)
some_assignment = st.text() | st.tuples(some_address, some_quantity).map("=".join)

ours = hypothesis.settings(
    derandomize=True,  # the same texts in every run, so that a failure is a change
    database=None,
    deadline=None,
    max_examples=150,
    suppress_health_check=list(hypothesis.HealthCheck),
)


@pytest.fixture(scope="module")
def mission():
    """Among those that a command knows."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(ALL, "cheap", cheap.MISSION)
        yield "cheap"


def taken_or_refused(act) -> None:
    """As the command does it: a `ValueError` is a line of words, all else a traceback."""
    try:
        act()
    except ValueError as error:
        assert str(error)


@pytest.mark.slow
@ours
@hypothesis.given(st.lists(some_assignment, max_size=2))
@hypothesis.example(["vehicle.mass=1" + "0" * 400])
@hypothesis.example(["vehicle.mass=" + "(" * 50])
@hypothesis.example(["vehicle.mass=1 " + "(" * 50 + "m"])
@hypothesis.example(["vehicle.mass=1 kg**9999999"])
@hypothesis.example(["vehicle.mass=1 \ud800"])
def test_no_assignment_ends_in_a_traceback(mission, texts):
    def act():
        _, scenario, _ = chosen_scenario(mission, (), None, texts)
        values = {a: np.asarray(x) for a, x in leaves_by_address(scenario).items()}
        assert all(np.all(np.isfinite(value)) for value in values.values())
        assert values["vehicle.mass"] > 0.0
        assert abs(values["initial_state.latitude"]) <= 90.001 * degree

    taken_or_refused(act)


some_value = st.recursive(
    st.integers() | st.booleans() | st.floats() | st.text(max_size=8) | some_quantity,
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)
some_key = st.sampled_from(
    [
        "law",
        "case",
        "world",
        "set",
        "dispersions",
        "address",
        "distribution",
        "mean",
        "apply",
    ]
    + ["standard_deviation", "lower", "upper", *ADDRESSES[:20]]
) | st.text(max_size=5)
some_word = st.sampled_from(
    ["normal", "uniform", "truncated_normal", "multiply", "add", "right", "all"]
    + ADDRESSES[:20]
)


def toml(value):
    """A value as TOML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        escaped = (
            f"\\U{ord(c):08x}" if c in '\\"' or ord(c) < 32 else c for c in value
        )
        return '"' + "".join(escaped) + '"'
    return repr(value)


some_line = (
    st.tuples(some_key, some_word | some_value).map(
        lambda pair: f"{toml(pair[0])} = {toml(pair[1])}"
    )
    | st.sampled_from(["[set]", "[dispersions.x]", "[dispersions]", "[world]"])
    | st.just("[dispersions.y]\naddress = 'vehicle.mass'\ndistribution = 'normal'")
    | st.text(max_size=12)
)
some_file = st.lists(some_line, max_size=8).map("\n".join) | st.text() | st.binary()


@ours
@hypothesis.given(some_file)
@hypothesis.example("a = " + "{b = " * 2000)
@hypothesis.example("[" + "a." * 3000 + "a]")
@hypothesis.example(normal("1e308", "1e308"))
@hypothesis.example(normal("1", "1e-320"))
@hypothesis.example(dispersion(lower="-1e308", upper="1e308"))
def test_no_file_ends_in_a_traceback(mission, tmp_path_factory, contents):
    path = tmp_path_factory.getbasetemp() / "some.toml"
    if isinstance(contents, str):
        contents = contents.encode(errors="surrogatepass")
    path.write_bytes(contents)

    def act():
        chosen, scenario, overrides = chosen_scenario(mission, (), path, None)
        _, table = dispersion_table(chosen, overrides, None)
        check_dispersions(scenario, table)

    taken_or_refused(act)


@ours
@hypothesis.given(
    st.sampled_from(ADDRESSES), st.floats(1e-3, 1e3), st.sampled_from("kMmμ")
)
def test_a_prefix_is_a_power_of_ten_for_every_leaf(address, number, prefix):
    """Whatever leaf it is given for, if its unit begins with one that takes a prefix."""
    unit = unit_of(cheap.scenario(), address)
    if unit[0] not in "mJPWK" or unit.startswith("kg"):
        return
    powers = {"k": 1e3, "M": 1e6, "m": 1e-3, "μ": 1e-6}
    first = unit.split("/")[0]
    power = int(first[-1]) if first[-1].isdigit() else 1
    expected = number * powers[prefix] ** power
    # The power, the factor and the product each round.
    assert parse_quantity(f"{number!r} {prefix}{unit}", unit) == pytest.approx(
        expected, rel=1e-14, abs=0.0
    )


# A process of its own: what is printed where nobody reads, and Ctrl-C.

ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONUTF8"}


def process(*words, shell="", **environment):
    command = f'"{sys.executable}" -W error -m jentry {" ".join(words)} {shell}'
    return subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        capture_output=True,
        text=True,
        env=ENVIRONMENT | environment,
    )


def test_help_names_its_tables_and_imports_no_array():
    run = process("show", "--help", COLUMNS="200")
    assert run.returncode == 0 and run.stderr == ""
    assert "[set]" in run.stdout and "[dispersions]" in run.stdout


@pytest.mark.parametrize("shell", ["| true", ">&-", "2>&- >&-"])
def test_an_output_that_nobody_reads(shell):
    run = process("show", "--help", shell=shell)
    assert run.returncode in (0, 1)
    assert run.stderr == ""


def test_an_output_that_cannot_be_written():
    run = process("show", "--help", shell="> /dev/full")
    assert run.returncode == 4
    assert run.stderr.startswith("jentry: ") and run.stderr.count("\n") == 1


def test_a_terminal_without_accents():
    run = process("list", LC_ALL="POSIX", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    assert (run.returncode, run.stderr) == (0, "")
    assert "cav-h" in run.stdout and "\\xe9" in run.stdout


_INTERRUPTED = """
import os, signal, sys
class OnImport:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, OnImport())
sys.argv = ["jentry", "fly", "mars"]
from jentry.cli import main
main()
"""


@pytest.mark.parametrize("module", ["typer", "numpy", "jax._src.api", "diffrax"])
def test_ctrl_c_while_importing(module):
    run = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED.format(module=module)],
        capture_output=True,
        text=True,
        cwd=Path(jentry.__file__).parent.parent,
    )
    assert (run.returncode, run.stderr) == (130, "jentry: interrupted\n")


def test_an_interruption_that_was_lost_ends_the_campaign_after_its_block(
    command, tmp_path, monkeypatch
):
    """As when Ctrl-C meets a callback of JAX, from which Python passes nothing on."""
    stored = []

    def losing(out, scenario, dispersions, seed, runs, *, report, **options):
        for done in range(1, 4):
            try:
                if done == 2:
                    signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                pass
            stored.append(done)
            report(done)

    monkeypatch.setattr("jentry.campaign.store.run_campaign", losing)
    code, _, said = command("monte-carlo", "cheap", "--runs", 3)
    assert (code, said) == (130, "jentry: interrupted; the same command resumes\n")
    assert stored == [1, 2]


def test_an_interruption_that_became_another_error(command, monkeypatch):
    def converting(*given, **options):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise RuntimeError("INTERNAL: CpuCallback error") from error

    monkeypatch.setattr("jentry.campaign.store.run_campaign", converting)
    code, _, said = command("monte-carlo", "cheap", "--runs", 3)
    assert (code, said) == (130, "jentry: interrupted; the same command resumes\n")


def test_the_handler_of_ctrl_c_is_given_back(command):
    before = signal.getsignal(signal.SIGINT), sys.unraisablehook
    command("monte-carlo", "cheap", "--runs", 0)
    assert (signal.getsignal(signal.SIGINT), sys.unraisablehook) == before
