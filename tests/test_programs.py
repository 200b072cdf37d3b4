"""Cached programs: found again by what they are made of, and by nothing less."""

import functools
import gc
import os
import subprocess
import sys
import time
import types
import warnings
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry import _math, _programs, _setup
from jentry._provenance import program_keys


SOURCE = """
import array
import warnings
import jax
import jax.numpy as jnp
import numpy as np
from jentry import _math

TRACED = array.array("b")
FACTOR = 3.0

def times(x, factor=2.0):
    TRACED.append(1)
    total = jnp.sum(x)
    return {"twice": factor * x, "none": None, "said": ("as it is", factor), "sum": total}

def warns(x):
    warnings.warn("of this")
    return x

def fails(x):
    raise ValueError("x is what it is")

def sine(x):
    TRACED.append(1)
    return jax.vmap(_math.sincos)(x)[0]

def cosine(x):
    return jax.vmap(_math.sincos)(x)[1]

def by_factor(x):
    TRACED.append(1)
    return FACTOR * x

def draw(key):
    return jax.random.uniform(key, (3,))

def split(key):
    return jax.random.split(key)

def weak(x):
    return jnp.asarray(2.0), 2.0 * x, jnp.full(4, 1.0)

class Law:
    SIZE = 1.0

    def __init__(self):
        self.scale = 1.0

    def by(self, x):
        return x

    class Inner:
        def by(self, x):
            return x

LAW = Law()
TABLE = np.zeros(4)
NUDGE = np.float64(1.0)
STATISTICS = {f"of {n}": (sine, float(n)) for n in range(40)}
"""


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(_setup, "_PROGRAMS", tmp_path / "programs")
    return tmp_path / "programs"


@pytest.fixture
def ours(monkeypatch):
    """A module that is jentry's by its name."""
    module = types.ModuleType("jentry._made_by_a_test")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(SOURCE, vars(module))
    return module


def files(folder):
    return sorted(folder.iterdir()) if folder.exists() else []


X = np.linspace(0.1, 1.0, 7)


def test_cached_and_found(folder, ours):
    x = jnp.asarray(X)
    first = _programs.cached(ours.times)(x)
    assert len(files(folder)) == 1 and len(ours.TRACED) == 1
    again = _programs.cached(ours.times)(x)
    assert len(files(folder)) == 1 and len(ours.TRACED) == 1
    for found in (first, again):
        assert list(found) == ["none", "said", "sum", "twice"] or set(found) == set(
            first
        )
        assert found["none"] is None and found["said"] == ("as it is", 2.0)
        np.testing.assert_array_equal(found["twice"], 2.0 * X)
        np.testing.assert_allclose(found["sum"], X.sum(), rtol=1e-15)


def test_what_is_found_is_run(folder, ours):
    """A sine whose file holds a cosine: proof that the file is what counts."""
    x = jnp.asarray(X)
    _programs.cached(ours.sine)(x)
    (sine,) = files(folder)
    _programs.cached(ours.cosine)(x)
    (cosine,) = set(files(folder)) - {sine}
    sine.write_bytes(cosine.read_bytes())
    np.testing.assert_allclose(_programs.cached(ours.sine)(x), np.cos(X), rtol=1e-14)


def test_results_are_as_free_as_others(folder, ours):
    """Not tied to a device, nor to what was given: they go into the next program."""
    out = _programs.cached(ours.times)(jnp.asarray(X))["twice"]
    assert isinstance(out, jax.Array) and not out.committed


@pytest.mark.parametrize(
    "given",
    [
        lambda: (jnp.asarray(X[:3]),),
        lambda: (jnp.asarray(X, jnp.float32),),
        lambda: (jnp.asarray(X), 2.5),
        lambda: (jnp.asarray(X), 2),
        lambda: (jnp.asarray(X), jnp.asarray(2.0)),
    ],
    ids=["shape", "dtype", "number", "type", "array"],
)
def test_another_program(folder, ours, given):
    times = _programs.cached(ours.times)
    arguments = given()
    times(jnp.asarray(X), *[2.0][: len(arguments) - 1])
    out = times(*arguments)
    assert len(files(folder)) == 2
    factor = arguments[1] if len(arguments) > 1 else 2.0
    expected = np.asarray(arguments[0]) * factor
    np.testing.assert_array_equal(out["twice"], expected)


def test_constant_changed_in_memory(folder, ours, monkeypatch):
    x = jnp.asarray(X)
    np.testing.assert_array_equal(_programs.cached(ours.by_factor)(x), 3.0 * X)
    monkeypatch.setattr(ours, "FACTOR", 4.0)
    np.testing.assert_array_equal(_programs.cached(ours.by_factor)(x), 4.0 * X)
    assert len(files(folder)) == 2


