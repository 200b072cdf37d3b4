"""Common style of all figures: colours, fonts, headings and legends."""

import contextlib
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._printed import in_words
from ..campaign.outputs import shown, unit_size


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray
    from matplotlib.typing import RcKeyType


RUNS = "#0072B2"
"""Blue of Okabe and Ito, for everything that shows many runs"""
ENDS = (RUNS, "#E69F00", "#CC79A7", "#009E73", "#56B4E9", "#D55E00")
"""Colours of the colour-blind-safe palette of Okabe and Ito, for runs by end condition"""
NOMINAL = "#1A1A1A"
RUNS_LIGHT = "#80B9D9"
"""`RUNS`, mixed with an equal part of white"""
MEAN = "#D55E00"
MUTED = "#6E6E6E"

_STYLE: "dict[RcKeyType, Any]" = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.labelsize": 10.0,
    "axes.titlesize": 9.5,
    "legend.fontsize": 9.0,
    "legend.edgecolor": "none",
    "legend.framealpha": 0.85,
    "legend.handlelength": 1.6,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": NOMINAL,
    "ytick.labelcolor": NOMINAL,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
}

_MANY_POINTS = 20_000
"""Number of points from which the best place of a legend is not searched"""


@contextlib.contextmanager
def in_style():
    import matplotlib

    with matplotlib.rc_context(_STYLE):
        yield


_LEFT, _RIGHT, _BELOW, _ABOVE, _BETWEEN = 0.85, 0.2, 0.65, 0.55, 0.9
"""Margins of the panels of a figure, inches, for numbers of seven digits and a title"""


def panelled(
    width: float, height: float, panels: int, title: str, *, measured: bool = False
) -> tuple["matplotlib.figure.Figure", "list[matplotlib.axes.Axes]"]:
    """A figure of this size (inches) with panels side by side, under one title.

    The margins of the panels are fixed. With `measured` they are fitted to their contents,
    such as a legend or long labels, which takes a quarter of the time of a figure.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    axes = list(figure.subplots(1, panels, squeeze=False).flat)
    if measured:
        figure.set_layout_engine("constrained", w_pad=0.08, h_pad=0.06, wspace=0.04)
    else:
        each = (width - _LEFT - _RIGHT - (panels - 1) * _BETWEEN) / panels
        figure.subplots_adjust(
            left=_LEFT / width,
            right=1.0 - _RIGHT / width,
            bottom=_BELOW / height,
            top=1.0 - _ABOVE / height,
            wspace=_BETWEEN / each,
        )
    if title:
        # A letter is about half as wide as high, and its height is in points of 1/72 inch.
        fits = 72.0 * width / (0.55 * len(title))
        figure.suptitle(title, fontsize=min(11.0, fits))
    return figure, axes


class Scaled(NamedTuple):
    """A variable of a result as it is drawn."""

    values: Any
    label: str
    """Label of an axis: quantity and unit"""
    unit: str
    size: float
    """SI value of the unit"""


def scaled(variable: "xarray.DataArray") -> Scaled:
    """A variable in its usual display unit, with the label of its axis.

    The results store the name and the unit, which come from the fields of the flight.
    """
    values, unit = shown(variable)
    words = variable.attrs.get("long_name", in_words(str(variable.name)))
    label = f"{words[:1].upper()}{words[1:]}"
    if unit != "1":
        label += f" ({typeset(unit)})"
    return Scaled(values, label, unit, unit_size(variable))


def typeset(unit: str) -> str:
    """A unit with superscript powers: `m/s2` becomes m/s²."""
    return re.sub("(?<=[A-Za-z])[23]", lambda m: "²³"["23".index(m[0])], unit)


def note(
    figure: "matplotlib.figure.Figure", left_out: int, runs: "xarray.Dataset"
) -> None:
    """Write below a figure how many runs are left out."""
    if left_out:
        total = left_out + runs.sizes["run"]
        text = f"{left_out} of {total} runs not finite or without an end: left out"
        figure.supxlabel(text, x=0.99, ha="right", fontsize=8.0, color=MUTED)


def count(runs: "xarray.Dataset") -> str:
    number = runs.sizes["run"]
    return "1 run" if number == 1 else f"{number} runs"


def legend_above(axes: "matplotlib.axes.Axes") -> None:
    """Draw a legend above the axes, for panels that are filled with lines."""
    handles, _ = axes.get_legend_handles_labels()
    if handles:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)


def legend(axes: "matplotlib.axes.Axes") -> None:
    """Draw a legend if there are labels. All its dots have the same size."""
    from matplotlib.collections import PathCollection

    handles, _ = axes.get_legend_handles_labels()
    if not handles:
        return
    points = sum(np.shape(scatter.get_offsets())[0] for scatter in axes.collections)
    place = "best" if points < _MANY_POINTS else "upper left"
    for handle in axes.legend(loc=place).legend_handles:
        if isinstance(handle, PathCollection):
            handle.set_sizes([24.0])
