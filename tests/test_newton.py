"""Newton's method with its safeguards."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._newton import by_jvp, newton, solve


def one(x):
    return jnp.asarray(x, dtype=float)


@pytest.mark.parametrize("unroll", [False, True])
def test_steps_are_those_of_newton(unroll):
    """Of x^2 - 2 from 1: 3/2, 17/12, 577/408."""
    function = by_jvp(lambda x: x * x - 2.0)
    for steps, expected in ((1, 3 / 2), (2, 17 / 12), (3, 577 / 408)):
        found = newton(function, one(1.0), steps, unroll=unroll)
        assert float(found.x) == pytest.approx(expected, rel=1e-15)
        assert bool(found.known)
    # Where the third one began, and how long it was.
    assert float(found.value) == pytest.approx((17 / 12) ** 2 - 2.0, rel=1e-12)
    assert float(found.step) == pytest.approx(577 / 408 - 17 / 12, rel=1e-10)


def test_bounds_hold_and_are_where_what_cannot_be_reached_ends():
    function = by_jvp(lambda x: x * x - 2.0)
    for start, bounds, expected in (
        (1.0, {"upper": 1.2}, 1.2),
        (2.0, {"lower": 1.6}, 1.6),
        (1.0, {"largest_step": 0.1}, 1.3),
        (3.0, {"largest_step": 0.25}, 2.25),
        (1.0, {"lower": 1.0, "upper": 1.2, "largest_step": 0.05}, 1.15),
    ):
        found = newton(function, one(start), 3, **bounds)
        assert float(found.x) == pytest.approx(expected, rel=1e-15), bounds


def test_where_there_is_no_answer_x_stays():
    """Not finite: it says so. A slope of zero is an answer, of no use."""
    for function, known in (
        (lambda x: jnp.log(x - 5.0), False),
        (lambda x: jnp.sqrt(x - 1.0), False),  # an infinite slope
        (lambda x: 3.0 + 0.0 * x, True),
    ):
        found = newton(by_jvp(function), one(1.0), 2, lower=0.0, upper=2.0)
        assert float(found.x) == 1.0 and bool(found.known) == known
        assert float(found.step) == np.inf
    # It is remembered that once there was none: ln(x) from 3 goes to -0.3.
    found = newton(by_jvp(lambda x: jnp.log(x)), one(3.0), 2)
    assert float(found.x) < 0.0 and not bool(found.known)
    assert not bool(newton(by_jvp(lambda x: x), one(np.nan), 1).known)


@pytest.mark.parametrize(
    "function, start",
    [
        (lambda x: jnp.log(x - 5.0), 1.0),
        (lambda x: jnp.sqrt(x - 1.0), 1.0),
        (lambda x: 1.0 / (x - 1.0), 1.0),
        (lambda x: 3.0 + 0.0 * x, 1.0),
        (jnp.log, 3.0),
    ],
)
def test_what_is_lost_is_nan_to_the_end(function, start):
    for steps, bounds in ((2, {}), (3, {"lower": -10.0, "upper": 10.0})):
        found = newton(
            by_jvp(function), one(start), steps, nan_where_lost=True, **bounds
        )
        assert np.isnan(found.x) and not bool(found.known)
    kept = newton(by_jvp(lambda x: x * x - 2.0), one(1.0), 3, nan_where_lost=True)
    assert float(kept.x) == pytest.approx(577 / 408, rel=1e-15) and bool(kept.known)
    bounds = {"lower": 0.0, "upper": 1.2, "nan_where_lost": True}
    held = newton(by_jvp(lambda x: x * x - 2.0), one(1.0), 3, **bounds)
    assert float(held.x) == 1.2 and bool(held.known)


def test_two_unknowns():
    """x^2 + y^2 = 4 and x y = 1, whose Jacobian is not symmetric."""

    def function(x):
        return jnp.stack([x[0] ** 2 + x[1] ** 2 - 4.0, x[0] * x[1] - 1.0])

    found = newton(by_jvp(function), jnp.array([2.0, 0.3]), 6)
    root = np.sqrt(2.0 + np.sqrt(3.0))
    np.testing.assert_allclose(found.x, [root, 1.0 / root], rtol=1e-14)
    bounded = newton(
        by_jvp(function), jnp.array([2.0, 0.3]), 6, upper=1.9, largest_step=0.01
    )
    assert float(bounded.x[0]) == 1.9
    matrix, right = np.array([[2.0, 1.0], [3.0, -4.0]]), np.array([1.0, 5.0])
    ours = solve(jnp.asarray(matrix), jnp.asarray(right))
    np.testing.assert_allclose(ours, np.linalg.solve(matrix, right), rtol=1e-15)
    singular = newton(by_jvp(lambda x: jnp.stack([x[0], x[0]])), jnp.ones(2), 1)
    np.testing.assert_array_equal(singular.x, [1.0, 1.0])


def test_a_bracket_closes_in_where_newton_alone_runs_away():
    """-arctan from far out: a Newton step goes farther out to the other side."""
    function = by_jvp(lambda x: -jnp.arctan(x - 0.3))
    away = newton(function, one(5.0), 4)
    assert not abs(float(away.x)) < 100.0
    bracket = {"lower": -7.0, "upper": 5.0, "falls": True}
    found = newton(function, one(5.0), 8, **bracket)
    assert float(found.x) == pytest.approx(0.3, abs=1e-14)
    with pytest.raises(ValueError, match="falls=True needs"):
        newton(function, one(5.0), 4, falls=True)


def test_a_bracket_closes_in_from_where_the_function_is_flat():
    """Its sign says where the zero is. From 7 the middles are 1, -2, and -1/2."""
    function = by_jvp(lambda x: jnp.where(jnp.abs(x) < 1.0, -x, -jnp.sign(x)))
    bracket = {"lower": -5.0, "upper": 9.0, "falls": True}
    for steps, expected in ((1, 1.0), (2, -2.0), (3, -0.5), (4, 0.0)):
        found = newton(function, one(7.0), steps, **bracket)
        assert float(found.x) == expected and bool(found.known)
    # A zero is one, flat or not, and so is a bound.
    flat = by_jvp(lambda x: 0.0 * x)
    assert float(newton(flat, one(7.0), 3, **bracket).x) == 7.0
    above = by_jvp(lambda x: 1.0 + 0.0 * x)
    assert float(newton(above, one(9.0), 3, **bracket).x) == 9.0
    lost = newton(by_jvp(lambda x: jnp.log(x - 8.0)), one(7.0), 3, **bracket)
    assert float(lost.x) == 7.0 and not bool(lost.known)


def test_derivatives_are_those_of_the_implicit_function():
    """Of the cube root, from where it is not differentiated: three orders in two steps."""

    def root(a):
        start = jax.lax.stop_gradient(jnp.cbrt(a))
        return newton(by_jvp(lambda x: x**3 - a), start, 2).x

    a = one(2.0)
    first, second = jax.grad(root), jax.jacfwd(jax.grad(root))
    third = jax.jacfwd(jax.jacfwd(jax.grad(root)))
    assert float(first(a)) == pytest.approx(2.0 ** (-2 / 3) / 3, rel=1e-13)
    assert float(second(a)) == pytest.approx(-2 / 9 * 2.0 ** (-5 / 3), rel=1e-13)
    assert float(third(a)) == pytest.approx(10 / 27 * 2.0 ** (-8 / 3), rel=1e-12)
