"""The architecture: imports go down only, importing does nothing, modules say what."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import jentry


PACKAGE = Path(jentry.__file__).parent

FLOORS = {
    "fields": 0,
    "units": 0,
    "_math": 0,
    "_integrate": 0,
    "_newton": 0,
    "_batching": 0,
    "_apart": 0,
    "_files": 0,
    "_warnings": 0,
    "_dependence": 0,
    "_linear_solve": 0,
    "addresses": 0,
    "_interpolation": 0,
    "_tables": 0,
    "_setup": 0,
    "_devices": 0,
    "_trace_modes": 0,
    "_collocation": 0,
    "_programs": 0,
    "_computed_once": 0,
    "_provenance": 0,
    "_printed": 0,
    "kernel": 1,
    "world": 1,
    "motion": 2,
    "onboard": 3,
    "guidance": 4,
    "flight": 5,
    "campaign": 6,
    "parameters": 7,
    "statistics": 7,
    "planning": 8,
    "tuning": 8,
    "analysis": 8,
    "learning": 8,
    "plots": 8,
    "missions": 9,
    "cli": 10,
    "__main__": 10,
    "_api": 10,
}
"""By the first name below `jentry`: guide, section 2. The top module re-exports all."""

MODULES = sorted(PACKAGE.rglob("*.py"))

STATE_NAMES = {"state", "states", "y", "y0", "y1", "initial_state"}


def name_of(path: Path) -> tuple[str, ...]:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


def place(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def imported(path: Path) -> set[str]:
    """First name below `jentry` of each of our modules that a file imports."""
    package = name_of(path) if path.name == "__init__.py" else name_of(path)[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
            ours = [name[1:] for name in names if name[0] == "jentry"]
        elif isinstance(node, ast.ImportFrom):
            module = node.module.split(".") if node.module else []
            if node.level == 0:
                if module[0] != "jentry":
                    continue
                base = module[1:]
            else:
                base = [*package[: len(package) - node.level + 1], *module]
            ours = [base] if base else [[alias.name] for alias in node.names]
        else:
            continue
        found.update(name[0] if name else "jentry" for name in ours)
    return found


def test_every_place_has_a_floor():
    tops = {name_of(path)[0] for path in MODULES if name_of(path)}
    assert tops <= set(FLOORS), f"no floor for {sorted(tops - set(FLOORS))}"


@pytest.mark.parametrize("path", MODULES, ids=place)
def test_imports_go_down_only(path):
    name = name_of(path)
    if not name:
        return
    floor = FLOORS[name[0]]
    too_high = {
        other
        for other in imported(path)
        if other == "jentry"
        or (other != name[0] and FLOORS[other] >= floor and floor > 0)
        or (floor == 0 and FLOORS[other] > 0)
    }
    if floor == 8:  # what is computed of many flights may use each other
        too_high = {other for other in too_high if FLOORS.get(other, 99) > floor}
    if floor == 10:
        too_high = {other for other in too_high if other == "jentry"}
    assert not too_high, f"floor {floor} imports {sorted(too_high)}"


@pytest.mark.parametrize("path", MODULES, ids=place)
def test_every_module_says_what_it_is(path):
    source = path.read_text()
    if source.strip():
        docstring = ast.get_docstring(ast.parse(source))
        assert docstring, "no docstring"
        assert len(docstring.splitlines()[0]) <= 88


@pytest.mark.parametrize("path", MODULES, ids=place)
def test_no_number_indexes_a_state(path):
    """Nobody writes `y[3]` for a component: components have names."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Subscript) or not isinstance(
            node.slice, ast.Constant
        ):
            continue
        if not isinstance(node.slice.value, int):
            continue
        base = node.value
        name = base.id if isinstance(base, ast.Name) else getattr(base, "attr", None)
        # `y[0]` of the pair (state, memory) is a pair taken apart, not a component.
        assert name not in STATE_NAMES or node.slice.value == 0, ast.unparse(node)


_AFTER_IMPORT = """
import sys
import jax
before = dict(jax.config.values)
import jentry
jentry.fly, jentry.monte_carlo, jentry.find_mission, jentry.Cluster
heavy = {"pint", "matplotlib", "xarray", "pandas", "typer", "h5netcdf", "netCDF4"}
heavy |= {"dask", "distributed"}  # cloudpickle JAX imports where it is there
loaded = sorted(heavy & set(sys.modules))
assert not loaded, f"import jentry pulls in {loaded}"
from jax._src import xla_bridge
assert not xla_bridge.backends_are_initialized(), "import jentry starts a backend"
changed = {k for k, v in jax.config.values.items() if before.get(k) != v}
assert not changed, f"import jentry changes {changed}"
"""


def test_importing_does_nothing():
    """No plotting or tables, no device, no global setting: in a fresh process."""
    run = subprocess.run(
        [sys.executable, "-c", _AFTER_IMPORT],
        capture_output=True,
        text=True,
        cwd=PACKAGE.parent,
    )
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("path", MODULES, ids=place)
def test_no_module_has_the_name_of_what_it_holds(path):
    """Else `jentry.flight.fly` is a module or a function, as the imports happen to go."""
    tree = ast.parse(path.read_text())
    held = {
        node.name
        for node in tree.body
        if isinstance(node, (ast.FunctionDef, ast.ClassDef))
    }
    modules = {path.stem}
    if path.name == "__init__.py":
        modules = {other.stem for other in path.parent.glob("*.py")}
        modules |= {other.parent.name for other in path.parent.glob("*/__init__.py")}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                held |= {alias.asname or alias.name for alias in node.names}
    assert not held & modules


SHOWN = ("cli", "plots", "campaign", "statistics", "tuning", "analysis")
UNITS = {
    "km",
    "rad",
    "deg",
    "m/s",
    "m/s2",
    "Pa",
    "kPa",
    "W/m2",
    "W/cm2",
    "MW/m²",
    "J/m2",
}


@pytest.mark.parametrize(
    "path", [p for p in MODULES if name_of(p)[:1] and name_of(p)[0] in SHOWN], ids=place
)
def test_no_unit_of_an_output_is_written_twice(path):
    """It is on its field, or on the class of its constraint: see `units_of`."""
    strings = {
        node.value
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert not strings & UNITS
