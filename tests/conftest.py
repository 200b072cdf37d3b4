"""Settings and fixtures that every test shares."""

import contextlib
import ctypes
import gc
import os
import sys
from pathlib import Path

import compiling
import equinox as eqx
import jax
import pytest
from jaxtyping import install_import_hook


# As the command does: in a process that has traced much, to look for rubbish is up to a
# sixth of what it does.
gc.set_threshold(100_000)

# What XLA has compiled is kept beside what pytest keeps, for the other worker and for the
# next run, and found by all that a program is made of. Commands that tests start read it
# from the environment.
_ROOT = Path(__file__).parent.parent
_COMPILED = str(_ROOT / ".pytest_cache" / "compiled")
_DIR, _SECONDS = (
    "JAX_COMPILATION_CACHE_DIR",
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS",
)
jax.config.update(_DIR.lower(), os.environ.setdefault(_DIR, _COMPILED))
jax.config.update(_SECONDS.lower(), float(os.environ.setdefault(_SECONDS, "0")))
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
# Where each operation comes from, call by call, is not written into programs: to trace,
# write and compile `cav-h` takes 7.2 s and not 7.9 (medians of six).
jax.config.update("jax_traceback_in_locations_limit", 0)


_NOT_ENFORCED = "_provenance", "kernel"
"""Packages that go through 100 000 objects at a time, none of them an array with a shape:
to look at their annotations takes six times as long as what they do"""


def pytest_addoption(parser):
    parser.addoption(
        "--enforce-annotations",
        action="store_true",
        help="look at types and shapes of all arguments and results",
    )


@pytest.hookimpl(
    trylast=True
)  # jentry must not be imported before its types are checked
def pytest_configure(config):
    """Compile loops as users do; commands that tests start, and workers, find it so."""
    if config.getoption("--enforce-annotations"):
        names = (path.stem for path in (_ROOT / "jentry").iterdir())
        checked = [f"jentry.{n}" for n in names if n not in _NOT_ENFORCED]
        install_import_hook(checked, "beartype.beartype")
    from jentry import _setup

    _setup._turn_on(_setup._LOOPS, remember=False)


def optimized(item) -> bool:
    """Whether the closest mark says so: `optimized`, and not `optimized(False)`."""
    mark = item.get_closest_marker("optimized")
    return mark is not None and mark.args != (False,)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    compiling.optimize(optimized(item))
    compiling.loop_over_batches(item.get_closest_marker("batches") is not None)


def _most() -> float:
    """Bytes in memory, of each worker, beyond which it forgets what it has compiled: its
    share of half of what the machine has, from 3 to 6 GiB."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    try:
        there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # the system does not say
        there = 0
    return min(max(3 * 2**30, there / 2 / workers), 6 * 2**30)


_MOST = _most()


def in_memory() -> float:
    """Bytes; infinite where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return float("inf")
    return pages * os.sysconf("SC_PAGE_SIZE")


def give_back() -> None:
    """Throw away what nobody needs, and have the C library, if it is glibc, give back what
    is free: else all that follow would be beyond what is allowed as well, and would find
    nothing compiled."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _keep_for_good() -> None:
    """Look for rubbish here once, and nowhere in what is there now again."""
    gc.collect()
    gc.freeze()


def pytest_collection_finish():
    """A million objects that have been imported stay."""
    _keep_for_good()


def pytest_sessionfinish():
    """pytest looks five times for exceptions that nobody has seen, among all that has been
    compiled."""
    _keep_for_good()


@pytest.fixture(autouse=True)
def forgetting(request):
    """What slow tests have traced and compiled would fill the memory, gigabytes in all."""
    yield
    if request.node.get_closest_marker("slow") and in_memory() > _MOST:
        give_back()
        if in_memory() > _MOST:  # and no rubbish
            jax.clear_caches()
            give_back()


_LONGEST = (
    "tutorials",
    *("predictor_corrector_missions", "rlv", "cluster", "sx_2", "tuning", "x_33"),
    *("cav_h", "predictor_corrector_flights", "crossings", "declared_dispersions"),
    *("predictor_corrector", "tuning_gradients", "sensitivity"),
)
"""Files of slow tests, of which none begins when the others are done"""


def pytest_collection_modifyitems(items):
    """The longest files first, where xdist keeps this order (`.ci/run`)."""
    places = {f"test_{name}": place for place, name in enumerate(_LONGEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))


@pytest.fixture
def key():
    return jax.random.key(20261121)


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Runs the command in this process: its exit code, and what it printed."""
    import cheap

    from jentry.cli import main
    from jentry.missions import ALL

    monkeypatch.setitem(ALL, "cheap", cheap.MISSION)
    # What it settles holds for the whole process.
    monkeypatch.setattr("jentry._setup.setup", lambda *how, **options: None)
    monkeypatch.chdir(tmp_path)

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["jentry", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return run


@pytest.fixture
def density(tmp_path):
    config = tmp_path / "overrides.toml"
    config.write_text('law = "right"\n[set]\nplanet.density_scale = 1.25')
    return "--config", config


@pytest.fixture
def written(tmp_path):
    """Writes a file and returns its path."""

    def write(contents):
        path = tmp_path / "file.txt"
        if isinstance(contents, str):
            contents = contents.encode()
        path.write_bytes(contents)
        return path

    return write


@pytest.fixture(scope="session")
def planned():
    """The planned Mars reference: bank profile, flight, and drag over energy and time."""
    from helpers import mars_scenario

    from jentry.motion.index import EnergyIndex, TimeIndex
    from jentry.planning.reference_flight import (
        ReferenceFlight,
        open_loop,
        plan_bank_profile,
        plan_drag_reference,
    )

    @eqx.filter_jit
    def plan(scenario):
        profile = plan_bank_profile(scenario, 503.0)
        flight = ReferenceFlight.of(open_loop(scenario, profile, 300.0))
        references = {
            "energy": plan_drag_reference(flight, EnergyIndex()),
            "time": plan_drag_reference(flight, TimeIndex()),
        }
        return profile, flight, references

    return plan(mars_scenario())


@pytest.fixture(scope="session")
def reference(planned):
    """The planned drag over energy."""
    return planned[2]["energy"]
