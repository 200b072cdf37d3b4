"""Errors at the end of flights: histogram of the downrange error, and footprints."""

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from .._printed import in_words
from ..campaign.outputs import error_of
from ..statistics.miss_ellipse import ellipse_of
from ..statistics.summary import RADII
from .style import (
    ENDS,
    MEAN,
    MUTED,
    NOMINAL,
    RUNS_LIGHT,
    count,
    legend,
    panelled,
    scaled,
)


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray


_MOST_BINS = 40
_FLAT = 1e-3
"""Difference below which errors count as equal, in the unit of the axis"""

_ALONG, _ACROSS, _UP = map(error_of, ("downrange", "crossrange", "altitude"))
_WORST = 3
"""Number of worst runs that are labelled with their run number"""

_CROSSRANGE_SPREAD = 1.0
"""Standard deviation of the crossrange above which it has its own panel, m"""


def draw_downrange(axes: "matplotlib.axes.Axes", runs: "xarray.Dataset") -> None:
    """Histogram of the downrange error, with its mean and standard deviation."""
    from matplotlib.ticker import MaxNLocator

    drawn = scaled(runs[_ALONG])
    errors = drawn.values
    axes.set_xlabel(drawn.label)
    axes.set_ylabel("Runs")
    axes.grid(visible=False, axis="x")
    heading = [count(runs)]
    if errors.size:
        axes.hist(
            errors, list(_bin_edges(errors)), color=RUNS_LIGHT, ec="white", lw=0.6
        )
        steps = [1.0, 2.0, 2.5, 5.0, 10.0]
        axes.yaxis.set_major_locator(MaxNLocator("auto", steps=steps, integer=True))
        heading += _mark_moments(axes, errors, drawn.unit)
    axes.set_title(", ".join(heading), loc="left")


def _mark_moments(
    axes: "matplotlib.axes.Axes", errors: np.ndarray, unit: str
) -> list[str]:
    """Draw lines at the mean and one standard deviation from it; return both as text."""
    mean = float(errors.mean())
    axes.axvline(mean, color=MEAN, lw=1.8)
    if errors.size == 1:
        return [f"mean {_number(mean, abs(mean), '+')} {unit}"]
    deviation = float(np.std(errors, ddof=1))
    for side in (mean - deviation, mean + deviation):
        axes.axvline(side, color=MEAN, lw=1.1, ls=(0, (3, 2)))
    return [
        f"mean {_number(mean, deviation, '+')} {unit}",
        f"std {_number(deviation, deviation)} {unit}",
    ]


def _bin_edges(errors: np.ndarray) -> np.ndarray:
    """Edges of 40 bins at most; bins of one unit if all errors are equal."""
    if np.ptp(errors) < _FLAT:
        return np.mean(errors) + np.arange(-2.5, 3.0)
    bins = int(np.clip(np.sqrt(errors.size), 5, _MOST_BINS))
    return np.linspace(errors.min(), errors.max(), bins + 1)


def _number(value: float, scale: float, sign: str = "") -> str:
    """A number with three digits at this scale, and three decimals at most."""
    digits = np.clip(2 - np.floor(np.log10(max(scale, _FLAT))), 0, 3)
    return f"{value:{sign}.{digits:.0f}f}".replace("-", "−")


def footprint(
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
    title: str,
) -> "matplotlib.figure.Figure":
    if not _spreads_across(runs):
        figure, (axes,) = panelled(6.4, 4.2, 1, title)
        draw_footprint(axes, runs, nominal)
        return figure
    figure, (left, right) = panelled(10.0, 4.2, 2, title)
    draw_footprint(left, runs, nominal)
    _draw_ends(right, runs, nominal, _ACROSS)
    _draw_circles(right, runs)
    _mark_worst(right, runs)
    return figure


