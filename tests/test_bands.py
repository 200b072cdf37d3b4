"""Percentile bands of histories, at equal velocity."""

import numpy as np
import pytest
from synthetic_runs import LABELS, band, figures_of, line, synthetic

from jentry.plots import at_velocity, velocity_grid
from jentry.plots.bands import percentiles


@pytest.fixture(scope="module")
def runs():
    return synthetic()


@pytest.fixture(scope="module")
def figures(runs):
    return figures_of(runs, runs, runs.isel(run=[0]), "A title")


@pytest.mark.parametrize("name", ["drag", "altitude", "drag_deviation"])
def test_histories_have_two_bands_a_median_and_the_nominal(figures, name):
    (axes,) = figures[name].axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == LABELS
    assert len(axes.lines) == 2
    assert axes.get_title(loc="left") == "40 runs"


def test_percentiles_are_those_of_numpy():
    random = np.random.default_rng(5)
    values = random.normal(size=(37, 60))
    values[random.uniform(size=values.shape) < 0.3] = np.nan
    values[1:, 7], values[0, 7] = np.nan, 3.0
    which = [0.0, 5.0, 33.3, 50.0, 100.0]
    expected = np.nanpercentile(values, which, axis=0)
    # Both interpolate between the same two numbers, of order one, from either of them.
    np.testing.assert_allclose(percentiles(values, which), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "factor"), [("drag", 1.0), ("altitude", 1e-3)], ids=str
)
def test_bands_are_percentiles_at_equal_velocity(runs, figures, name, factor):
    """The quantities are linear in velocity: interpolation is exact to rounding."""
    (axes,) = figures[name].axes
    grid, (low, high) = band(axes, "5–95 %")
    at = np.searchsorted(grid, 5000.0)
    slope = runs["drag"].values[:, 0] / 6000.0
    value = slope if name == "drag" else 10.0
    offset = 0.0 if name == "drag" else 1e6 * slope
    exact = factor * (value * grid[at] + offset)
    assert [low[at], high[at]] == pytest.approx(np.percentile(exact, [5, 95]), rel=1e-9)
    speeds, median = line(axes, "median")
    there = np.argmin(abs(speeds - grid[at]))
    assert median[there] == pytest.approx(np.median(exact), rel=1e-9)


def test_values_at_equal_velocity_between_samples():
    """The cubic is of fourth order, the linear interpolant of second."""
    grid = np.linspace(1010.0, 5990.0, 77)
    drag = lambda v: np.exp(v / 500.0)
    errors = []
    for samples in (51, 101):
        velocity = np.linspace(6000.0, 1000.0, samples)[None]
        found = [
            at_velocity(velocity, drag(velocity), grid, cubic=cubic)
            for cubic in (False, True)
        ]
        errors.append([np.max(np.abs(x[0] - drag(grid))[3:-3]) for x in found])
    (linear, cubic), (linear_half, cubic_half) = errors
    assert 3.0 < linear / linear_half < 5.0 and 10.0 < cubic / cubic_half < 25.0
    assert np.isnan(
        at_velocity(velocity, velocity, np.array([999.0]), cubic=True)
    ).all()


@pytest.mark.parametrize("samples", [2, 3, 4, 9])
def test_cubics_of_uneven_samples_are_exact_to_their_degree(samples):
    """At the samples and between them; with fewer than four of them it is of less."""
    velocity = np.cumsum([7.0, 1.0, 2.0, 0.3, 4.0, 1.0, 0.7, 3.0, 2.0][:samples])
    quantity = lambda v: 2.0 - v + 0.3 * v ** min(samples - 1, 3)
    grid = np.append(velocity, np.linspace(7.0, velocity[-1], 50))
    falling = velocity[None, ::-1]
    found = at_velocity(falling, quantity(falling), grid, cubic=True)
    assert found[0] == pytest.approx(quantity(grid), rel=1e-12)
    beyond = np.array([6.99, velocity[-1] + 0.01])
    assert np.isnan(at_velocity(falling, falling, beyond, cubic=True)).all()


def test_the_deviation_of_the_drag_is_from_the_nominal_flight(runs, figures):
    """Drag is linear in velocity: so are differences, to rounding."""
    (axes,) = figures["drag_deviation"].axes
    grid, (low, high) = band(axes, "5–95 %")
    slope = runs["drag"].values[:, 0] / 6000.0
    at = np.searchsorted(grid, 5000.0)
    exact = (slope - slope[0]) * grid[at]  # the nominal flight is the first of them
    expected = pytest.approx(np.percentile(exact, [5, 95]), rel=1e-9)
    assert [low[at], high[at]] == expected


def test_velocity_grid_is_where_half_of_the_runs_fly(runs):
    grid = velocity_grid(runs["velocity"].values)
    # Half of the runs reach the 57th sample.
    slowest = runs["velocity"].values[0, 56]
    step = np.diff(grid).max()
    assert slowest <= grid[0] < slowest + step
    assert grid[-1] == 6000.0


def test_velocity_that_rises_first_is_taken_from_its_peak():
    velocity = np.array([[5.0, 7.0, 6.0, 6.5, 4.0, np.nan]])
    values = np.array([[0.0, 1.0, 2.0, 3.0, 4.0, 9.0]])
    found = at_velocity(velocity, values, np.array([3.0, 4.0, 5.0, 6.5, 7.0, 8.0]))
    assert np.allclose(found, [[np.nan, 4.0, 3.0, 1.5, 1.0, np.nan]], equal_nan=True)
