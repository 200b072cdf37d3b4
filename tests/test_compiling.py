"""Tests are compiled with little optimization, or as users have it, and fly the same."""

import os

import cheap
import compiling
import jax
import numpy as np
import pytest
from helpers import fly_compiled
from jax._src import compiler


LEVEL = "--xla_backend_optimization_level=0"


@pytest.mark.optimized
def test_what_is_marked_is_compiled_as_users_have_it():
    assert compiler.get_compile_options.__module__ == compiler.__name__
    assert LEVEL not in os.environ.get("XLA_FLAGS", "")


@pytest.mark.skipif("not compiling.little()", reason="XLA does not know the options")
def test_what_is_not_marked_is_compiled_with_little_optimization():
    options = compiler.get_compile_options(1, 1)
    names = {name for name, _ in options.env_option_overrides}
    assert names == set(compiling.LITTLE)
    # As do the commands that tests start.
    assert LEVEL in os.environ["XLA_FLAGS"]


def test_a_flight_is_the_same_but_for_rounding():
    flown = {}
    for much in (True, False):
        compiling.optimize(much)
        flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
        flown[much] = jax.tree.map(np.asarray, (flight.time, flight.state))
    # Over 300 steps, in a flight that does not amplify it.
    close = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)
    jax.tree.map(close, flown[True], flown[False])
