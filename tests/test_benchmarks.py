"""What the benchmarks compare: the same flights, by programs written without jentry."""

import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import jentry


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    import monte_carlo

    yield monte_carlo
    for name in ("monte_carlo", "comparators"):
        sys.modules.pop(name)


@pytest.mark.slow
def test_the_programs_that_are_compared_fly_the_same_flights(benchmark, monkeypatch):
    """A reference on another grid was once flown as if it were on an even one."""
    monkeypatch.setattr(jentry, "setup", lambda *how, **options: None)
    mission, reference = benchmark.jentry_mission()
    inputs = benchmark.draw_inputs(3)
    problem = benchmark.Problem(mission, reference, inputs, 0.1, 1e-8)
    truth = benchmark.true_ends(problem)
    ours = benchmark.prepare_jentry(problem, jax.device_count(), fast=False)()
    # Steps of 0.1 s cost millimetres; the mission itself lands 10 km high.
    np.testing.assert_allclose(ours[1:3], truth[1:3], rtol=0, atol=0.05)
    np.testing.assert_allclose(ours[3], truth[3], rtol=0, atol=1e-4)
    by_diffrax = np.array(benchmark.prepare_diffrax(problem, 1)())
    np.testing.assert_allclose(by_diffrax[1:3], truth[1:3], rtol=0, atol=0.5)


def test_a_program_that_flies_something_else_ends_the_benchmark(benchmark):
    programs = benchmark.PROGRAMS[:2]
    benchmark.check_errors(programs, [0.01, 0.02])
    for wrong in (90e3, float("nan")):
        with pytest.raises(SystemExit, match="^jentry ends .* it flies something else"):
            benchmark.check_errors(programs, [0.01, wrong])
