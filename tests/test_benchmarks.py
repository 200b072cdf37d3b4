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


@pytest.mark.slow
def test_the_program_in_c_flies_the_same_flights_in_space(benchmark, monkeypatch):
    """By the same steps, so that both err alike, by a third of a metre.

    The planet of jentry turns, at a rate of zero.
    """
    try:
        programs = benchmark.available_programs(space=True)
    except benchmark.comparators.NoCProgramError as error:
        pytest.skip(str(error))
    assert {p.name.split(",")[0] for p in programs} == {"jentry", "C"}
    monkeypatch.setattr(jentry, "setup", lambda *how, **options: None)
    given = *benchmark.jentry_mission(), benchmark.draw_inputs(3), 0.1, 1e-8, True
    problem = benchmark.Problem(*given)
    ours = benchmark.prepare_jentry(problem, jax.device_count(), fast=False)()
    by_c = np.array(benchmark.prepare_c(problem, 1)())
    np.testing.assert_allclose(ours, by_c, rtol=0, atol=1e-4)
    np.testing.assert_allclose(by_c, benchmark.true_ends(problem), rtol=0, atol=0.5)
    # Due east all the way it would come as far as in the plane, 4 km farther.
    in_plane = benchmark.prepare_c(problem._replace(space=False), 1)()
    assert np.all(np.abs(by_c - in_plane)[2] > 3e3)


def test_a_program_that_flies_something_else_ends_the_benchmark(benchmark):
    programs = benchmark.PROGRAMS[:2]
    benchmark.check_errors(programs, [0.01, 0.02])
    for wrong in (90e3, float("nan")):
        with pytest.raises(SystemExit, match="^jentry ends .* it flies something else"):
            benchmark.check_errors(programs, [0.01, wrong])


def test_the_program_in_c_flies_as_scipy_does(benchmark, monkeypatch):
    """Eleven flights: a full vector, whose places the others take, and some left over."""
    comparators = benchmark.comparators
    try:
        comparators.c_program(space=False)
    except comparators.NoCProgramError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(jentry, "setup", lambda *how, **options: None)
    given = benchmark.jentry_mission()
    inputs = benchmark.draw_inputs(11)
    ends = np.array(comparators.c_flights(*given, **inputs))
    two = {name: values[:2] for name, values in inputs.items()}
    truth = np.array(comparators.scipy_flights(*given, **two, tolerance=1e-8))
    np.testing.assert_allclose(ends[1:3, :2], truth[1:3], rtol=0, atol=0.05)
    np.testing.assert_allclose(ends[[0, 3], :2], truth[[0, 3]], rtol=0, atol=1e-4)
    # One ends at the velocity, the other at the altitude.
    mission, reference = given
    assert abs(ends[3, 0] - mission.end_velocity) < 1e-6
    assert abs(ends[1, 1] - mission.end_altitude) < 1e-6
    # Neither its place nor its thread makes a difference to a flight.
    np.testing.assert_array_equal(
        comparators.c_flights(*given, **inputs, threads=2), ends
    )
    last = {name: values[-1:] for name, values in inputs.items()}
    np.testing.assert_array_equal(comparators.c_flights(*given, **last), ends[:, -1:])
    # Out of time, as those of scipy are.
    given = mission._replace(time_limit=60.0), reference
    ends = np.array(comparators.c_flights(*given, **two))
    truth = np.array(comparators.scipy_flights(*given, **two, tolerance=1e-8))
    np.testing.assert_allclose(ends, truth, rtol=0, atol=0.05)


def test_a_part_of_the_navigation_that_does_not_exist_is_refused(monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    import navigation

    monkeypatch.setattr(sys, "argv", ["navigation.py", "linaer"])
    with pytest.raises(SystemExit):
        navigation.main()
    assert "no such part: ['linaer']" in capsys.readouterr().err


def test_saved_tables_of_the_navigation_are_of_its_parts(monkeypatch):
    """A miss that navigation alone makes is as large as its error (issue 43: to 5 %)."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    import navigation
    import records

    tables = records.load(navigation.SAVED)
    assert {name.split(",")[0] for name in tables} <= set(navigation.PARTS)
    law = tables["miss, predictor-corrector"].cells
    ratios = [x.value for x in law if x.column == "miss over navigation error"]
    np.testing.assert_allclose(ratios, [1.0, 1.0], atol=0.05)
