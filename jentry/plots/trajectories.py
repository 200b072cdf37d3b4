"""Bands of many runs and the nominal flight, over velocity or over time."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ..units import degree
from .bands import at_velocity, draw_bands, velocity_grid
from .style import MUTED, NOMINAL, count, scaled


if TYPE_CHECKING:
    import matplotlib.axes
    import xarray


_REFERENCE = {"lw": 1.1, "ls": (0, (5, 3))}


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A quantity of histories on (run, time), and over what it is drawn."""

    name: str
    """Of the variable"""
    over_time: bool = False
    """Else over the velocity, which falls to the left as time goes on"""
    magnitude: bool = False
    """Whether only its magnitude is drawn"""

    def draw(
        self,
        axes: "matplotlib.axes.Axes",
        runs: "xarray.Dataset",
        nominal: "xarray.Dataset | None",
    ) -> None:
        """Bands of the runs, and the nominal flight as a line."""
        drawn = scaled(runs[self.name])
        label = drawn.label
        if self.magnitude:
            what, bracket, unit = label.partition(" (")
            label = f"{what} magnitude{bracket}{unit}"
        axes.set_ylabel(label)
        values = self._of(drawn.values)
        if self.over_time:
            self._draw_over_time(axes, runs, values)
        else:
            self._draw_over_velocity(axes, runs, values)
        if nominal is not None:
            flying = np.isfinite(nominal["velocity"].values[0])
            at = nominal["time"].values
            if not self.over_time:
                speed = scaled(runs["velocity"]).size
                at = nominal["velocity"].values[0] / speed
            line = self._of(nominal[self.name].values[0] / drawn.size)
            axes.plot(
                at[flying], line[flying], color=NOMINAL, label="nominal", **_REFERENCE
            )
        axes.set_xlim(left=0.0)
        axes.set_ylim(bottom=0.0)
        axes.set_title(count(runs), loc="left")
        if drawn.size == degree:
            from matplotlib.ticker import MultipleLocator

            axes.yaxis.set_major_locator(MultipleLocator(30.0))

    def _of(self, values: np.ndarray) -> np.ndarray:
        return np.abs(values) if self.magnitude else values

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
BANK = Trajectory("bank_angle", over_time=True, magnitude=True)