def test_function_replaced_in_memory(folder, ours, monkeypatch):
    x = jnp.asarray(X)
    _programs.cached(ours.sine)(x)
    monkeypatch.setattr(_math, "sincos", lambda x: (x, x))
    np.testing.assert_array_equal(_programs.cached(ours.sine)(x), X)
    assert len(files(folder)) == 1


def test_method_replaced_in_memory(ours, monkeypatch):
    made = program_keys.key_of("a program")
    monkeypatch.setattr(ours.Law, "by", lambda self, x: 2.0 * x)
    with pytest.raises(program_keys.Unknown):
        program_keys.key_of("a program")
    monkeypatch.undo()
    assert made != program_keys.key_of("another")


def test_a_module_comes_in_from_another_thread(monkeypatch):
    """Python may turn to another thread, which imports, wherever it collects garbage."""
    count = len(sys.modules)

    def imports(phase, _):
        name = f"come_in_{len(sys.modules)}"
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))

    thresholds = gc.get_threshold()
    gc.callbacks.append(imports)
    try:
        gc.set_threshold(1, 1_000_000, 1_000_000)  # the youngest objects alone
        told = next(program_keys._in_memory())
    finally:
        gc.set_threshold(*thresholds)
        gc.callbacks.remove(imports)
    assert len(sys.modules) > count and told == next(program_keys._in_memory())


def doubled(function):
    @functools.wraps(function)
    def twice(*given):
        return 2.0 * function(*given)

    return twice


@pytest.mark.parametrize(
    "patch",
    [
        lambda ours: (ours.Law, "by", doubled(ours.Law.by)),
        lambda ours: (ours.Law, "by", functools.partial(ours.Law.by, None)),
        lambda ours: (ours.Law, "by", jax.vmap(ours.Law.by)),
        lambda ours: (ours.Law, "by", property(ours.Law.by)),
        lambda ours: (ours.Law, "SIZE", 2.0),
        lambda ours: (ours.Law.Inner, "by", ours.sine),
        lambda ours: (ours.LAW, "scale", 2.0),
        lambda ours: (ours, "TABLE", np.arange(4.0)),
        lambda ours: (ours, "NUDGE", np.float64(2.0)),
        lambda ours: (ours.sine, "__defaults__", (1.0,)),
        lambda ours: (ours.sine, "__code__", ours.cosine.__code__),
        lambda ours: (ours.STATISTICS, "of 39", (ours.cosine, 39.0)),
    ],
    ids=[
        "wraps",
        "partial",
        "vmap",
        "property",
        "class attribute",
        "nested class",
        "instance",
        "array",
        "number of numpy",
        "defaults",
        "code",
        "dictionary",
    ],
)
def test_patches_are_seen(ours, monkeypatch, patch):
    """Another key, or none: never that of what is in the files."""
    made = program_keys.key_of("a program")
    thing, name, value = patch(ours)
    if isinstance(thing, dict):
        monkeypatch.setitem(thing, name, value)
    else:
        monkeypatch.setattr(thing, name, value)
    try:
        assert program_keys.key_of("a program") != made
    except program_keys.Unknown:
        pass
    monkeypatch.undo()


def test_what_was_patched_once_leaves_no_trace(folder, ours, monkeypatch):
    """JAX keeps the traces of functions within: those of the patched do not come back."""
    x = jnp.asarray(X)
    with monkeypatch.context() as patched:
        patched.setattr(_math, "_SINE", tuple(1.5 * c for c in _math._SINE))
        wrong = _programs.cached(ours.sine)(x)
    assert np.max(np.abs(wrong - np.sin(X))) > 1e-3
    np.testing.assert_allclose(_programs.cached(ours.sine)(x), np.sin(X), rtol=1e-14)
    assert len(files(folder)) == 2


def test_settings_are_asked_every_time(folder, ours):
    key, draw = jax.random.key(0), _programs.cached(ours.draw)
    expected = jax.random.uniform(key, (3,))
    np.testing.assert_array_equal(draw(key), expected)
    with jax.threefry_partitionable(not jax.config.jax_threefry_partitionable):
        other = jax.random.uniform(key, (3,))
        assert np.any(other != expected)
        np.testing.assert_array_equal(draw(key), other)
    np.testing.assert_array_equal(draw(key), expected)


