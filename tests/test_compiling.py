"""Tests are compiled with little optimization, or as users have it, and fly the same."""

import os

import cheap
import compiling
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled
from jax._src import compiler
from jax.extend.core import Primitive
from jax.interpreters import mlir

from jentry.campaign import batch


USERS = batch._CHUNKS
"""Before a test has been set up"""

LEVEL = "--xla_backend_optimization_level=0"


def test_what_is_not_marked_is_compiled_with_little_optimization():
    """And so is what the commands compile that tests start."""
    options = compiler.get_compile_options(1, 1).env_option_overrides
    assert {name for name, _ in options} == set(compiling.little())
    assert (LEVEL in os.environ.get("XLA_FLAGS", "")) == bool(compiling.little())


@pytest.mark.optimized(False)
def test_what_is_marked_not_to_be_is_not():
    test_what_is_not_marked_is_compiled_with_little_optimization()


@pytest.mark.optimized
def test_what_is_marked_is_compiled_as_users_have_it():
    assert not compiler.get_compile_options(1, 1).env_option_overrides
    assert LEVEL not in os.environ.get("XLA_FLAGS", "")


def test_a_campaign_flies_batch_by_batch():
    assert batch._CHUNKS == 1


@pytest.mark.batches
def test_what_is_marked_flies_as_many_in_a_call_as_users_do():
    assert batch._CHUNKS == USERS > 1


def test_programs_are_written_in_one_context():
    one, other = (jax.jit(f).lower(1.0) for f in (jax.numpy.sin, jax.numpy.cos))
    assert one.compiler_ir().context == other.compiler_ir().context


@pytest.mark.parametrize(
    "sines", [1, pytest.param(2, marks=pytest.mark.optimized)], ids=["little", "much"]
)
def test_what_is_computed_twice_is_taken_out_first(monkeypatch, sines):
    """Where little is optimized; users have it as JAX writes it."""
    written = lambda backend, module: str(module).count("stablehlo.sine")
    monkeypatch.setattr(compiling, "_compile", written)
    module = jax.jit(lambda x: jnp.sin(x) * jnp.sin(x)).lower(1.0).compiler_ir()
    found = compiler.backend_compile_and_load(None, module)
    assert found == (sines if compiling.little() else 2)


@pytest.mark.slow
def test_a_program_that_is_computed_while_another_is_written_is_whole():
    def plus_ten(x):
        with jax.ensure_compile_time_eval():
            return x + float(jax.jit(lambda: 10.0)())

    computed = Primitive("computed")
    computed.def_abstract_eval(lambda x: x)
    mlir.register_lowering(computed, mlir.lower_fun(plus_ten, multiple_results=False))
    assert float(jax.jit(computed.bind)(1.0)) == 11.0


@pytest.mark.slow
@pytest.mark.skipif("not compiling.little()", reason="XLA does not know the options")
def test_a_flight_is_the_same_but_for_rounding(monkeypatch):
    """Each is compiled, not found as the other left it, and then found again."""
    ends = []
    compiling.optimize(False)
    jax.clear_caches()
    for much in (True, False, True):
        compiling.optimize(much)
        asked, options = [], compiler.get_compile_options
        with monkeypatch.context() as patched:
            count = lambda *a, **k: asked.append(1) or options(*a, **k)  # noqa: B023
            patched.setattr(compiler, "get_compile_options", count)
            flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
        assert bool(asked) == (len(ends) < 2)
        ends.append(jax.tree.map(np.asarray, (flight.time, flight.state)))
        assert (LEVEL in os.environ["XLA_FLAGS"]) != much
    # Over 300 steps, in a flight that does not amplify it.
    close = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)
    jax.tree.map(close, *ends[:2])
    jax.tree.map(np.testing.assert_array_equal, *ends[::2])
