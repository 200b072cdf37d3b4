"""Drag and altitude over velocity, and bank over time, of many runs and the nominal."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..units import degree, km
from .bands import at_velocity, draw_bands, velocity_grid
from .style import MUTED, NOMINAL, count


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray


_REFERENCE = {"lw": 1.1, "ls": (0, (5, 3))}

_Quantity = Callable[["xarray.Dataset"], np.ndarray]
"""Of shape (run, time), in the unit of its axis"""


def draw_drag(axes, runs, nominal) -> None:
    axes.set_ylabel("Drag acceleration (m/s²)")
    _draw_against_velocity(axes, lambda flown: flown["drag"].values, runs, nominal)


def draw_altitude(axes, runs, nominal) -> None:
    axes.set_ylabel("Altitude (km)")
    _draw_against_velocity(
        axes, lambda flown: flown["altitude"].values / km, runs, nominal
    )


def draw_bank(axes, runs, nominal) -> None:
    from matplotlib.ticker import MultipleLocator

    def magnitude(flown):
        return np.abs(flown["bank_angle"].values) / degree

    axes.set_ylabel("Bank angle magnitude (deg)")
    _draw_against_time(axes, magnitude, runs, nominal)
    axes.yaxis.set_major_locator(MultipleLocator(30.0))


HISTORIES = {"drag": draw_drag, "altitude": draw_altitude, "bank": draw_bank}


def _draw_against_velocity(
    axes: "matplotlib.axes.Axes",
    quantity: _Quantity,
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
) -> None:
    """Bands at equal velocity, which falls to the left as time goes on."""
    velocity = runs["velocity"].values
    grid = velocity_grid(velocity)
    draw_bands(axes, grid / km, at_velocity(velocity, quantity(runs), grid))
    if nominal is not None:
        _draw_nominal(axes, nominal["velocity"].values[0] / km, quantity, nominal)
    axes.set_xlabel("Velocity (km/s)")
    axes.set_title("← time", loc="right", color=MUTED)
    _finish(axes, count(runs))


def _draw_against_time(
    axes: "matplotlib.axes.Axes",
    quantity: _Quantity,
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
) -> None:
    flying = np.isfinite(runs["velocity"].values)
    half = flying.sum(axis=0) >= max(len(flying), 1) / 2
    draw_bands(axes, runs["time"].values[half], quantity(runs)[:, half])
    if nominal is not None:
        _draw_nominal(axes, nominal["time"].values, quantity, nominal)
    axes.set_xlabel("Time (s)")
    _finish(axes, count(runs))


def _draw_nominal(
    axes: "matplotlib.axes.Axes",
    at: np.ndarray,
    quantity: _Quantity,
    nominal: "xarray.Dataset",
) -> None:
    flying = np.isfinite(nominal["velocity"].values[0])
    values = quantity(nominal)[0]
    axes.plot(at[flying], values[flying], color=NOMINAL, label="nominal", **_REFERENCE)


def _finish(axes: "matplotlib.axes.Axes", heading: str) -> None:
    """From zero on, with the number of runs above."""
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.set_title(heading, loc="left")
