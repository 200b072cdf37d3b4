"""Bands of percentiles over the runs, at equal velocity or at equal time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .style import RUNS


if TYPE_CHECKING:
    import matplotlib.axes


_SPREADS = ((5.0, 95.0, 0.18), (25.0, 75.0, 0.32))
"""Lower and upper percentile of each band, and its opacity; the bands overlap"""
_GRID = 400
"""Number of velocities at which the runs are compared"""


def velocity_grid(velocity: np.ndarray, points: int = _GRID) -> np.ndarray:
    """Velocities (m/s) that at least half of the runs pass, rising.

    `velocity` has shape (runs, time), NaN after the end.
    """
    finite = np.isfinite(velocity)
    if not finite.any():
        return np.empty(0)
    slowest = np.where(finite, velocity, np.inf).min(axis=1)
    fastest = np.where(finite, velocity, -np.inf).max(axis=1)
    grid = np.linspace(slowest.min(), fastest.max(), points)
    passing = (slowest[:, None] <= grid) & (grid <= fastest[:, None])
    return grid[passing.sum(axis=0) >= len(velocity) / 2]


def at_velocity(
    velocity: np.ndarray, values: np.ndarray, grid: np.ndarray, *, cubic: bool = False
) -> np.ndarray:
    """Values of each run at the point where it first slows to each velocity of a grid.

    The grid rises. Interpolation starts at the sample of highest velocity. It is linear, or
    cubic for differences between runs that are nearly equal. Shape (runs, time) becomes
    (runs, grid), with NaN where a run does not have the velocity.
    """
    found = np.full((len(velocity), len(grid)), np.nan)
    for row, speeds, quantity in zip(found, velocity, values, strict=True):
        flying = np.isfinite(speeds) & np.isfinite(quantity)
        if not flying.any():
            continue
        speeds, quantity = speeds[flying], quantity[flying]
        peak = np.argmax(speeds)
        speeds, quantity = speeds[peak:], quantity[peak:]
        before = np.minimum.accumulate(np.concatenate([[np.inf], speeds[:-1]]))
        slower = speeds < before
        falling, there = speeds[slower][::-1], quantity[slower][::-1]
        if cubic and falling.size > 1:
            row[:] = _cubic(falling, there, grid)
        else:
            row[:] = np.interp(grid, falling, there, left=np.nan, right=np.nan)
    return found


def _cubic(places: np.ndarray, values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """The cubic through the four samples nearest to each place of a grid; NaN outside.

    It uses Neville's scheme. A spline is as accurate, but its import takes 0.3 s.
    """
    samples = min(4, places.size)
    first = np.clip(places.searchsorted(grid) - 2, 0, places.size - samples)
    about = first[:, None] + np.arange(samples)
    at, found, wanted = places[about], values[about], grid[:, None]
    for apart in range(1, samples):
        left, right = at[:, :-apart], at[:, apart:]
        found = (wanted - left) * found[:, 1:] - (wanted - right) * found[:, :-1]
        found = found / (right - left)
    inside = (places[0] <= grid) & (grid <= places[-1])
    return np.where(inside, found[:, 0], np.nan)


def draw_bands(
    axes: "matplotlib.axes.Axes", grid: np.ndarray, values: np.ndarray
) -> None:
    """Draw bands of percentiles over the runs and the median.

    `values` has shape (runs, grid), with NaN where a run has no value.
    """
    somewhere = np.isfinite(values).any(axis=0)
    if not somewhere.any():
        return
    grid, values = grid[somewhere], values[:, somewhere]
    for low, high, opacity in _SPREADS:
        lower, upper = percentiles(values, [low, high])
        axes.fill_between(
            grid,
            lower,
            upper,
            color=RUNS,
            alpha=opacity,
            lw=0,
            label=f"{low:.0f}–{high:.0f} %",
        )
    (median,) = percentiles(values, [50.0])
    axes.plot(grid, median, color=RUNS, lw=1.8, label="median")


def percentiles(values: np.ndarray, which: Sequence[float]) -> np.ndarray:
    """Percentiles of each column without its NaN: shape (percentiles, columns).

    `np.nanpercentile` processes columns one by one, which takes 0.3 s in a campaign.
    """
    ordered = np.sort(values, axis=0)  # NaN last
    last = np.count_nonzero(np.isfinite(values), axis=0) - 1
    place = np.outer(np.asarray(which) / 100.0, last)
    below = np.floor(place).astype(int)
    above = np.minimum(below + 1, last)
    lower, upper = (np.take_along_axis(ordered, at, axis=0) for at in (below, above))
    return lower + (place - below) * (upper - lower)
