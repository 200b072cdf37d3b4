"""Campaigns beside one another: how their errors are distributed."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..campaign.outputs import is_error
from ..campaign.populations import finite_flights
from .style import ENDS, MUTED, count, in_style, legend_above, panelled, scaled


if TYPE_CHECKING:
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
            for colour, (words, runs) in zip(ENDS, flown.items(), strict=False):
                drawn = scaled(runs[name])
                values = np.abs(drawn.values) if is_error(name) else drawn.values
                # A step at each of the runs, from none of them on.
                values = np.sort(values)
                shares = np.arange(1, values.size + 1) / values.size
                label = f"{words}, {count(runs)}"
                axes.step(
                    values, 100.0 * shares, where="post", color=colour, label=label
                )
                axes.set_xlabel(f"|{drawn.label}" if is_error(name) else drawn.label)
            if is_error(name):
                what, bracket, unit = axes.get_xlabel().partition(" (")
                axes.set_xlabel(f"{what}|{bracket}{unit}")
                axes.set_xlim(left=0.0)
            axes.set_ylabel("Flights below (%)")
            axes.set_ylim(0.0, 100.0)
            axes.axhline(95.0, color=MUTED, lw=0.8, ls=(0, (2, 2)))
        legend_above(panels[0])
    return figure
