"""Compares campaigns: the distributions of their errors."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..campaign.outputs import is_error
from ..campaign.populations import finite_flights
from .style import ENDS, MUTED, in_style, panelled, scaled


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray


_PANELS = 3
"""Largest number of panels in a row"""
_WIDTH, _HEIGHT = 4.2, 3.4
"""Width and height of a panel, inches"""
_LINE, _HANDLE, _LETTER = 0.2, 0.5, 0.075
"""Legend in inches: height of a line, width without text, width of a letter"""
_DASHES = "-", "--", ":"
"""Line styles, which change when all colours are used"""


def draw_comparison(
    campaigns: "Mapping[str, xarray.Dataset]", names: Sequence[str], title: str = ""
) -> "matplotlib.figure.Figure":
    """Cumulative distribution of outputs, with one curve for each campaign.

    A run without a finite flight is below no value, so that its campaign does not reach
    100 %.

    **Arguments:**

    - `campaigns`: results by the name for the legend.
    - `names`: outputs that all campaigns have. For errors the magnitude is drawn.
    """
    flown = {name: finite_flights(results) for name, results in campaigns.items()}
    runs = {name: results.sizes["run"] for name, results in campaigns.items()}
    told = {name: _told(name, x.sizes["run"], runs[name]) for name, x in flown.items()}
    names = list(names)[:_PANELS]
    width = _WIDTH * len(names)
    columns = int(width / (_HANDLE + _LETTER * max(map(len, told.values())))) or 1
    columns = min(columns, len(told))
    height = _HEIGHT + _LINE * -(-len(told) // columns)
    with in_style():
        figure, panels = panelled(width, height, len(names), title, measured=True)
        for axes, name in zip(panels, names, strict=True):
            outputs = {told[each]: x[name] for each, x in flown.items()}
            _draw_shares(axes, outputs, list(runs.values()))
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=columns)
    return figure


def _told(name: str, finite: int, runs: int) -> str:
    """Label of a campaign in the legend."""
    return (
        f"{name}, {runs} runs" if finite == runs else f"{name}, {finite} of {runs} runs"
    )


def _draw_shares(
    axes: "matplotlib.axes.Axes",
    outputs: "Mapping[str, xarray.DataArray]",
    runs: Sequence[int],
) -> None:
    """Share of all runs below each value of one output, in one unit for all campaigns."""
    import xarray

    magnitude = is_error(str(next(iter(outputs.values())).name))
    joined = xarray.concat(
        list(outputs.values()), dim="run", combine_attrs="override", join="outer"
    )
    drawn = scaled(joined)
    looks = itertools.cycle(itertools.product(_DASHES, ENDS))
    for (dashes, colour), (words, output), all_runs in zip(
        looks, outputs.items(), runs, strict=False
    ):
        values = output.values / drawn.size
        values = np.sort(np.abs(values) if magnitude else values)
        # A step at each run, starting from zero.
        values = np.concatenate([values[:1], values])
        axes.step(
            values,
            100.0 * np.arange(values.size) / all_runs,
            where="post",
            color=colour,
            ls=dashes,
            label=words,
        )
    label = drawn.label
    if magnitude:
        what, bracket, unit = label.partition(" (")
        label = f"|{what}|{bracket}{unit}"
        axes.set_xlim(left=0.0)
    axes.set_xlabel(label)
    axes.set_ylabel("Runs below (%)")
    axes.set_ylim(0.0, 100.0)
    axes.axhline(95.0, color=MUTED, lw=0.8, ls=(0, (2, 2)))
