"""The one call that settles precision, cores, compilation cache and XLA options."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import pytest

from jentry import _setup


REPOSITORY = Path(__file__).parents[1]


@pytest.fixture
def process(tmp_path):
    """Runs a script in a process of its own, in a folder of its own; what it printed."""
    work = tmp_path / "work"
    work.mkdir()

    def run(script, **environment):
        path = (
            tmp_path / "script.py"
        )  # whose folder is on the path, not the working one
        path.write_text(script)
        given = {
            n: v
            for n, v in os.environ.items()
            if n not in ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR")
        }
        given |= {
            "PYTHONPATH": str(REPOSITORY),
            "JENTRY_CACHE": str(tmp_path / "cache"),
        }
        given |= environment
        done = subprocess.run(
            [sys.executable, "-W", "error", path],
            cwd=work,
            env=given,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    return run


SETTLED = """
import jentry
jentry.setup(workers=3)
import jax, jax.numpy as jnp
print(len(jax.devices()), {d.platform for d in jax.devices()})
print(jax.jit(lambda x: 3.0 * x)(jnp.asarray(1.0)).dtype)
jentry.setup(workers=3)  # again the same
print(len(jax.devices()))
try:
    jentry.setup(workers=2)
except RuntimeError as error:
    print(error)
"""


def test_precision_cores_and_cache_are_settled(process, tmp_path):
    devices, dtype, again, refused = process(SETTLED)
    assert devices == "3 {'cpu'}" and again == "3"
    assert dtype == "float64"
    assert "JAX has started with 3 CPU devices, and setup asks for 2" in refused
    assert "call jentry.setup() before anything" in refused
    # The program that was compiled is kept, small as it is.
    assert any((tmp_path / "cache" / "compiled").iterdir())


LEFT_ALONE = """
import os
cores = sorted(os.sched_getaffinity(0))[:1]
os.sched_setaffinity(0, cores)
import jentry
jentry.setup(cache=False)
import jax, jax.numpy as jnp
print(len(jax.devices()), jax.config.jax_compilation_cache_dir)
print(jax.jit(lambda x: 3.0 * x)(jnp.asarray(1.0)).dtype)
from jentry._setup import xla_options
print(len(xla_options()))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux only")
def test_as_many_workers_as_cores_and_no_cache_where_none_is_asked_for(
    process, tmp_path
):
    assert process(LEFT_ALONE) == ["1 None", "float64", "1"]
    assert process(LEFT_ALONE, JENTRY_FAST="0") == ["1 None", "float64", "0"]
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize("workers", [0, -1])
def test_no_workers_are_refused(workers):
    with pytest.raises(ValueError, match=f"workers is {workers}: it must be at least"):
        _setup.setup(workers)


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"JENTRY_CACHE": "/a/b", "XDG_CACHE_HOME": "/c"}, "/a/b"),
        ({"XDG_CACHE_HOME": "/c"}, "/c/jentry"),
        ({"XDG_CACHE_HOME": ""}, "/home/me/.cache/jentry"),
        # Which the specification has ignored: programs that are run are kept there.
        ({"XDG_CACHE_HOME": "here"}, "/home/me/.cache/jentry"),
        ({}, "/home/me/.cache/jentry"),
    ],
    ids=str,
)
def test_where_compiled_programs_are_kept(monkeypatch, environment, expected):
    for name in ("JENTRY_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "/home/me")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert _setup.cache_directory() == Path(expected)


def test_relative_cache_is_refused(monkeypatch):
    """It would be another in every folder that jentry is started in, and run from there."""
    monkeypatch.setenv("JENTRY_CACHE", "here")
    with pytest.raises(ValueError, match="JENTRY_CACHE is 'here'.*an absolute path"):
        _setup.cache_directory()


# The fast options.

PLANTED = """
open("executed", "w").close()
raise SystemExit(0)
"""

FAST = """
import os, sys
import jentry
print(os.getcwd() in sys.path or "" in sys.path)
jentry.setup(workers=1, fast=True, cache=False)
from jentry._setup import fast_options_are_on
print(fast_options_are_on())
import jax, jax.numpy as jnp
print(jax.jit(lambda x: 3.0 * x)(jnp.asarray(1.0)))
"""


@pytest.mark.slow
def test_fast_executes_nothing_of_the_working_folder(process, tmp_path):
    """And passes its self-test nevertheless: it finds JAX where this process has it."""
    for name in ("jax", "numpy", "json", "sitecustomize", "usercustomize"):
        (tmp_path / "work" / f"{name}.py").write_text(PLANTED)
    assert process(FAST) == ["False", "True", "3.0"]
    assert not (tmp_path / "work" / "executed").exists()


@pytest.mark.parametrize("forbidden", ["0", "1", None])
def test_options_can_be_forbidden(monkeypatch, forbidden):
    tried = []
    monkeypatch.setattr(_setup, "_turn_on", lambda *names, **how: tried.append(names))
    monkeypatch.delenv("JENTRY_FAST", raising=False)
    if forbidden is not None:
        monkeypatch.setenv("JENTRY_FAST", forbidden)
    as_it_is = {"workers": jax.local_device_count("cpu"), "cache": False}
    _setup.setup(**as_it_is, fast=True)
    _setup.setup(**as_it_is)
    both = [(_setup._LOOPS, _setup._FUSION), (_setup._LOOPS,)]
    assert tried == ([] if forbidden == "0" else both)


def test_tests_compile_loops_as_users_do():
    assert _setup._LOOPS in _setup.xla_options()


@pytest.fixture
def flags(monkeypatch, tmp_path):
    """Sets XLA_FLAGS, and gives what becomes of them; of this process JAX has read them."""
    monkeypatch.setattr(_setup, "_jax_has_begun", lambda: False)
    monkeypatch.setenv("JENTRY_CACHE", str(tmp_path / "cache"))

    def turn_on(before, *options, remember=False):
        monkeypatch.setenv("XLA_FLAGS", before)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            options = options or (_setup._LOOPS, _setup._FUSION)
            _setup._turn_on(*options, remember=remember)
        return os.environ["XLA_FLAGS"], [str(warning.message) for warning in caught]

    return turn_on


def test_flags_of_the_user_stay(flags, monkeypatch):
    monkeypatch.setattr(_setup, "_failure_of_self_test", lambda environment: None)
    after, said = flags("--xla_one=1")
    assert after.startswith("--xla_one=1 ") and not said
    assert "--xla_cpu_prefer_vector_width=512" in after
    assert _setup.xla_options() == [_setup._LOOPS, _setup._FUSION]
    assert _setup.fast_options_are_on()
    assert flags(after) == (after, [])  # once is enough
    assert flags(after, _setup._LOOPS) == (after, [])


def test_one_more_option_joins_those_that_are_on(flags, monkeypatch):
    monkeypatch.setattr(_setup, "_failure_of_self_test", lambda environment: None)
    usual, _ = flags("", _setup._LOOPS)
    assert _setup.xla_options() == [_setup._LOOPS]
    assert not _setup.fast_options_are_on()
    assert flags(f"{usual} --xla_one=1") == (
        f"--xla_one=1 --xla_cpu_prefer_vector_width=512 --xla_backend_extra_options="
        f"{_setup._LOOPS},{_setup._FUSION}",
        [],
    )


def test_options_of_the_users_own_keep_the_fast_ones_off(flags):
    own = "--xla_backend_extra_options=something"
    after, (said,) = flags(own)
    assert after == own and not _setup.xla_options()
    assert (
        "the fast XLA options stay off" in said and "extra_options of its own" in said
    )


def test_they_stay_off_where_jax_would_not_see_them(flags, monkeypatch):
    """It reads them once: a campaign would be stored as flown with what it was not."""
    monkeypatch.setattr(_setup, "_jax_has_begun", lambda: True)
    after, (said,) = flags("")
    assert after == "" and "JAX has compiled without them" in said


def test_jax_has_begun_in_this_process_and_not_in_one_without_it(process):
    jax.devices()
    assert _setup._jax_has_begun()
    without = "from jentry import _setup; print(_setup._jax_has_begun())"
    imported = f"import jax; {without}"
    used = f"import jax; jax.devices(); {without}"
    assert [process(code) for code in (without, imported, used)] == [
        ["False"],
        ["False"],
        ["True"],
    ]


def test_the_self_test_runs_once_for_each_set_of_flags(flags, monkeypatch):
    tried = []
    monkeypatch.setattr(
        _setup, "_failure_of_self_test", lambda env: tried.append(env["XLA_FLAGS"])
    )
    for _ in range(2):
        flags("", remember=True)
    assert len(tried) == 1
    flags("", _setup._LOOPS, remember=True)
    flags("--xla_one=1", remember=True)
    assert len(tried) == 3
    monkeypatch.setattr(_setup, "version", lambda name: "another")
    flags("", remember=True)
    assert len(tried) == 4


@pytest.mark.parametrize("remember", [True, False])
def test_a_self_test_that_fails_or_is_not_to_be_kept_runs_again(
    flags, monkeypatch, remember
):
    tried = []

    def self_test(environment):
        tried.append(1)
        return "numbers differ" if remember else None

    monkeypatch.setattr(_setup, "_failure_of_self_test", self_test)
    for _ in range(2):
        flags("", remember=remember)
    assert len(tried) == 2


FAILURES = {
    "says why": ("raise ValueError('numbers differ')", "ValueError: numbers differ"),
    "says nothing": ("import os; os._exit(3)", "exit code 3"),
    "crashes": ("import os; os.abort()", "exit code -6"),
    # What is computed decides, not that something is.
    "computes wrongly": (
        _setup._SELF_TEST.replace("i + 1, x + 1e-3", "i + 1, x + 2e-3"),
        "AssertionError",
    ),
}


@pytest.mark.parametrize(("script", "reason"), FAILURES.values(), ids=FAILURES)
def test_a_self_test_that_fails_keeps_them_off(flags, monkeypatch, script, reason):
    monkeypatch.setattr(_setup, "_SELF_TEST", script)
    after, (said,) = flags("--xla_cpu_enable_fast_math=false")
    assert after == "--xla_cpu_enable_fast_math=false"
    assert f"their self-test failed ({reason}" in said
    assert "Flights are as exact" in said


@pytest.mark.parametrize("interpreter", ["", "/nowhere/python", None])
def test_without_an_interpreter_they_stay_off(flags, monkeypatch, interpreter):
    monkeypatch.setattr(sys, "executable", interpreter)
    after, (said,) = flags("")
    assert after == "" and "their self-test failed" in said
