"""Minima under equations and bounds, against a closed form and against wrong beginnings."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from jentry.planning._constrained import (
    Limits,
    Linearized,
    NoOptimumError,
    minimise,
    sequential_quadratic,
)


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


def limited(least, most, total=TOTAL):
    """Nearest to what is wanted, with the sum of the first four between two values."""
    rows = np.stack([np.ones(12), np.arange(12) < 4.0])

    def linearized(x):
        value = np.sum((x - WANTED) ** 2)
        return Linearized(value, 2.0 * (x - WANTED), rows @ x, rows)

    limits = Limits(LOWER, UPPER, np.array([total, least]), np.array([total, most]))
    return sequential_quadratic(linearized, np.zeros(12), limits)


FREE = limited(-np.inf, np.inf)
PART = float(np.sum(FREE.x[:4]))
"""The sum of the first four where nothing limits it"""


@pytest.mark.parametrize(
    ("least", "most", "sign"),
    [
        (PART + 0.2, np.inf, 1.0),
        (-np.inf, PART - 0.2, -1.0),
        (PART + 0.2, PART + 5.0, 1.0),
        (PART - 5.0, PART - 0.2, -1.0),
        (PART - 0.1, PART + 0.1, 0.0),
        (PART + 0.2, PART + 0.2, 1.0),
        (PART - 0.2, PART - 0.2, -1.0),
    ],
)
def test_limits(least, most, sign):
    """The part is at its limit; its price is the slope of the least value in the limit."""
    found = limited(least, most)
    assert np.sign(found.constraints[1]) == sign
    part = np.clip(PART, least, most)
    assert np.sum(found.x[:4]) == pytest.approx(part, abs=1e-9)
    assert np.sum(found.x) == pytest.approx(TOTAL, abs=1e-9)
    assert found.slope_left < 1e-6
    if sign:
        moved = [limited(part + h, part + h).value for h in (1e-3, -1e-3)]
        # A quadratic between changes of what binds; SLSQP's tolerance is 1e-12.
        slope = (moved[0] - moved[1]) / 2e-3
        assert found.constraints[1] == pytest.approx(slope, rel=1e-6)
    # SLSQP comes as near to a bound as the root of its tolerance.
    at_lower, at_upper = found.x < LOWER + 1e-6, found.x > UPPER - 1e-6
    assert np.any(at_lower) and np.any(at_upper)
    assert np.all(found.bounds[~(at_lower | at_upper)] == 0.0)
    assert np.all(found.bounds[at_lower] >= 0.0)
    assert np.all(found.bounds[at_upper] <= 0.0)


def test_price_of_an_equation():
    slope = (limited(-np.inf, np.inf, TOTAL + 1e-3).value - FREE.value) / 1e-3
    assert FREE.constraints[0] == pytest.approx(slope, rel=2e-3)  # one-sided


def test_no_constraint_at_all():
    def linearized(x):
        rows = np.zeros((0, 12))
        return Linearized(
            np.sum((x - WANTED) ** 2), 2.0 * (x - WANTED), np.zeros(0), rows
        )

    none = np.zeros(0)
    found = sequential_quadratic(
        linearized, np.zeros(12), Limits(LOWER, UPPER, none, none)
    )
    np.testing.assert_allclose(found.x, np.clip(WANTED, LOWER, UPPER), atol=1e-6)


def test_where_it_is_not_finite_it_goes_nearer():
    """-log x + x beyond a wall of NaN: the first step of SLSQP would end behind it."""
    asked = []

    def linearized(x):
        asked.append(x[0])
        with np.errstate(invalid="ignore", divide="ignore"):
            value = 50.0 * (x[0] - np.log(x[0]))
            slope, constraint = 50.0 * (1.0 - 1.0 / x), np.log(x)
        return Linearized(value, slope, constraint, (1.0 / x)[None])

    free = np.array([np.inf])
    limits = Limits(-free, free, np.array([-50.0]), np.array([50.0]))
    found = sequential_quadratic(linearized, np.array([3.0]), limits)
    assert min(asked) < 0.0, "it never met the wall"
    assert found.x[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("x", [np.full(12, 0.5), np.full(12, np.nan)])
def test_slsqp_is_not_believed(monkeypatch, x):
    """Where it says that it is done, and the total is another or nothing is finite."""

    def wrong(*given, **options):
        return SimpleNamespace(success=True, x=x.copy(), nit=1, message="")

    monkeypatch.setattr(scipy.optimize, "minimize", wrong)
    with pytest.raises(NoOptimumError):
        limited(-np.inf, np.inf)


def test_limits_that_contradict_each_other():
    with pytest.raises(NoOptimumError) as refused:
        limited(7.0, 8.0)  # four times 0.7 is less
    assert refused.value.x.shape == (12,)
