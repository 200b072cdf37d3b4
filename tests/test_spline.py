"""B-splines: against scipy's, and what their coefficients promise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate

from jentry.onboard.spline import BSpline, cubic_spline


RNG = np.random.default_rng(11)


def drawn(count):
    breakpoints = np.sort(RNG.uniform(-3.0, 4.0, count))
    spline = BSpline(RNG.normal(size=count + 2), breakpoints)
    knots = np.r_[[breakpoints[0]] * 3, breakpoints, [breakpoints[-1]] * 3]
    return spline, scipy.interpolate.BSpline(knots, spline.coefficients, 3)


@pytest.mark.parametrize("count", [2, 3, 4, 12])
def test_against_scipy(count):
    spline, by_scipy = drawn(count)
    first, last = spline.breakpoints[0], spline.breakpoints[-1]
    at = np.r_[RNG.uniform(first, last, 300), np.asarray(spline.breakpoints[:-1])]
    values = jax.vmap(spline.with_derivatives)(jnp.asarray(at))
    for order, value in enumerate(values):
        expected = by_scipy(at, order)
        # Of the recursion's rounding, a few units of the largest.
        np.testing.assert_allclose(
            value, expected, rtol=0.0, atol=1e-14 * np.max(np.abs(expected))
        )


def test_beyond_its_ends_it_keeps_their_values():
    spline, _ = drawn(6)
    for end, value, way in ((0, 0, -1.0), (-1, -1, 1.0)):
        at = spline.breakpoints[end]
        np.testing.assert_allclose(spline(at), spline.coefficients[value], rtol=1e-14)
        beyond = spline.with_derivatives(at + way)
        np.testing.assert_allclose(beyond[0], spline.coefficients[value], rtol=1e-14)
        assert beyond[1] == 0.0 and beyond[2] == 0.0
        # At the end itself the slope is that of the inside: three times the first step.
        near = spline.with_derivatives(at - 1e-9 * way)[1]
        np.testing.assert_allclose(spline.with_derivatives(at)[1], near, rtol=1e-6)


def test_bounds_of_the_coefficients_bound_it():
    spline = BSpline(jnp.array([0.0, 1.0, 0.0, 1.0, 1.0, 0.0]), jnp.arange(4.0))
    values = jax.vmap(spline)(jnp.linspace(-1.0, 4.0, 401))
    assert jnp.min(values) >= 0.0 and jnp.max(values) <= 1.0


def test_a_coefficient_acts_between_four_breakpoints_to_either_side():
    count = 12
    spline = BSpline(jnp.zeros(count + 2), jnp.arange(float(count)))
    moved = BSpline(spline.coefficients.at[6].set(1.0), spline.breakpoints)
    at = jnp.linspace(0.0, count - 1.0, 1101)
    felt = at[jax.vmap(moved)(at) != 0.0]
    assert 3.0 < jnp.min(felt) < 3.1 and 6.9 < jnp.max(felt) < 7.0


def test_nodes_are_the_coefficients_of_the_index_itself():
    spline, _ = drawn(7)
    itself = BSpline(spline.nodes, spline.breakpoints)
    at = jnp.linspace(spline.breakpoints[0], spline.breakpoints[-1], 57)
    np.testing.assert_allclose(jax.vmap(itself)(at), at, rtol=0.0, atol=1e-14 * 4.0)


@pytest.mark.parametrize(
    ("coefficients", "breakpoints", "said"),
    [
        (np.zeros(5), np.arange(4.0), "4 breakpoints have 6"),
        (np.zeros(3), np.arange(1.0), "two are the least"),
        (np.zeros((4, 1)), np.arange(2.0), "2 breakpoints have 4"),
    ],
    ids=["few coefficients", "one breakpoint", "two axes"],
)
def test_shapes_are_checked(coefficients, breakpoints, said):
    with pytest.raises(ValueError, match=said):
        BSpline(jnp.asarray(coefficients), jnp.asarray(breakpoints))


def test_an_interpolating_spline_is_that_of_scipy():
    """Through uneven knots, inside of them and beyond; of a cubic it is the cubic."""
    rng = np.random.default_rng(3)
    knots = np.cumsum(rng.uniform(0.3, 2.0, 8))
    places = np.linspace(knots[0] - 0.2, knots[-1] + 0.2, 57)
    cubic = 0.3 * knots**3 - knots**2 + 2.0
    for values in (rng.normal(size=8), cubic):
        ours = cubic_spline(jnp.asarray(knots), jnp.asarray(values))
        theirs = scipy.interpolate.CubicSpline(knots, values, bc_type="not-a-knot")
        found = np.array(
            [ours.with_derivatives(place) for place in jnp.asarray(places)]
        )
        for order in range(3):
            expected = theirs(places, order)
            np.testing.assert_allclose(
                found[:, order], expected, rtol=1e-9, atol=1e-9 * abs(expected).max()
            )
    middle = 0.5 * sum(knots[:2])
    slope = jax.grad(lambda v: cubic_spline(jnp.asarray(knots), v)(jnp.asarray(middle)))
    unit = [
        scipy.interpolate.CubicSpline(knots, row, bc_type="not-a-knot")(
            0.5 * sum(knots[:2])
        )
        for row in np.eye(8)
    ]
    np.testing.assert_allclose(slope(jnp.asarray(values)), unit, atol=1e-12)


def test_an_interpolating_spline_needs_four_knots():
    with pytest.raises(ValueError, match=r"knots of shape \(3,\) and values"):
        cubic_spline(jnp.arange(3.0), jnp.ones(3))
