"""`setup`, an explicit call that sets precision, cores, cache and XLA options."""

import contextlib
import contextvars
import functools
import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import ParamSpec, TypeVar


P = ParamSpec("P")
R = TypeVar("R")


_LOOPS = "xla_cpu_small_while_loop_byte_threshold=100000000"
"""Compiles a loop as one function instead of a list of operations that are called one by
one: flights are twice as fast (`benchmarks/monte_carlo.py`), and reverse gradients too
(`benchmarks/gradient.py`)"""

_FUSION = "xla_cpu_use_multi_output_fusion"
"""Gives a quarter more flights per second in the plane over a table, and no more in other
missions. Reverse gradients take twice as long with it, and some programs cannot be
compiled"""

_WIDTH = "--xla_cpu_prefer_vector_width=512"
"""Gives a sixth more flights per second on processors that have such vectors"""

_EXTRA = "--xla_backend_extra_options="

_SELF_TEST = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
def body(c):
    i, x, y = c
    return i + 1, x + 1e-3 * jnp.sin(y) * x, y - 1e-3 * jnp.exp(-x) * y
i, x, y = jax.jit(lambda x, y: jax.lax.while_loop(lambda c: c[0] < 1000, body, (0, x, y)))(
    jnp.linspace(0.5, 1.5, 64), jnp.linspace(1.0, 2.0, 64))
import numpy as np
a, b = np.linspace(0.5, 1.5, 64), np.linspace(1.0, 2.0, 64)
for _ in range(1000):
    a, b = a + 1e-3 * np.sin(b) * a, b - 1e-3 * np.exp(-a) * b
assert np.allclose(x, a, rtol=1e-12) and np.allclose(y, b, rtol=1e-12)
"""


def cache_directory() -> Path:
    """Folder in which programs are cached: `JENTRY_CACHE`, or the user's cache folder.

    Cached programs are run without a check: no other user may be able to write there.
    """
    given = os.environ.get("JENTRY_CACHE")
    if given and not os.path.isabs(given):
        raise ValueError(
            f"JENTRY_CACHE is {given!r}: programs are run from there, and it must be an "
            "absolute path, which does not depend on the folder in which jentry starts"
        )
    if given:
        return Path(given)
    base = Path(os.environ.get("XDG_CACHE_HOME") or "")
    # By the XDG specification relative paths are ignored: programs are run from here.
    return (base if base.is_absolute() else Path.home() / ".cache") / "jentry"


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def setup(
    workers: int | None = None,
    *,
    fast: bool = False,
    cache: bool = True,
    device: str | None = None,
) -> None:
    """Set how jentry computes. Call it first, before any array is made.

    Importing jentry changes no global setting. This function changes settings of the whole
    process: float64, one CPU device for each worker, JAX's persistent compilation cache,
    and in `XLA_FLAGS` the options of XLA that make long loops twice as fast on a CPU. These
    options are not documented: a separate process tests them first, once for each version
    of JAX, and they are left off with a warning if the test fails. The environment variable
    `JENTRY_FAST=0` leaves them off, which changes results by rounding.

    **Arguments:**

    - `workers`: number of cores for batches of flights; the default is all that are
      available.
    - `fast`: turn on one more XLA option, which gives up to a quarter more flights per
      second in large campaigns. Gradients are slower with it. XLA cannot compile the
      `Adaptive` solver, and possibly other programs.
    - `cache`: cache compiled and traced programs in `cache_directory()`: the next process
      neither compiles nor traces them again. Every process traces programs that contain a
      law, an atmosphere or a function of your own.
    - `device`: "cpu" or "gpu" flies all batches of runs there. By default a GPU flies
      batches of 16 384 runs and more, where there is one. Single flights and planning run
      on the CPU. A GPU needs `jentry[cuda]`.

    **Raises:** `RuntimeError` if JAX has been used before with other settings, and for a
    GPU where JAX finds none.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers is {workers}: it must be at least 1")
    if os.environ.get("JENTRY_FAST") != "0":
        _turn_on(_LOOPS, *([_FUSION] if fast else []), remember=cache)

    import jax

    workers = available_cores() if workers is None else workers
    try:
        jax.config.update("jax_num_cpu_devices", workers)
    except RuntimeError as error:
        if jax.local_device_count("cpu") != workers:
            raise RuntimeError(
                f"JAX has started with {jax.local_device_count('cpu')} CPU devices, and "
                f"setup asks for {workers}: call jentry.setup() before anything that "
                "makes an array"
            ) from error
    jax.config.update("jax_enable_x64", True)
    if cache:
        directory = cache_directory() / "compiled"
        jax.config.update("jax_compilation_cache_dir", str(directory))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    global _PROGRAMS
    _PROGRAMS = cache_directory() / "programs" if cache else None
    from ._devices import choose, has_plugin

    if has_plugin():
        # A GPU would be the default, for single flights and planning as well.
        jax.config.update("jax_default_device", "cpu")
    choose(device)