def test_keys_and_weak_types_come_back_as_they_were(folder, ours):
    key = jax.random.key(1)
    split = _programs.cached(ours.split)(key)
    assert jnp.all(jax.random.key_data(split) == jax.random.key_data(ours.split(key)))
    for x in (jnp.asarray(2.0), jnp.ones(3), jnp.asarray(1.5, jnp.float32)):
        weak = _programs.cached(ours.weak)(x)
        for found, expected in zip(weak, jax.jit(ours.weak)(x), strict=True):
            assert found.weak_type == expected.weak_type
            assert found.dtype == expected.dtype
            np.testing.assert_array_equal(found, expected)


def test_within_a_trace_without_a_tracer(folder, ours):
    cached = _programs.cached(ours.by_factor)
    x = jnp.asarray(X)
    assert jax.eval_shape(lambda: cached(x)).shape == X.shape
    np.testing.assert_array_equal(jax.jit(lambda: cached(x))(), 3.0 * X)
    assert not files(folder)


def test_threads(folder, ours):
    """Many at once: the same result, one file, and warnings as they were."""
    before = list(warnings.filters)
    cached = _programs.cached(ours.by_factor)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: cached(jnp.asarray(X)), range(16)))
    for each in found:
        np.testing.assert_array_equal(each, 3.0 * X)
    assert len(files(folder)) == 1
    assert list(warnings.filters) == before


def test_function_of_ours_in_the_place_of_another(ours, monkeypatch):
    made = program_keys.key_of("a program")
    monkeypatch.setattr(ours, "sine", ours.cosine)
    assert program_keys.key_of("a program") != made


def test_file_changed_since_the_import(folder, ours, monkeypatch):
    monkeypatch.setattr(program_keys, "_IMPORTED", 0.0)
    np.testing.assert_array_equal(
        _programs.cached(ours.by_factor)(jnp.asarray(X)), 3.0 * X
    )
    assert not files(folder)


def test_file_put_in_place_with_its_old_date(tmp_path, monkeypatch):
    """As `rsync -t` does: when it was written is long ago, and yet it is another."""
    monkeypatch.setattr(program_keys, "_HERE", tmp_path)
    monkeypatch.setattr(program_keys, "_IMPORTED", time.time() - 60.0)
    (tmp_path / "a.py").write_text("x = 1")
    os.utime(tmp_path / "a.py", (0, 0))
    with pytest.raises(program_keys.Unknown):
        program_keys.code_of_jentry()


def test_what_equinox_does_of_errors_counts(ours, monkeypatch):
    made = program_keys.key_of("a program")
    monkeypatch.setenv("EQX_ON_ERROR", "off")
    assert made != program_keys.key_of("a program")


def test_source_and_settings_count(ours, monkeypatch):
    made = program_keys.key_of("a program")
    assert made == program_keys.key_of("a program")
    with jax.numpy_rank_promotion("allow"):
        assert made != program_keys.key_of("a program")
    monkeypatch.setattr(program_keys, "_versions", lambda: "jax 0")
    assert made != program_keys.key_of("a program")
    monkeypatch.undo()
    with monkeypatch.context() as patched:
        patched.setattr(program_keys, "cores", lambda: 3 * [None])
        assert made != program_keys.key_of("a program")
    monkeypatch.setattr(program_keys, "_digest_of_files", lambda files: "other")
    assert made != program_keys.key_of("a program")


def test_every_file_counts(tmp_path, monkeypatch):
    """One more letter in one of them, or another name for it."""
    monkeypatch.setattr(program_keys, "_HERE", tmp_path)
    monkeypatch.setattr(program_keys, "_IMPORTED", float("inf"))
    digests = set()
    for name, text in [("a.py", "x = 1"), ("a.py", "x = 2"), ("b.py", "x = 2")]:
        for old in tmp_path.iterdir():
            old.unlink()
        (tmp_path / name).write_text(text)
        program_keys._digest_of_files.cache_clear()
        digests.add(program_keys.code_of_jentry())
    program_keys._digest_of_files.cache_clear()
    assert len(digests) == 3


class Mine(eqx.Module):
    x: jax.Array


def mine(x):
    return 2.0 * x


@pytest.mark.parametrize(
    "of_my_own", [lambda x: 2.0 * x, mine], ids=["lambda", "function"]
)
def test_functions_of_the_users_own_are_not_cached(folder, of_my_own):
    out = _programs.cached(of_my_own)(jnp.asarray(X))
    np.testing.assert_array_equal(out, 2.0 * X)
    assert not files(folder)


@pytest.mark.parametrize(
    "given",
    [Mine(jnp.ones(2)), mine, Mine, np.ones(2), object()],
    ids=["module", "function", "class", "array of numpy", "object"],
)
def test_what_cannot_be_told(given):
    leaves, structure = jax.tree.flatten(((given,), {}))
    with pytest.raises(program_keys.Unknown):
        program_keys.description_of(_math.horner, leaves, structure)


