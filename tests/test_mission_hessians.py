"""Second derivatives of the miss of a whole mission, against differences of the first."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.flight import fly, misses
from jentry.missions import find_mission


def gains(scenario):
    """The six gains of drag tracking."""
    law = scenario.guidance
    error, observer = law.gains, law.observer
    return (
        error.epsilon0,
        error.a,
        error.b,
        observer.epsilon,
        observer.l1,
        observer.l2,
    )


@pytest.mark.slow
def test_second_derivatives_of_a_miss():
    """To 1e-5 of the largest: what a difference of gradients has of rounding and order."""
    scenario = find_mission("mars-drag-tracking").scenario_of("table-3")
    # Off the nominal density, since on the reference itself no gain matters.
    scenario = eqx.tree_at(
        lambda s: s.planet.density_scale, scenario, jnp.asarray(1.02)
    )
    start, step = jnp.stack(gains(scenario)), 2e-3  # relative

    def miss(factors):
        varied = eqx.tree_at(gains, scenario, tuple(start * factors))
        return misses(varied, fly(varied)).downrange

    @jax.jit
    def forward_over_reverse(factors, direction):
        """The gradient, and how it changes in a direction: one program for both."""
        return jax.jvp(jax.grad(miss), (factors,), (direction,))

    one, nothing = jnp.ones_like(start), jnp.zeros_like(start)
    gradient = lambda factors: forward_over_reverse(factors, nothing)[0]
    hessian = np.stack(
        [forward_over_reverse(one, h)[1] for h in jnp.eye(start.size)], axis=-1
    )
    columns = [
        (
            8 * (gradient(one + h) - gradient(one - h))
            - (gradient(one + 2 * h) - gradient(one - 2 * h))
        )
        / (12 * step)
        for h in step * np.eye(start.size)
    ]
    expected = np.stack(columns, axis=-1)
    largest = np.abs(expected).max()
    assert largest > 1e-2
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=1e-7 * largest)
    np.testing.assert_allclose(hessian, expected, rtol=0, atol=1e-5 * largest)
