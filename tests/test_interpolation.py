"""Monotone cubics against those of scipy, at the edges of the grid and beyond them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from jentry._interpolation import (
    clamp,
    hermite,
    interpolate,
    interpolate_surface,
    interval,
    monotone_slopes,
)


GRID = np.array([0.0, 0.7, 1.0, 2.5, 2.6, 4.0])

EDGES = {
    "rising": [0.0, 1.0, 1.5, 4.0, 4.1, 5.0],
    "steep at the ends": [0.0, 0.1, 5.0, 5.5, 9.0, 9.01],
    "turning next to the ends": [0.0, 0.2, -7.0, 3.0, 9.0, 8.99],
    "far less at the ends": [0.0, 1e-3, 4.0, 3.0, 9.0, 9.001],
    "flat ends": [1.0, 1.0, 2.0, 3.0, 0.5, 0.5],
    "falling": [9.0, 7.0, 6.9, 2.0, 1.0, -3.0],
}
"""What the rules for the slopes at the ends tell apart, on a grid of unequal widths"""


@jax.jit
def value_and_slope(x, grid, values):
    """At many places, compiled once for all tables."""
    return jax.vmap(jax.value_and_grad(lambda at: interpolate(grid, values, at)))(x)


@pytest.mark.parametrize("name", EDGES)
def test_slopes_are_those_of_scipy(name):
    values = np.array(EDGES[name])
    slopes = jax.jit(monotone_slopes)(GRID, values)
    # One formula by Fritsch and Butland, and one rule at the ends: rounding.
    expected = PchipInterpolator(GRID, values).derivative()(GRID)
    np.testing.assert_allclose(slopes, expected, rtol=1e-12, atol=1e-13)


def test_slopes_of_many_tables_at_once_are_those_of_each():
    values = np.stack(list(EDGES.values()), axis=1)
    together = jax.jit(monotone_slopes)(GRID, values)
    for column, alone in zip(together.T, values.T, strict=True):
        expected = PchipInterpolator(GRID, alone).derivative()(GRID)
        np.testing.assert_allclose(column, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", EDGES)
def test_beyond_the_ends_it_goes_on_straight(name):
    values = np.array(EDGES[name])
    cubic = PchipInterpolator(GRID, values)
    first, last = cubic.derivative()(GRID[[0, -1]])
    x = np.array([-3.0, -0.1, 0.0, 0.35, 2.55, 4.0, 4.2, 10.0])
    expected = np.where(x < 0.0, values[0] + first * x, cubic(np.clip(x, 0.0, 4.0)))
    expected = np.where(x > 4.0, values[-1] + last * (x - 4.0), expected)
    found, slopes = value_and_slope(x, jnp.asarray(GRID), jnp.asarray(values))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)
    inside = cubic.derivative()(np.clip(x, 0.0, 4.0))
    np.testing.assert_allclose(slopes, inside, rtol=1e-11, atol=1e-12)


def test_hermite_is_the_cubic_of_values_and_slopes():
    values, slopes = np.array([0.3, -0.4]), np.array([2.0, -1.5])
    spline = CubicHermiteSpline([1.0, 3.5], values, slopes)
    for x in (1.0, 1.9, 3.1, 3.5):
        found = hermite(2.5, (x - 1.0) / 2.5, *values, *slopes)
        assert found == pytest.approx(float(spline(x)), rel=1e-14)


def test_a_surface_is_a_cubic_along_each_line_of_its_grid():
    x_grid, y_grid = GRID, np.array([-1.0, 0.5, 2.0])
    values = np.stack([EDGES[n] for n in ("rising", "falling", "flat ends")], axis=1)
    surface = jax.jit(interpolate_surface)
    for j, y in enumerate(y_grid):
        for x in (0.2, 1.7, 2.55, 3.9):
            found = surface(x_grid, y_grid, values, x, y)
            expected = PchipInterpolator(x_grid, values[:, j])(x)
            assert float(found) == pytest.approx(float(expected), rel=1e-12)
    for i, x in enumerate(x_grid):
        for y in (-0.6, 1.2):
            found = surface(x_grid, y_grid, values, x, y)
            expected = PchipInterpolator(y_grid, values[i])(y)
            assert float(found) == pytest.approx(float(expected), rel=1e-12)


def test_a_value_on_a_grid_point_belongs_to_the_interval_after_it():
    grid = jnp.asarray(GRID)
    places = [-1.0, 0.0, 0.69, 0.7, 2.55, 2.6, 4.0, 9.0]
    numbers = [int(interval(grid, jnp.asarray(x))) for x in places]
    assert numbers == [0, 0, 0, 1, 3, 4, 4, 4]


@pytest.mark.parametrize(
    ("x", "value", "slope"),
    [(-1.1, -1.0, 0.0), (-1.0, -1.0, 1.0), (0.4, 0.4, 1.0), (2.0, 2.0, 1.0)]
    + [(2.1, 2.0, 0.0)],
)
def test_a_number_is_held_between_two_ends(x, value, slope):
    found, derivative = jax.value_and_grad(clamp)(jnp.asarray(x), -1.0, 2.0)
    assert (float(found), float(derivative)) == (value, slope)
