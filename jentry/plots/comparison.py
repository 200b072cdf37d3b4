"""Campaigns beside one another: how their errors are distributed."""

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
"""Of a row"""


def draw_comparison(
    campaigns: "Mapping[str, xarray.Dataset]", names: Sequence[str], title: str = ""
) -> "matplotlib.figure.Figure":
    """Share of the flights below each value of an output, campaigns over one another.

    **Arguments:**

    - `campaigns`: results by what the legend calls them.
    - `names`: outputs that all of them have. Of what is an error the magnitude is drawn.
    """
    flown = {name: finite_flights(results) for name, results in campaigns.items()}
    names = list(names)[:_PANELS]
    with in_style():
        figure, panels = panelled(4.2 * len(names), 3.6, len(names), title)
        for axes, name in zip(panels, names, strict=True):
            _draw_shares(axes, {words: runs[name] for words, runs in flown.items()})
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _draw_shares(
    axes: "matplotlib.axes.Axes", outputs: "Mapping[str, xarray.DataArray]"
) -> None:
    """Share of the flights below each value of one output, in one unit for all."""
    import xarray

    magnitude = is_error(str(next(iter(outputs.values())).name))
    joined = xarray.concat(
        list(outputs.values()), dim="run", combine_attrs="override", join="outer"
    )
    drawn = scaled(joined)
    for colour, (words, output) in zip(
        itertools.cycle(ENDS), outputs.items(), strict=False
    ):
        values = output.values / drawn.size
        values = np.sort(np.abs(values) if magnitude else values)
        # A step at each of the runs, from none of them on.
        shares = 100.0 * np.arange(1, values.size + 1) / values.size
        axes.step(
            np.insert(values, 0, values[:1]),
            np.insert(shares, 0, 0.0),
            where="post",
            color=colour,
            label=f"{words}, {values.size} runs",
        )
    label = drawn.label
    if magnitude:
        what, bracket, unit = label.partition(" (")
        label = f"|{what}|{bracket}{unit}"
        axes.set_xlim(left=0.0)
    axes.set_xlabel(label)
    axes.set_ylabel("Flights below (%)")
    axes.set_ylim(0.0, 100.0)
    axes.axhline(95.0, color=MUTED, lw=0.8, ls=(0, (2, 2)))
