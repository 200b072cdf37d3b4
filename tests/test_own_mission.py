"""A mission of a user's own: a file or a package, through the public names alone."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import own_mission
import pytest
import xarray
from helpers import fly_compiled
from pages import README, ROOT

import jentry
from jentry.addresses import leaves_by_address
from jentry.planning.flight_problem import AtEnd, FlightProblem, FreeControl


LANDER = ROOT.joinpath("tests", "lander.py").read_text()
HERE = Path(__file__).parent

OWN = HERE / "own_mission.py"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A copy of the two files in a folder of its own, which the imports of others miss."""
    for name in ("own_law.py", "own_mission.py"):
        # Other names: those of this folder are imported here.
        text = (HERE / name).read_text().replace("own_law", "copied_law")
        (tmp_path / name.replace("own", "copied")).write_text(text)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    sys.modules.pop("copied_law", None)


@pytest.mark.slow
def test_its_law_commands_both_angles_and_its_attitude_lags(command, tmp_path):
    out = tmp_path / "flight.nc"
    words = ("--step", 1, "--history", 10, "--out", out)
    code, printed, said = command("fly", OWN, *words)
    assert (code, said) == (0, "")
    assert "own: reached the end of guided flight (velocity)" in printed
    flight = fly_compiled(own_mission.scenario(), jentry.FixedStep(1.0))
    with xarray.open_dataset(out, engine="h5netcdf") as flown:
        # Compiled apart.
        assert flown["end_time"].item() == pytest.approx(flight.time.item(), rel=1e-10)
        described = json.loads(flown.attrs["campaign"])
        velocity = flown["velocity"].values[0, :10]
        heading = flown["heading"].values[0, :10]
        bank = flown["commanded_bank_angle"].values[0, :10]
        angle = flown["commanded_angle_of_attack"].values[0, :10]
        lag = flown["bank_angle"].values[0, :10] - bank
    # As the law says; the arc cosine of a cosine, of 42 degrees at most.
    wish = np.radians(60.0) * np.tanh(5.0 * (np.radians(100.0) - heading))
    assert bank == pytest.approx(wish, rel=1e-9)
    assert angle == pytest.approx(np.radians(5.0 + 2e-3 * velocity), rel=1e-9)
    # The command falls and the bank comes after it: at first at rest on it, then later
    # by 2 damping / frequency = 2.25 s of its change.
    assert lag[0] == 0.0
    later = -2.25 * np.gradient(bank, 10.0)
    assert lag[3:9] == pytest.approx(later[3:9], rel=0.1)
    assert described["mission"] == "own"
    assert described["code"] == {
        name: hashlib.sha256((HERE / name).read_bytes()).hexdigest()
        for name in ("own_law.py", "own_mission.py")
    }


@pytest.mark.slow
def test_it_is_flown_many_times_and_drawn(command, tmp_path):
    words = ("monte-carlo", OWN, "--step", 1, "--runs", 3)
    code, printed, said = command(*words)
    assert (code, said) == (0, "")
    assert "3 of 3 runs reached" in printed and "dispersions: all" in printed
    assert (tmp_path / "results" / "own" / "figures" / "overview.png").exists()
    results = jentry.open_campaign(tmp_path / "results" / "own")
    limits = results["attitude.bank_response.rate_limit"].values
    assert np.all((limits > np.radians(5.0)) & (limits < np.radians(10.0)))
    assert command(*words, "--no-figures")[0] == 0


def test_it_is_listed_and_shown(command):
    code, printed, _ = command("list", OWN)
    assert code == 0
    assert (
        printed == "own: Glide and turn\n  laws\n    lagging\n  dispersions\n    all\n"
    )
    code, printed, _ = command("show", OWN)
    assert code == 0 and "guidance.angle_at_rest" in printed
    rate = [line for line in printed.splitlines() if "rate_limit" in line][-1]
    assert "│ rate " in rate and "uniform, lower 0.5, upper 1" in rate
    assert "a factor on" in rate
    idle = printed[printed.index("without effect") :]
    assert "planet.atmosphere.gas_constant" in idle
    assert "vehicle.trim_angle_of_attack" in idle.split("dispersions:")[0]
    assert "guidance.slope" not in idle.split("dispersions:")[0]


@pytest.mark.slow
def test_changed_code_does_not_resume(command, folder):
    words = ("monte-carlo", "copied_mission.py", "--step", 1, "--no-figures")
    assert command(*words, "--runs", 1)[0] == 0
    assert command(*words, "--runs", 2)[0] == 0
    law = folder / "copied_law.py"
    law.write_text(law.read_text().replace("+ self.slope", "+ 1.01 * self.slope"))
    code, _, said = command(*words, "--runs", 2)
    assert code == 3 and "code.copied_law.py" in said and "differs" in said
    # And is what is flown, in this process too.
    before = jentry.open_campaign(folder / "results" / "own")
    assert command(*words, "--runs", 2, "--out", "changed")[0] == 0
    after = jentry.open_campaign(folder / "changed")
    assert not np.any(after["end_time"].values == before["end_time"].values)


