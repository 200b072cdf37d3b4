"""Figures of a glide to a target: states, controls, path constraints, errors at the end."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..campaign.outputs import MISS_DISTANCE, error_of, peak_of
from ..units import km
from .style import ENDS, MUTED, NOMINAL, RUNS, in_style, panelled, scaled


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray


STATES = ("altitude", "velocity", "flight_path_angle", "heading")
CONTROLS = ("angle_of_attack", "bank_angle")
CONSTRAINTS = ("heat_rate", "dynamic_pressure", "load_factor")
END_ERRORS = (
    MISS_DISTANCE,
    *(error_of(miss) for miss in ("flight_path_angle", "heading", "velocity")),
)
"""Errors of figure 12 of the paper"""


def over_time(
    trajectories: "xarray.Dataset",
    names: tuple[str, ...],
    title: str = "",
) -> "matplotlib.figure.Figure":
    """All runs over time, with one panel for each quantity.

    **Arguments:**

    - `trajectories`: runs with histories, on (run, time), NaN after the end.
    - `names`: quantities, such as `STATES`, `CONTROLS` or `CONSTRAINTS`.

    A path constraint has a line at its limit.
    """
    with in_style():
        figure, panels = panelled(3.1 * len(names), 2.9, len(names), title)
        time = scaled(trajectories["time"])
        for axes, name in zip(panels, names, strict=True):
            drawn = scaled(trajectories[name])
            axes.plot(time.values, drawn.values.T, color=RUNS, lw=0.4, alpha=0.25)
            limit = trajectories[name].attrs.get("limit")
            if limit is not None:
                at = limit / drawn.size
                axes.axhline(at, color=ENDS[-1], lw=1.4)
                _name_line(axes, at, "limit", ENDS[-1])
            axes.set(xlabel=time.label, ylabel=drawn.label)
    return figure


def _name_line(axes: "matplotlib.axes.Axes", at: float, name: str, color: str) -> None:
    """Write a name above a level line. A legend would need long to find its place."""
    axes.annotate(
        name,
        (1.0, at),
        (-2.0, 1.5),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="right",
        va="bottom",
        color=color,
        fontsize=9.0,
    )


def constraints_of(trajectories: "xarray.Dataset") -> tuple[str, ...]:
    """Names of the path constraints of runs with histories, without the drag.

    The drag has its own figure. The constraints of `CONSTRAINTS` come first.
    """
    held = [str(n) for n in trajectories.data_vars if peak_of(str(n)) in trajectories]
    usual = [name for name in CONSTRAINTS if name in trajectories]
    return (*usual, *(name for name in held if name not in (*usual, "drag")))


def velocity_errors(
    campaigns: "Mapping[str, xarray.Dataset]", title: str = ""
) -> "matplotlib.figure.Figure":
    """Velocity error at the end of all runs of several campaigns, as in figure 15."""
    with in_style():
        figure, (axes,) = panelled(7.2, 3.6, 1, title)
        for colour, (name, results) in zip(ENDS, campaigns.items(), strict=False):
            drawn = scaled(results[error_of("velocity")])
            error = drawn.values
            mean = np.mean(np.abs(error))
            axes.plot(
                results["run"].values,
                error,
                ".",
                ms=3.5,
                color=colour,
                label=f"{name}: mean {mean:.3g} {drawn.unit}",
            )
            axes.set(xlabel="Run", ylabel=drawn.label)
        axes.axhline(0.0, color=MUTED, lw=0.8)
        axes.legend(loc="upper left", markerscale=2.0)
    return figure


def end_errors(
    results: "xarray.Dataset", title: str = "", names: tuple[str, ...] = END_ERRORS
) -> "matplotlib.figure.Figure":
    """Histograms of miss distance and errors, with one panel for each in the results."""
    names = tuple(name for name in names if name in results)
    with in_style():
        figure, panels = panelled(3.0 * len(names), 2.8, len(names), title)
        for axes, name in zip(panels, names, strict=True):
            drawn = scaled(results[name])
            draw_errors(axes, drawn.values, drawn.label)
            if axes is not panels[0]:
                axes.set_ylabel("")
    return figure


def draw_errors(axes: "matplotlib.axes.Axes", values: np.ndarray, label: str) -> None:
    """Draw a histogram. Small values are drawn in a power of ten of the unit."""
    what, _, unit = label.rstrip(")").rpartition(" (")
    largest = np.max(np.abs(values), initial=0.0)
    if 0.0 < largest < 1e-2:
        power = int(np.floor(np.log10(largest)))
        values, unit = values * 10.0**-power, f"1e{power} {unit}"
    axes.hist(values, bins=40, color=RUNS)
    axes.set(xlabel=f"{what} ({unit})", ylabel="Runs")


def draw_velocity_map(
    k1: np.ndarray, k2: np.ndarray, velocity: np.ndarray, wanted: float | None = None
) -> "matplotlib.figure.Figure":
    """Velocity at the target over k1 and k2, shape (n, m) in m/s, as in figure 10.

    A line marks the desired velocity (m/s), the last argument.
    """
    with in_style():
        figure, (axes,) = panelled(5.4, 3.9, 1, "", measured=True)
        filled = axes.contourf(k1, k2, velocity.T, levels=24, cmap="cividis")
        figure.colorbar(filled, label="Velocity at the target (m/s)")
        if wanted is not None:
            line = axes.contour(k1, k2, velocity.T, levels=[wanted], colors="white")
            axes.clabel(line, fmt=f"{wanted:.0f} m/s")
        axes.set(xlabel="$k_1$", ylabel="$k_2$")
    return figure


def prediction_errors(
    to_go: np.ndarray, errors: Mapping[str, np.ndarray]
) -> "matplotlib.figure.Figure":
    """Mean magnitude of errors (m/s) of velocity predictions over the range to go (m)."""
    with in_style():
        figure, (axes,) = panelled(6.4, 3.6, 1, "")
        edges = np.linspace(0.0, np.max(to_go), 25)
        middle = 0.5 * (edges[1:] + edges[:-1])
        place = np.digitize(to_go, edges[1:-1])
        for colour, (name, error) in zip(
            (NOMINAL, *ENDS), errors.items(), strict=False
        ):
            binned = [np.abs(error[place == i]) for i in range(len(middle))]
            mean = [np.mean(b) if b.size else np.nan for b in binned]
            axes.semilogy(middle / km, mean, color=colour, label=name)
        axes.set(xlabel="Distance to go (km)", ylabel="Mean error of prediction (m/s)")
        axes.legend()
    return figure
