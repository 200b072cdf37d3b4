"""Bands of many runs and the nominal flight, over velocity or over time."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ..units import degree
from .bands import at_velocity, draw_bands, velocity_grid
from .style import MUTED, NOMINAL, RUNS, count, scaled


if TYPE_CHECKING:
    import matplotlib.axes
    import xarray


_REFERENCE = {"lw": 1.1, "ls": (0, (5, 3))}


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A quantity of histories on (run, time), drawn over velocity or over time."""

    name: str
    """Name of the variable"""
    over_time: bool = False
    """Whether to draw over time, or else over the velocity, where time runs to the left"""
    each: int | None = None
    """Number of runs to draw as lines instead of percentiles; None for percentiles.
    Percentiles are not useful for a quantity that jumps, such as a bank with reversals, or
    that is at a limit"""

    def draw(
        self,
        axes: "matplotlib.axes.Axes",
        runs: "xarray.Dataset",
        nominal: "xarray.Dataset | None",
    ) -> None:
        """Bands of the runs, and the nominal flight as a line."""
        drawn = scaled(runs[self.name])
        axes.set_ylabel(drawn.label)
        values = drawn.values
        if self.each is not None:
            self._draw_each(axes, runs, values, self.each)
        elif self.over_time:
            self._draw_over_time(axes, runs, values)
        else:
            self._draw_over_velocity(axes, runs, values)
        if nominal is not None:
            flying = np.isfinite(nominal["velocity"].values[0])
            at = nominal["time"].values
            if not self.over_time:
                speed = scaled(runs["velocity"]).size
                at = nominal["velocity"].values[0] / speed
            line = nominal[self.name].values[0] / drawn.size
            axes.plot(
                at[flying], line[flying], color=NOMINAL, label="nominal", **_REFERENCE
            )
        axes.set_xlim(left=0.0)
        if self.each is None:
            axes.set_ylim(bottom=0.0)
            axes.set_title(count(runs), loc="left")
        if drawn.size == degree:
            from matplotlib.ticker import MultipleLocator

            axes.yaxis.set_major_locator(MultipleLocator(30.0))

    def _draw_each(self, axes, runs, values, most: int) -> None:
        """Draw the first runs over time."""
        first = values[:most]
        lines = axes.plot(runs["time"].values, first.T, color=RUNS, lw=0.7, alpha=0.45)
        if lines:
            lines[0].set_label("runs")
        axes.set_xlabel(scaled(runs["time"]).label)
        axes.set_title(f"{len(first)} of {count(runs)}", loc="left")

    def _draw_over_velocity(self, axes, runs, values) -> None:
        velocity = runs["velocity"].values
        grid = velocity_grid(velocity)
        drawn = scaled(runs["velocity"])
        draw_bands(axes, grid / drawn.size, at_velocity(velocity, values, grid))
        axes.set_xlabel(drawn.label)
        axes.set_title("← time", loc="right", color=MUTED)

    def _draw_over_time(self, axes, runs, values) -> None:
        flying = np.isfinite(runs["velocity"].values)
        half = flying.sum(axis=0) >= max(len(flying), 1) / 2
        draw_bands(axes, runs["time"].values[half], values[:, half])
        axes.set_xlabel(scaled(runs["time"]).label)


DRAG = Trajectory("drag")
ALTITUDE = Trajectory("altitude")
BANK = Trajectory("bank_angle", over_time=True, each=24)


def draw_deviation(
    axes: "matplotlib.axes.Axes",
    name: str,
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset",
) -> None:
    """Bands of a quantity minus that of the nominal flight, at equal velocity.

    For a quantity that tracks a reference, bands of the quantity itself would be too narrow
    to see.
    """
    grid = velocity_grid(runs["velocity"].values)
    drawn, speed = scaled(runs[name]), scaled(runs["velocity"])
    ours, nominal_ones = [
        at_velocity(
            flown["velocity"].values, flown[name].values / drawn.size, grid, cubic=True
        )
        for flown in (runs, nominal)
    ]
    draw_bands(axes, grid / speed.size, ours - nominal_ones)
    axes.axhline(0.0, color=NOMINAL, label="nominal", **_REFERENCE)
    what, bracket, unit = drawn.label.partition(" (")
    axes.set_ylabel(f"{what} less nominal{bracket}{unit}")
    axes.set_xlabel(speed.label)
    axes.set_xlim(left=0.0)
    axes.set_title(count(runs), loc="left")
    axes.set_title("← time", loc="right", color=MUTED)