def _draw_circles(axes: "matplotlib.axes.Axes", runs: "xarray.Dataset") -> None:
    """Draw circles about the target that contain shares of the runs, and their ellipse."""
    found = ellipse_of(runs, RADII)
    if found is None:
        return
    along, across = scaled(runs[_ALONG]).size, scaled(runs[_ACROSS]).size
    around = np.linspace(0.0, 2.0 * np.pi, 181)
    for percentage, radius in found.radii.items():
        x, y = radius.value * np.cos(around), radius.value * np.sin(around)
        axes.plot(x / along, y / across, color=MUTED, lw=0.9, ls=(0, (3, 2)))
        axes.annotate(
            f"{percentage:g} %",
            (
                math.sqrt(0.5) * radius.value / along,
                math.sqrt(0.5) * radius.value / across,
            ),
            ha="left",
            va="bottom",
            fontsize=8.0,
            color=MUTED,
        )
    x, y = found.outline(RADII[-1])
    axes.plot(x / along, y / across, color=MEAN, lw=1.2)
    axes.set_title(
        f"circles about the target, {RADII[-1]:g} % ellipse, worst runs",
        loc="left",
        fontsize=9.0,
    )
    if along == across:
        axes.set_aspect("equal", adjustable="datalim")


def _mark_worst(axes: "matplotlib.axes.Axes", runs: "xarray.Dataset") -> None:
    """Label the runs that end farthest from the target with their numbers."""
    along, across = scaled(runs[_ALONG]), scaled(runs[_ACROSS])
    distance = np.hypot(runs[_ALONG].values, runs[_ACROSS].values)
    for place in np.argsort(-distance, kind="stable")[:_WORST]:
        axes.annotate(
            str(runs["run"].values[place]),
            (along.values[place], across.values[place]),
            (4.0, 3.0),
            textcoords="offset points",
            fontsize=8.0,
        )


def _spreads_across(runs: "xarray.Dataset") -> bool:
    if _ACROSS not in runs or runs.sizes["run"] == 0:
        return False
    return bool(np.std(runs[_ACROSS].values) > _CROSSRANGE_SPREAD)


def draw_footprint(
    axes: "matplotlib.axes.Axes",
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
) -> None:
    """Altitude error over downrange error, with a legend of the end conditions."""
    _draw_ends(axes, runs, nominal, _UP)
    axes.set_title(count(runs), loc="left")
    legend(axes)


def _draw_ends(
    axes: "matplotlib.axes.Axes",
    runs: "xarray.Dataset",
    nominal: "xarray.Dataset | None",
    error: str,
) -> None:
    """Draw the ends of the runs relative to the target, by end condition."""
    axes.axhline(0.0, color=MUTED, lw=0.8)
    axes.axvline(0.0, color=MUTED, lw=0.8)
    along, aside = scaled(runs[_ALONG]), scaled(runs[error])
    size = np.clip(4000.0 / max(runs.sizes["run"], 1), 3.0, 18.0)
    ends = _by_end(runs).items()
    for (label, ended), color in zip(ends, itertools.cycle(ENDS), strict=False):
        axes.scatter(
            along.values[ended],
            aside.values[ended],
            s=size,
            color=color,
            alpha=0.6,
            lw=0,
            label=label,
        )
    if nominal is not None:
        axes.plot(
            nominal[_ALONG].values / along.size,
            nominal[error].values / aside.size,
            "+",
            color=NOMINAL,
            ms=10,
            mew=1.6,
            label="nominal",
        )
    axes.set_xlabel(along.label)
    axes.set_ylabel(aside.label)


def _by_end(runs: "xarray.Dataset") -> dict[str, np.ndarray]:
    """Masks of the runs that each end condition ended, by the label in the legend."""
    if "ended_by" not in runs or "flag_meanings" not in runs["ended_by"].attrs:
        return {"runs": np.ones(runs.sizes["run"], dtype=bool)}
    codes = runs["ended_by"].values
    attributes = runs["ended_by"].attrs
    names = dict(
        zip(
            np.atleast_1d(attributes["flag_values"]),
            attributes["flag_meanings"].split(),
            strict=True,
        )
    )
    return {
        f"ended by {in_words(names[code])}": codes == code for code in np.unique(codes)
    }
