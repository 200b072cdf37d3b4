"""One explicit call that settles precision, cores, compilation cache and XLA options."""

import contextvars
import functools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar


P = ParamSpec("P")
R = TypeVar("R")


_FAST_OPTIONS = (
    "xla_cpu_use_multi_output_fusion",
    "xla_cpu_small_while_loop_byte_threshold=100000000",
)

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
    """Where programs are kept: `JENTRY_CACHE`, or the user's cache folder.

    They are run as they are found: it must be a folder in which nobody else can write.
    """
    given = os.environ.get("JENTRY_CACHE")
    if given and not os.path.isabs(given):
        raise ValueError(
            f"JENTRY_CACHE is {given!r}: programs are run from there, and it must be an "
            "absolute path, not one below whatever folder jentry is started in"
        )
    if given:
        return Path(given)
    base = Path(os.environ.get("XDG_CACHE_HOME") or "")
    # The specification of XDG has a relative path ignored: programs are run from here.
    return (base if base.is_absolute() else Path.home() / ".cache") / "jentry"


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def setup(
    workers: int | None = None, *, fast: bool = False, cache: bool = True
) -> None:
    """Settle how jentry computes. Call it first, before any array is made.

    Importing jentry changes no global setting; this does, for the whole process: float64,
    one CPU device for each worker, and JAX's persistent compilation cache.

    **Arguments:**

    - `workers`: cores for batches of flights; all that are available if not given.
    - `fast`: XLA options, two of them undocumented, that multiply the speed of long
      loops on a CPU and double the time to compile them: for large campaigns. They are
      tried in a process of their own first, and left off with a warning if that fails.
      An environment with `JENTRY_FAST=0` keeps them off. XLA cannot compile the
      `Adaptive` solver with them.
    - `cache`: keep compiled programs in `cache_directory()`, and what was traced for them:
      the next process compiles and traces nothing of what this one has. Programs with a
      law, an atmosphere or a function of your own in them are traced by every process.

    **Raises:** `RuntimeError` if JAX has been used before with other settings.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers is {workers}: it must be at least 1")
    if fast and os.environ.get("JENTRY_FAST") != "0":
        _turn_on_fast_options()

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


_PROGRAMS: Path | None = None
"""Where programs are kept that need not be traced again; nowhere before `setup`"""


def programs_directory() -> Path | None:
    """Where programs are kept that need not be traced again, if they are."""
    return _PROGRAMS


_SAID: contextvars.ContextVar[bool] = contextvars.ContextVar("_SAID", default=False)
"""Whether what is running has been called by a function that has looked for float64"""


def needs_float64(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function of the public face warn, by its name, where float64 is off.

    Of functions that call one another the outermost warns, and no other.
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


def fast_options_are_on() -> bool:
    """Whether this process compiles with the options of `setup(fast=True)`."""
    return _FAST_OPTIONS[0] in os.environ.get("XLA_FLAGS", "")


def _turn_on_fast_options() -> None:
    if fast_options_are_on():
        return
    flags = os.environ.get("XLA_FLAGS", "")
    extra = f"--xla_backend_extra_options={','.join(_FAST_OPTIONS)}"
    wanted = f"{flags} --xla_cpu_prefer_vector_width=512 {extra}".strip()
    if "xla_backend_extra_options" in flags:
        _warn("XLA_FLAGS has --xla_backend_extra_options of its own")
        return
    environment = {**os.environ, "XLA_FLAGS": wanted, "JAX_PLATFORMS": "cpu"}
    failure = _failure_of_self_test(environment)
    if failure is None:
        os.environ["XLA_FLAGS"] = wanted
    else:
        _warn(f"their self-test failed ({failure})")


def _failure_of_self_test(environment: dict[str, str]) -> str | None:
    """Why the options do not work here; none where they do.

    The process is isolated from the working folder, in which a `jax.py` may lie, and
    imports from where this one does: places that are relative are left out.
    """
    places = json.dumps([place for place in sys.path if os.path.isabs(place)])
    command = [sys.executable or "", "-I", "-c", _SELF_TEST, places]
    try:
        test = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
        )
    except OSError as error:  # no interpreter of its own, as in an embedded one
        return str(error)
    if test.returncode == 0:
        return None
    said = test.stderr.strip().splitlines()
    return said[-1] if said else f"exit code {test.returncode}"


def _warn(reason: str) -> None:
    import warnings

    warnings.warn(
        f"the fast XLA options stay off: {reason}. Flights are as exact, and about a "
        "quarter as many a second",
        stacklevel=4,
    )