def test_the_same_file_is_the_same_mission(folder):
    first = jentry.find_mission(folder / "copied_mission.py")
    assert jentry.find_mission(str(folder / "copied_mission.py")) is first
    assert set(first.code) == {"copied_law.py", "copied_mission.py"}


MINIMAL = """
import jentry

def scenario():
    import own_mission
    return own_mission.scenario()

MISSION = jentry.Mission(name="minimal", title="", laws={"one": scenario})
"""

WRONG = {
    "no mission": ("import jentry", "defines no MISSION: end it with MISSION ="),
    "another thing": ("MISSION = 3", "is a int: it must be a Mission"),
    "syntax": ("x = 1\ny = = 2", "wrong.py, line 2: SyntaxError: invalid syntax"),
    "import": ("x = 1\n\nimport nowhere", "wrong.py, line 3: ModuleNotFoundError: No"),
    "value": (
        "import jentry\njentry.FixedStep(\n    -1.0\n)",
        "wrong.py, line 2: step is -1.0 s: it must be positive",
    ),
    "exit": ("import sys\nsys.exit(0)", "wrong.py, line 2: SystemExit: 0"),
    "name of ours": (
        MINIMAL.replace("minimal", "cav-h"),
        "named 'cav-h', which is also the name of the mission cav-h of jentry",
    ),
    "name no name": (MINIMAL.replace("minimal", "a/b"), "name of a mission is 'a/b'"),
    "no laws": (
        MINIMAL.replace('{"one": scenario}', "{}"),
        "has laws {}: they must be functions by name",
    ),
    "builder fails": (
        MINIMAL.replace("return", "1 / 0\n    return"),
        "wrong.py, line 6: ZeroDivisionError: division by zero",
    ),
    "builder gives another": (
        MINIMAL.replace("return", "return 3 #"),
        "a law of mission minimal makes a int: it must be a function that returns",
    ),
    "another file of the name": (
        "import tomllib",
        f"wrong.py imports tomllib, which is both .*tomllib.py and {os.sep}",
    ),
}


@pytest.mark.parametrize(("contents", "message"), WRONG.values(), ids=WRONG)
def test_wrong_files_are_refused_with_the_line(command, tmp_path, contents, message):
    (tmp_path / "wrong.py").write_text(contents)
    (tmp_path / "tomllib.py").write_text("")
    code, _, said = command("fly", "wrong.py")
    assert code == 2 and said.startswith("jentry: ") and said.count("\n") == 1
    assert message in said or re.search(message, said), said


NONE = """
import jentry
for wrong in (
    dict(laws={"one": 3}),
    dict(laws=lambda: 3),
    dict(laws={"one": dict}, dispersions={"all": {}}),
    dict(laws={"one": dict}, gains="guidance"),
):
    try:
        jentry.Mission(name="mine", title="", **wrong)
    except ValueError as error:
        print(error)
"""


def test_missions_of_wrong_types_are_refused():
    """In a process of its own, where annotations are not enforced."""
    run = subprocess.run(
        [sys.executable, "-c", NONE],
        capture_output=True,
        text=True,
        cwd=HERE.parent,
    )
    for said, message in zip(
        run.stdout.splitlines(),
        (
            "laws 'one' of mission mine is a int: it must be a function",
            "mission mine has laws <function",
            "dispersions 'all' of mission mine is a dict: it must be a function",
            "gains of mission mine is 'guidance': it must be a tuple, ('guidance',)",
        ),
        strict=True,
    ):
        assert message in said


PROBLEM = FlightProblem(AtEnd("downrange"), FreeControl(0.0, -1.0, 1.0))


@pytest.mark.parametrize("asked", ["scenario", "dispersion_table", "problem"])
def test_builders_know_their_numbers_where_jax_traces_who_asks(asked):
    """They may keep what they have built, and compute with its values."""
    values = []

    def built(made):
        def build():
            values.append(jnp.sqrt(jnp.asarray(4.0)))
            assert float(values[-1]) == 2.0
            return made

        return {"one": build}

    # Its mass is a Python number.
    flown = eqx.tree_at(lambda s: s.vehicle.mass, cheap.scenario(), 992.0)
    mission = jentry.Mission(
        name="mine",
        title="",
        laws=built(flown),
        dispersions=built(cheap.mass_only()),
        problems=built(PROBLEM),
    )

    def asking(x):
        found = getattr(mission, asked)()
        if asked == "scenario":
            assert (
                eqx.is_array(found.vehicle.mass) and float(found.vehicle.mass) == 992.0
            )
        return values[-1] * x

    assert jax.grad(jax.jit(asking))(3.0) == 2.0
    assert float(values[0]) == 2.0


