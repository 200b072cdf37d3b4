"""All figures of a campaign."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._files import write_whole
from ..flight.termination import has_end
from .errors import draw_downrange, draw_footprint, footprint
from .glide import CONTROLS, STATES, constraints_of, end_errors, over_time
from .style import in_style, legend, note, panelled
from .trajectories import HISTORIES, draw_bank, draw_drag


if TYPE_CHECKING:
    import matplotlib.figure
    import xarray


_OVER_TIME = {"states": STATES, "controls": CONTROLS}


def campaign_figures(
    results: "xarray.Dataset",
    trajectories: "xarray.Dataset | None" = None,
    nominal: "xarray.Dataset | None" = None,
    title: str = "",
) -> dict[str, "matplotlib.figure.Figure"]:
    """Every figure of a campaign, by name.

    - `drag`, `altitude`: percentile bands of the runs at equal velocity, with the
      nominal flight as the reference line.
    - `bank`: the same at equal time.
    - `downrange`: histogram of the downrange error, actual minus desired.
    - `footprint`: altitude error, and crossrange error if there is any, over downrange
      error.

    - where the target has a direction, in place of these two: `end_errors`, miss
      distance and errors, and every run over time in `states`, `controls` and
      `constraints`.

    All over velocity or time need `trajectories`. Runs that did not stay finite are left
    out, and each figure says how many.

    **Arguments:**

    - `results`: all runs, as of `jentry.campaign.results.dataset`.
    - `trajectories`: some runs with histories, on (run, time), NaN after the end.
    - `nominal`: the same of one flight.
    - `title`: above each figure.

        figures = campaign_figures(results, trajectories, nominal, mission.title)
        save_figures(figures, "figures")
    """
    flown, left_out = _finite_runs(results)
    figures = {}
    with in_style():
        if trajectories is not None:
            kept, lost = _finite_runs(trajectories)
            for name, draw in HISTORIES.items():
                figures[name], (axes,) = panelled(6.4, 4.2, 1, title)
                draw(axes, kept, nominal)
                legend(axes)
                note(figures[name], lost, trajectories)
        if "heading_error" not in results:
            figures["downrange"], (axes,) = panelled(6.4, 4.2, 1, title)
            draw_downrange(axes, flown)
            note(figures["downrange"], left_out, results)
            figures["footprint"] = footprint(flown, nominal, title)
            note(figures["footprint"], left_out, results)
            return figures
        figures["end_errors"] = end_errors(flown, title)
        note(figures["end_errors"], left_out, results)
        if trajectories is not None:
            shown = _OVER_TIME | {"constraints": constraints_of(kept)}
            for name, quantities in shown.items():
                if not quantities:
                    continue
                figures[name] = over_time(kept, quantities, title=title)
                note(figures[name], lost, trajectories)
    return figures


def overview(
    results: "xarray.Dataset",
    trajectories: "xarray.Dataset | None" = None,
    nominal: "xarray.Dataset | None" = None,
    title: str = "",
) -> "matplotlib.figure.Figure":
    """One wide figure of a campaign: drag, bank and downrange error.

    Where the target has a direction, miss distance and errors in its place.

    Arguments as of `campaign_figures`. Without `trajectories` there are the downrange
    error and the footprint.
    """
    flown, left_out = _finite_runs(results)
    if "heading_error" in results:
        figure = end_errors(flown, title)
        note(figure, left_out, results)
        return figure
    with in_style():
        if trajectories is None:
            figure, (histogram, ends) = panelled(11.0, 3.6, 2, title)
            draw_footprint(ends, flown, nominal)
        else:
            figure, (drag, bank, histogram) = panelled(11.0, 3.6, 3, title)
            kept, _ = _finite_runs(trajectories)
            draw_drag(drag, kept, nominal)
            draw_bank(bank, kept, nominal)
            legend(drag)
        draw_downrange(histogram, flown)
        note(figure, left_out, results)
    return figure


def save_figures(
    figures: Mapping[str, "matplotlib.figure.Figure"], folder: str | Path
) -> list[Path]:
    """Write each figure as `folder/<name>.png`, 150 dots per inch, and say where."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        drawn = io.BytesIO()
        with in_style():
            figure.savefig(drawn, format="png", dpi=150)
        paths.append(folder / f"{name}.png")
        write_whole(paths[-1], drawn.getvalue())
    return paths


def _finite_runs(runs: "xarray.Dataset") -> tuple["xarray.Dataset", int]:
    """The runs that stayed finite and have an end, and the number of others."""
    good = np.ones(runs.sizes["run"], dtype=bool)
    if "outcome" in runs:
        good &= has_end(runs["outcome"].values)
    for name in ("downrange_error", "crossrange_error", "altitude_error"):
        if name in runs:
            good &= np.isfinite(runs[name].values)
    return runs.isel(run=good), int((~good).sum())
