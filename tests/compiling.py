"""How the programs of a test are compiled.

Most of the time of the tests is the compiler's. With little optimization it needs less
than half of that, while batches of flights take three to five times as long and round
otherwise, in the last digits. So a test has little, unless it is marked `optimized`: one
that compares bits, or what the compiler may reorder, one that says what is published, and
one that flies thousands of flights.

A campaign is one program for many batches of runs, with a loop over them; without it the
same flights are compiled in two thirds of the time: bit for bit as users have it
(`test_monte_carlo.py`), while with little optimization they round otherwise. So a test
flies batch by batch, unless it is marked `batches`: one that compares bits with those of
another process, or counts the parts of a campaign.

What a program with little optimization computes twice is taken out before the compiler sees
it, which does so late: of 40 tests of derivatives and of `cav-h`, 175 s, that spares 6.

Twice a program with little optimization was wrong: second derivatives of `cav-h`, with the
density as an argument, are NaN, and not where the same operations run one by one, nor with
optimization, nor with the fusion emitters that are left out here; and so is its gradient
in reverse where XLA's pass `reshape-mover` is left out, and not forward, nor without
fusion, nor with optimization. So all passes that change a program are run, and one that is
not finite, or not what it must be, is looked at as users compile it first.
"""

import contextlib
import functools
import os

import jax
from jax._src import compiler
from jax._src.interpreters import mlir
from jax._src.lib.mlir import ir
from jaxlib.mlir.passmanager import PassManager


LITTLE = {
    # Without these a program takes more than twice as long.
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
    "xla_cpu_use_fusion_emitters": False,
    # And without these a fifth longer (20 programs 32.3 s of a core, and not 26.8): parts
    # for several cores, and what the optimizer could know. The verifier looks at what each
    # pass has made of a program; it is there for those that users have.
    "xla_cpu_parallel_codegen_split_count": 1,
    "xla_llvm_enable_alias_scope_metadata": False,
    "xla_llvm_enable_noalias_metadata": False,
    "xla_llvm_enable_invariant_load_metadata": False,
    "xla_disable_hlo_passes": "hlo-verifier",
}

_make_ir_context = mlir.make_ir_context
_one_ir_context = functools.cache(_make_ir_context)


def _ir_context() -> ir.Context:
    """What a program is written in, the same for all of them.

    JAX makes another for each, and keeps it as long as the program: a megabyte, which takes
    as long to make as to write a small program, and longer the more of them there are. One
    that is computed while another is written has to have its own.
    """
    return _make_ir_context() if ir.Context.current else _one_ir_context()


mlir.make_ir_context = _ir_context

_get_compile_options = compiler.get_compile_options

_MUCH = jax.make_user_context(True)
"""Part of what JAX finds its programs by: it keeps those of both kinds"""


@functools.cache
def little() -> dict:
    """What this version of XLA knows of `LITTLE`: JAX 0.11 always has fusion emitters."""
    lowered = jax.jit(lambda: 0.0).lower()

    def knows(name: str) -> bool:
        try:
            lowered.compile(compiler_options={name: LITTLE[name]})
        except jax.errors.JaxRuntimeError:
            return False
        return True

    return {name: value for name, value in LITTLE.items() if knows(name)}


def _with_little(*how, env_options_overrides=None, **options):
    options["env_options_overrides"] = little() | (env_options_overrides or {})
    return _get_compile_options(*how, **options)


_compile = compiler.backend_compile_and_load


def _compile_once_each(backend, module, *how, **options):
    """In place of JAX's own, by which all programs are compiled that are not found."""
    if compiler.get_compile_options is _with_little:
        with module.context:
            passes = PassManager.parse("builtin.module(cse,canonicalize,cse)")
            passes.run(module.operation)
    return _compile(backend, module, *how, **options)


compiler.backend_compile_and_load = _compile_once_each


def optimize(much: bool) -> None:
    """Compile as users do, or with little optimization; commands that are started too."""
    chosen = _get_compile_options if much or not little() else _with_little
    if compiler.get_compile_options is chosen:
        return
    _MUCH.set_global(chosen is _get_compile_options)
    compiler.get_compile_options = chosen
    given = os.environ.get("XLA_FLAGS", "").split()
    flags = [f"--{name}={str(value).lower()}" for name, value in little().items()]
    kept = [flag for flag in given if flag not in flags]
    os.environ["XLA_FLAGS"] = " ".join(kept if much else kept + flags)


@contextlib.contextmanager
def little_optimized():
    """For what an `optimized` test compiles and runs once."""
    much = compiler.get_compile_options is not _with_little
    optimize(False)
    try:
        yield
    finally:
        optimize(much)


@functools.cache
def _batches_of_users() -> int:
    return _runner()._CHUNKS


def _runner():
    from jentry.campaign import batch  # not before its types are checked

    return batch


def loop_over_batches(many: bool) -> None:
    """Fly as many batches in one call as users do, or one."""
    users = _batches_of_users()
    _runner()._CHUNKS = users if many else 1
