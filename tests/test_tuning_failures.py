"""Flights that fail are counted, and left out of the loss and of its gradient."""

import functools

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cheap_tuning import (
    ADDRESS,
    KEY,
    OPTIMIZERS,
    RUNS,
    SIMULATION,
    bank,
    scenario,
    tuned,
)

from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.guidance import AbstractContinuousLaw
from jentry.motion import Controls
from jentry.parameters.parameters import Parameters
from jentry.tuning.batch_gradients import Problem, batch_gradient, batch_outputs
from jentry.units import degree


pytestmark = pytest.mark.optimized  # of few programs each flies thousands of flights


class Fragile(AbstractContinuousLaw[None]):
    """A bank angle (rad) that is no number for a light or an overloaded vehicle."""

    bank_angle: jax.Array
    limit: jax.Array

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        broken = measurement.drag > self.limit
        bank_angle = jnp.where(broken, jnp.nan, self.bank_angle)
        return Controls(
            0.0 * self.bank_angle, jnp.cos(bank_angle), jnp.sin(bank_angle)
        ), None


def fragile(most):
    law = Fragile(jnp.asarray(50 * degree), jnp.asarray(most))
    return eqx.tree_at(lambda s: s.guidance, scenario(), law)


def density():
    where = lambda s: s.planet.density_scale
    return {"density": Dispersion(where, Uniform(0.8, 1.2))}


@functools.cache
def limit():
    """m/s2, which half of the flights exceed"""
    campaign = monte_carlo(scenario(), density(), KEY, RUNS, solver=cheap.SOLVER)
    return float(np.median(campaign.flights.peaks.drag))


@pytest.mark.optimized(False)
@pytest.mark.slow
@pytest.mark.parametrize("forward", [True, False])
def test_flights_that_fail_do_not_poison_the_gradient(forward):
    """It is the gradient of the others alone."""
    start = fragile(limit())
    parameters = Parameters.of(start, bank)
    problem = Problem(parameters, SIMULATION)
    free = parameters.zeros()
    inputs = {"planet.density_scale": jnp.linspace(0.8, 1.2, 64)}
    outputs, finite = batch_outputs(SIMULATION, start, inputs)
    assert 4 < int(jnp.sum(finite)) < 60
    nothing = jax.tree.map(jnp.zeros_like, outputs)
    weights = eqx.tree_at(lambda w: w.downrange, nothing, jnp.where(finite, 1.0, 0.0))
    found = batch_gradient(problem, free, inputs, weights, forward)

    others = jnp.where(finite, inputs["planet.density_scale"], 0.8)
    sound = {"planet.density_scale": others}
    expected = batch_gradient(problem, free, sound, weights, forward)
    np.testing.assert_allclose(
        found.total[ADDRESS], expected.total[ADDRESS], rtol=1e-12
    )
    assert int(found.counted) == int(jnp.sum(finite))
    assert int(found.failed) == int(expected.failed) == 0


@pytest.mark.optimized(False)
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name == "adam" else pytest.mark.slow)
        for name in OPTIMIZERS
    ],
)
def test_flights_that_fail_are_counted_and_left_out(name):
    start = fragile(limit())
    result = tuned(name, start=start, table=density(), steps=5)
    failed = [entry.failed for entry in result.course]
    assert 0 < failed[0] < RUNS
    assert failed[result.best] == min(failed)
    assert np.isfinite(result.course[0].loss)
    assert result.judgement.not_finite_before > 0


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_none_that_flies_is_an_error():
    with pytest.raises(ValueError, match="32 flights of which an output is not finite"):
        tuned(start=fragile(1e-6), table=density())