def test_a_file_that_is_not_there_and_a_name_of_one_that_is(command, tmp_path):
    code, _, said = command("fly", "nowhere.py")
    assert code == 2 and f"there is no file {tmp_path / 'nowhere.py'}" in said
    (tmp_path / "mine.py").write_text(MINIMAL)
    code, _, said = command("fly", "mine")
    assert code == 2 and "did you mean mine.py?" in said


def test_an_error_in_a_file_that_is_imported_is_told_there(command, folder):
    law = folder / "copied_law.py"
    law.write_text("import jentry\n\nraise RuntimeError('two\\nlines')")
    code, _, said = command("fly", "copied_mission.py")
    assert code == 2 and f"{law}, line 3: RuntimeError: two lines\n" in said


def test_a_mission_without_dispersions_flies_and_says_so(command, tmp_path):
    (tmp_path / "mine.py").write_text(MINIMAL)
    code, printed, _ = command("show", "mine.py")
    assert code == 0 and "guidance.gain" in printed
    code, _, said = command("monte-carlo", "mine.py")
    assert code == 2 and "mission minimal has no dispersions" in said
    (tmp_path / "mass.toml").write_text(
        "[dispersions.mass]\naddress = 'vehicle.mass'\ndistribution = 'uniform'\n"
        "lower = 900\nupper = 1000"
    )
    code, printed, _ = command("show", "mine.py", "--config", "mass.toml")
    assert code == 0 and "dispersions: of --config alone" in printed


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Installs a package with entry points; its folder."""
    place = tmp_path / "site"
    monkeypatch.syspath_prepend(place)

    def install(points, name="landers", contents=MINIMAL):
        (place / name).mkdir(parents=True)
        (place / name / "__init__.py").write_text("")
        (place / name / "other.py").write_text("")
        (place / name / "one.py").write_text("from . import other\n" + contents)
        about = place / f"{name}-1.2.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Name: {name}\nVersion: 1.2\n")
        (about / "entry_points.txt").write_text("[jentry.missions]\n" + points)
        return place / name

    yield install
    for module in [m for m in sys.modules if m.split(".")[0] in ("landers", "more")]:
        del sys.modules[module]


def test_a_package_offers_its_missions(command, package):
    place = package("minimal = landers.one:MISSION\n")
    mission = jentry.find_mission("minimal")
    assert mission.name == "minimal" and mission.code["landers"] == "1.2"
    files = {f"landers/{name}.py" for name in ("__init__", "one", "other")}
    assert set(mission.code) == {"landers", *files}
    one = hashlib.sha256((place / "one.py").read_bytes()).hexdigest()
    assert mission.code["landers/one.py"] == one
    code, printed, said = command("list")
    assert (code, said) == (0, "")
    assert "minimal: " in printed and "mars-drag-tracking: " in printed
    code, printed, _ = command("show", "minimal")
    assert code == 0 and "guidance.gain" in printed
    code, _, said = command("show", "minimla")
    assert "nearest: minimal" in said


def test_packages_that_do_not_fit_are_named_and_do_not_spoil_the_others(
    command, package
):
    package("minimal = landers.one:MISSION\nbroken = landers.none:MISSION\n")
    points = (
        "minimal = more.one:MISSION\ncav-h = more.one:MISSION\nx = more.one:MISSION"
    )
    package(points, "more")
    for name, message in {
        "minimal": "landers (landers.one:MISSION) and the package more (more.one",
        "cav-h": "the mission cav-h of jentry and the package more",
        "broken": "'broken' of the package landers (landers.none:MISSION): ModuleNot",
        "x": "of the package more (more.one:MISSION) is named 'minimal'",
    }.items():
        code, _, said = command("show", name)
        assert code == 2 and message in said, said
    code, printed, said = command("list")
    assert code == 0 and said.count("\n") == 4 and "mars-drag-tracking" in printed


# One file of a user.


@pytest.fixture
def lander(tmp_path):
    (tmp_path / "my_lander.py").write_text(LANDER)
    return tmp_path


def test_one_file_flies(command, lander):
    code, printed, _ = command("fly", "my_lander.py", "--set", "guidance.bank=80deg")
    assert code == 0 and "my-lander: reached the end of guided flight" in printed
    scenario = jentry.find_mission(lander / "my_lander.py").scenario()
    assert leaves_by_address(scenario)["guidance.gain"] == 0.01


@pytest.mark.skipif(shutil.which("pyright") is None, reason="pyright is not installed")
@pytest.mark.slow
def test_the_example_of_the_readme_and_the_file_pass_pyright(lander):
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", README, re.S)):
        if "import jentry\n" in block or "jax, jentry" in block:
            (lander / f"block_{number}.py").write_text(block)
    settings = {"typeCheckingMode": "basic", "extraPaths": [str(HERE.parent)]}
    (lander / "pyrightconfig.json").write_text(json.dumps(settings))
    run = subprocess.run(["pyright"], capture_output=True, text=True, cwd=lander)
    assert run.returncode == 0, run.stdout