def test_arrays_on_a_device_of_their_own(folder, ours):
    x = jax.device_put(jnp.asarray(X), jax.devices()[0])
    np.testing.assert_array_equal(_programs.cached(ours.by_factor)(x), 3.0 * X)
    assert not files(folder)


def test_inside_of_other_functions(folder, ours):
    sine = _programs.cached(ours.sine)
    x = jnp.asarray(X)
    np.testing.assert_allclose(jax.jit(sine)(x), np.sin(X), rtol=1e-14)
    np.testing.assert_allclose(
        jax.grad(lambda x: jnp.sum(sine(x)))(x), np.cos(X), rtol=1e-14
    )
    assert not files(folder)


def test_where_jax_looks_on(folder, ours):
    with jax.debug_nans(True), pytest.raises(FloatingPointError):
        _programs.cached(ours.by_factor)(jnp.asarray([np.nan]))
    with jax.disable_jit():
        _programs.cached(ours.sine)(jnp.asarray(X))
    assert not files(folder)


def test_what_warns_is_not_cached(folder, ours):
    """It would be said in the first process, and in no other."""
    with pytest.warns(UserWarning, match="of this"):
        _programs.cached(ours.warns)(jnp.asarray(X))
    assert not files(folder)


def test_errors_are_the_functions_own(folder, ours):
    with pytest.raises(ValueError, match="x is what it is"):
        _programs.cached(ours.fails)(jnp.asarray(X))
    assert not files(folder)


@pytest.mark.parametrize(
    "harm",
    [
        lambda sound: b"",
        lambda sound: sound[:-1],
        lambda sound: sound[:200] + bytes([sound[200] ^ 1]) + sound[201:],
        lambda sound: b"not a program",
    ],
    ids=["empty", "cut", "a letter", "other"],
)
def test_damaged_file(folder, ours, harm):
    x = jnp.asarray(X)
    _programs.cached(ours.by_factor)(x)
    (file,) = files(folder)
    sound = file.read_bytes()
    file.write_bytes(harm(sound))
    np.testing.assert_array_equal(_programs.cached(ours.by_factor)(x), 3.0 * X)
    assert len(ours.TRACED) == 2
    np.testing.assert_array_equal(_programs.cached(ours.by_factor)(x), 3.0 * X)
    assert len(ours.TRACED) == 2


def test_folder_that_cannot_be(folder, ours):
    folder.write_text("a file in its place")
    np.testing.assert_array_equal(
        _programs.cached(ours.by_factor)(jnp.asarray(X)), 3.0 * X
    )


def test_what_nobody_asks_for_is_removed(folder, ours):
    x = jnp.asarray(X)
    _programs.cached(ours.sine)(x)
    _programs.cached(ours.cosine)(x)
    old, young = sorted(files(folder), key=lambda file: "cosine" in file.name)
    for file in (old, young):
        os.utime(file, (time.time() - 61 * 86400,) * 2)
    _programs.cached(ours.cosine)(x)  # asked for: young again
    _programs.cached(ours.times)(x)
    assert not old.exists() and young.exists() and len(files(folder)) == 2


def test_nowhere_before_setup(ours):
    assert _setup.programs_directory() is None
    _programs.cached(ours.by_factor)(jnp.asarray(X))


CAMPAIGN = """
import sys, jentry
jentry.setup(workers=2)
import jax, numpy as np
spent = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, seconds, **more: spent.append(seconds) if "jaxpr_trace" in name else None
)
mission = jentry.find_mission("mars-drag-tracking")
scenario = mission.scenario()
campaign = jentry.monte_carlo(scenario, mission.dispersion_table(), jax.random.key(1), 3)
np.save(sys.argv[1], np.array([campaign.flights.state.altitude, campaign.flights.time]))
print(sum(spent))
"""


@pytest.mark.slow
def test_next_process_traces_no_flight(tmp_path):
    environment = {**os.environ, "JENTRY_CACHE": str(tmp_path / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    spent = []
    for run in range(2):
        command = [sys.executable, "-c", CAMPAIGN, str(tmp_path / f"{run}.npy")]
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        )
        spent.append(float(done.stdout))
    names = [file.name.split("-")[0] for file in files(tmp_path / "cache" / "programs")]
    assert sorted(names) == ["mapped", "plan"]
    first, second = (np.load(tmp_path / f"{run}.npy") for run in range(2))
    np.testing.assert_array_equal(first, second)
    assert spent[1] < 0.2 * spent[0]
