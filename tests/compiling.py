"""How much XLA optimizes the programs of a test.

Most of the time of the tests is the compiler's. With little optimization it needs less
than half of that, while batches of flights take three to five times as long and round
otherwise, in the last digits. So a test has little, unless it is marked `optimized`: one
that compares bits, or what the compiler may reorder, one that says what is published, and
one that flies thousands of flights.
"""

import functools
import os

import jax
from jax._src import compiler


LITTLE = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
}

_get_compile_options = compiler.get_compile_options


@functools.cache
def little() -> dict:
    """`LITTLE`, or nothing where another version of XLA does not know it."""
    lowered = jax.jit(lambda: 0.0).lower()
    try:
        lowered.compile(compiler_options=LITTLE)
    except jax.errors.JaxRuntimeError:
        return {}
    return LITTLE


def _with_little(*how, env_options_overrides=None, **options):
    options["env_options_overrides"] = little() | (env_options_overrides or {})
    return _get_compile_options(*how, **options)


def optimize(much: bool) -> None:
    """Compile as users do, or with little optimization; commands that are started too."""
    chosen = _get_compile_options if much or not little() else _with_little
    if compiler.get_compile_options is chosen:
        return
    jax.clear_caches()
    compiler.get_compile_options = chosen
    given = os.environ.get("XLA_FLAGS", "").split()
    flags = [f"--{name}={str(value).lower()}" for name, value in LITTLE.items()]
    kept = [flag for flag in given if flag not in flags]
    os.environ["XLA_FLAGS"] = " ".join(kept if much else kept + flags)