_PROGRAMS: Path | None = None
"""Folder of traced programs; None before `setup`"""


def programs_directory() -> Path | None:
    """Folder of traced programs; None if they are not cached."""
    return _PROGRAMS


_SAID: contextvars.ContextVar[bool] = contextvars.ContextVar("_SAID", default=False)
"""Whether a caller of the running function has already checked for float64"""


def needs_float64(function: Callable[P, R]) -> Callable[P, R]:
    """Make a public function warn, with its name, if float64 is off.

    If such functions call one another, only the outermost one warns.
    """

    @functools.wraps(function)
    def looking(*given: P.args, **options: P.kwargs) -> R:
        if _SAID.get():
            return function(*given, **options)
        _warn_without_float64(function.__qualname__)
        token = _SAID.set(True)
        try:
            return function(*given, **options)
        finally:
            _SAID.reset(token)

    return looking


def _warn_without_float64(name: str) -> None:
    import warnings

    import jax

    if not jax.config.read("jax_enable_x64"):
        warnings.warn(
            f"{name}: float64 is off, and guidance far up in the atmosphere needs it: "
            "call jentry.setup() before anything else",
            stacklevel=3,
        )


def xla_options() -> list[str]:
    """Options of XLA that are on in this process, among those that `setup` turns on."""
    flags = os.environ.get("XLA_FLAGS", "")
    return [option for option in (_LOOPS, _FUSION) if option in flags]


def fast_options_are_on() -> bool:
    """Whether this process compiles with the option of `setup(fast=True)`."""
    return _FUSION in xla_options()


def _turn_on(*options: str, remember: bool) -> None:
    """Set options of XLA for this process, if they work and JAX has not started."""
    if set(options) <= set(xla_options()):
        return
    flags = os.environ.get("XLA_FLAGS", "").split()
    ours = {_WIDTH, _EXTRA + _LOOPS}
    others = [flag for flag in flags if flag not in ours]
    if any(flag.startswith(_EXTRA) for flag in others):
        _warn(f"XLA_FLAGS has {_EXTRA.rstrip('=')} of its own")
        return
    if _jax_has_begun():
        _warn("JAX has compiled without them: call jentry.setup() before anything else")
        return
    wanted = " ".join([*others, _WIDTH, _EXTRA + ",".join(options)])
    failure = _failure_where_new(wanted, remember)
    if failure is None:
        os.environ["XLA_FLAGS"] = wanted
    else:
        _warn(f"their self-test failed ({failure})")


def _jax_has_begun() -> bool:
    if "jax" not in sys.modules:
        return False
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def _failure_where_new(flags: str, remember: bool) -> str | None:
    """Reason why these flags do not work; None if they do, or did in an earlier test."""
    told = [flags, _SELF_TEST, version("jax"), version("jaxlib"), processor()]
    digest = hashlib.sha256("\n".join(told).encode()).hexdigest()
    passed = cache_directory() / "self-tests" / digest
    if passed.exists():
        return None
    failure = _failure_of_self_test({**os.environ, "XLA_FLAGS": flags})
    if failure is None and remember:
        with contextlib.suppress(OSError):  # a folder that is not writable
            passed.parent.mkdir(parents=True, exist_ok=True)
            passed.touch()
    return failure


def processor() -> str:
    """Description of the processor, as far as the system reports it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    told = {line for line in lines if line.startswith(("model name", "flags", "CPU"))}
    return "\n".join(sorted(told))


def _failure_of_self_test(environment: dict[str, str]) -> str | None:
    """Reason why the options of an environment do not work; None if they do.

    The test process is isolated from the working folder, which may contain a `jax.py`. It
    imports from the places of this process, without relative ones.
    """
    places = json.dumps([place for place in sys.path if os.path.isabs(place)])
    command = [sys.executable or "", "-I", "-c", _SELF_TEST, places]
    try:
        test = subprocess.run(
            command,
            env={**environment, "JAX_PLATFORMS": "cpu"},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
        )
    except OSError as error:  # no executable, as in an embedded interpreter
        return str(error)
    if test.returncode == 0:
        return None
    said = test.stderr.strip().splitlines()
    return said[-1] if said else f"exit code {test.returncode}"


def _warn(reason: str) -> None:
    import warnings

    warnings.warn(
        f"the fast XLA options stay off: {reason}. Flights are as exact, and about half "
        "as many a second",
        stacklevel=4,
    )
