"""Minima under equations and bounds, against a closed form and against wrong beginnings."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from jentry.planning._constrained import NoOptimumError, minimise


RNG = np.random.default_rng(3)
WANTED = RNG.normal(size=12)
LOWER, UPPER = -0.5 * np.ones(12), 0.7 * np.ones(12)
TOTAL = 1.5


def distance(problem, x):
    return jnp.sum((x - problem["wanted"]) ** 2)


def total(problem, x):
    return jnp.sum(x)[None] - problem["total"]


def bent(problem, x):
    """The same set of x by another function, so that Newton's method has work to do."""
    return jnp.exp(jnp.sum(x)[None] - problem["total"]) - 1.0


PROBLEM = {"wanted": jnp.asarray(WANTED), "total": jnp.asarray([TOTAL])}


def filled():
    """x = clip(wanted + level) with the level by bisection: the conditions by hand."""
    level = scipy.optimize.brentq(
        lambda level: np.sum(np.clip(WANTED + level, LOWER, UPPER)) - TOTAL,
        -5.0,
        5.0,
        xtol=1e-15,
    )
    return np.clip(WANTED + level, LOWER, UPPER), level


def check(found):
    x, level = filled()
    np.testing.assert_allclose(found.x, x, rtol=0.0, atol=1e-13)
    assert found.value == pytest.approx(np.sum((x - WANTED) ** 2), rel=1e-13)
    # 2 (x - wanted) is the price of the total where x is free; what is left is the bound's.
    assert found.constraints[0] == pytest.approx(2.0 * level, rel=1e-11)
    bounds = 2.0 * (x - WANTED) - 2.0 * level
    active = (x == LOWER) | (x == UPPER)
    assert 0 < np.sum(active) < 12 and np.any(x == LOWER) and np.any(x == UPPER)
    np.testing.assert_allclose(
        found.bounds, np.where(active, bounds, 0.0), rtol=0.0, atol=1e-11
    )
    assert np.all(found.bounds[x == LOWER] > 0.0)
    assert np.all(found.bounds[x == UPPER] < 0.0)


@pytest.mark.parametrize("equation", [total, bent])
@pytest.mark.parametrize("start", [0.0, -0.5, 0.7, 0.125])
def test_minimum(equation, start):
    check(minimise(distance, equation, PROBLEM, np.full(12, start), LOWER, UPPER))


@pytest.mark.parametrize(
    "x",
    [
        np.zeros(12),
        np.where(WANTED > 0.0, 0.7, -0.5),
        np.where(np.arange(12) % 2, 0.7, 0.1),
        np.where(np.arange(12) % 3, 0.0, -0.5),
    ],
    ids=["none active", "most active", "every other", "every third"],
)
def test_wrong_active_set(monkeypatch, x):
    """Whatever SLSQP says is active: what is crossed is added, what pulls is released."""

    def rough(*given, **options):
        return SimpleNamespace(success=True, x=x.copy(), nit=1, message="")

    monkeypatch.setattr(scipy.optimize, "minimize", rough)
    check(minimise(distance, total, PROBLEM, np.zeros(12), LOWER, UPPER))


def test_equation_that_cannot_be_met():
    problem = {**PROBLEM, "total": jnp.asarray([20.0])}
    with pytest.raises(NoOptimumError):
        minimise(distance, total, problem, np.zeros(12), LOWER, UPPER)


def test_without_bounds():
    free = np.full(12, np.inf)
    found = minimise(distance, total, PROBLEM, np.zeros(12), -free, free)
    level = (TOTAL - np.sum(WANTED)) / 12.0
    np.testing.assert_allclose(found.x, WANTED + level, rtol=0.0, atol=1e-13)
    assert np.all(found.bounds == 0.0)
