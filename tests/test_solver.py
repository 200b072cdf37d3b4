"""One step of the fixed-step solver, and how many of them a cycle takes."""

import dataclasses
import math

import cheap
import diffrax
import jax.numpy as jnp
import pytest

from jentry.flight import FixedStep
from jentry.flight.cycle import Plan
from jentry.flight.solver import RungeKutta4


def one(x):
    return jnp.asarray(x, dtype=float)


def test_a_step_is_that_of_the_classical_method():
    h = 0.7
    solver = FixedStep(1.0, RungeKutta4())
    # y' = y: the exponential series up to the fourth power.
    grown = solver.advance(lambda t, y: y, one(3.0), one(h), one(2.0))
    series = 1.0 + h + h**2 / 2.0 + h**3 / 6.0 + h**4 / 24.0
    assert float(grown) == pytest.approx(2.0 * series, rel=1e-14)
    # y' = t^3: Simpson's rule, which is exact for it, at the time of the step.
    moved = solver.advance(lambda t, y: t**3, one(3.0), one(h), one(2.0))
    exact = 2.0 + ((3.0 + h) ** 4 - 3.0**4) / 4.0
    assert float(moved) == pytest.approx(exact, rel=1e-14)
    # y' = t y, by hand: the time and the stage together.
    both = solver.advance(lambda t, y: t * y, one(1.0), one(0.2), one(1.0))
    k1 = 1.0
    k2 = 1.1 * (1.0 + 0.1 * k1)
    k3 = 1.1 * (1.0 + 0.1 * k2)
    k4 = 1.2 * (1.0 + 0.2 * k3)
    expected = 1.0 + 0.2 * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0
    assert float(both) == pytest.approx(expected, rel=1e-14)


def test_the_steps_of_a_cycle_divide_it_and_are_no_longer_than_asked_for():
    cases = ((0.1, 1.0, 10), (0.3, 1.0, 4), (1.0, 1.0, 1), (2.0, 1.0, 1), (0.1, 0.3, 3))
    for step, duration, steps in cases:
        assert FixedStep(step).steps_in(duration) == steps


def test_a_scenario_may_have_a_step_of_its_own():
    """It is that of a solver that has none; the first step of the plan says which."""
    own = dataclasses.replace(cheap.scenario(), step=0.25)
    for solver, step in ((FixedStep(), 0.25), (FixedStep(0.5), 0.5)):
        assert Plan.of(own, solver, None).step == pytest.approx(step, rel=1e-14)
    assert Plan.of(cheap.scenario(), FixedStep(), None).step == pytest.approx(0.1)
    for wrong in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match="must be positive and finite"):
            dataclasses.replace(cheap.scenario(), step=wrong)


def test_a_step_that_is_given_stays():
    assert FixedStep(0.3).or_step(0.1).step == 0.3
    method = diffrax.Heun()
    filled = FixedStep(method=method).or_step(0.1)
    assert filled.step == 0.1 and filled.method is method
