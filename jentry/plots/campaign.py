"""Figures of a campaign by name, and their files."""

import functools
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Optional

from .._files import write_whole
from ..campaign.outputs import error_of, navigated
from . import errors, glide
from .entry_corridor import corridor
from .figure_data import FigureData
from .navigation import draw_navigation_errors
from .style import in_style, legend, panelled
from .trajectories import ALTITUDE, BANK, DRAG, Trajectory, draw_deviation


if TYPE_CHECKING:
    import matplotlib.figure


DrawFigure = Callable[[FigureData], Optional["matplotlib.figure.Figure"]]
"""Function that draws a figure of runs; it returns None if there is nothing to draw"""


def _of_trajectories(
    trajectory: Trajectory, data: FigureData
) -> "matplotlib.figure.Figure | None":
    runs = data.trajectories
    if runs is None or trajectory.name not in runs:
        return None
    figure, (axes,) = panelled(6.4, 4.2, 1, data.title)
    trajectory.draw(axes, runs, data.nominal)
    legend(axes)
    return data.noted(figure, histories=True)


def drag_deviation(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Bands of the drag minus that of the nominal flight, at equal velocity."""
    runs, nominal = data.trajectories, data.nominal
    if runs is None or nominal is None or DRAG.name not in runs:
        return None
    figure, (axes,) = panelled(6.4, 4.2, 1, data.title)
    draw_deviation(axes, DRAG.name, runs, nominal)
    legend(axes)
    return data.noted(figure, histories=True)


def downrange(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Histogram of the downrange error; None if the target is an orbit."""
    if not _aims_at_a_place(data):
        return None
    figure, (axes,) = panelled(6.4, 4.2, 1, data.title)
    errors.draw_downrange(axes, data.results)
    return data.noted(figure)


def footprint(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Altitude error, and crossrange error if there is any, over downrange error.

    None if the target is an orbit.
    """
    if not _aims_at_a_place(data):
        return None
    return data.noted(errors.footprint(data.results, data.nominal, data.title))


def end_errors(data: FigureData) -> "matplotlib.figure.Figure":
    """Histograms of the miss distance and of the errors in direction and velocity."""
    return data.noted(glide.end_errors(data.results, data.title))


def states(data: FigureData) -> "matplotlib.figure.Figure | None":
    """States of all runs over time."""
    return _all_over_time(data, glide.STATES)


def controls(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Angle of attack and bank angle of all runs over time."""
    return _all_over_time(data, glide.CONTROLS)


def constraints(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Path constraints of all runs over time, with their limits."""
    runs = data.trajectories
    return None if runs is None else _all_over_time(data, glide.constraints_of(runs))


def _all_over_time(data: FigureData, names: tuple[str, ...]):
    if data.trajectories is None or not names:
        return None
    figure = glide.over_time(data.trajectories, names, title=data.title)
    return data.noted(figure, histories=True)


def overview(data: FigureData) -> "matplotlib.figure.Figure | None":
    """One wide figure: drag, bank and downrange error.

    Without trajectories, or without their drag, it shows downrange error and footprint.
    """
    if not _aims_at_a_place(data):
        return None
    runs = data.trajectories
    if runs is None or DRAG.name not in runs:
        figure, (histogram, ends) = panelled(11.0, 3.6, 2, "")
        errors.draw_footprint(ends, data.results, data.nominal)
    else:
        figure, (drag, bank, histogram) = panelled(11.0, 3.6, 3, "")
        if data.nominal is None:
            DRAG.draw(drag, runs, None)
        else:
            draw_deviation(drag, DRAG.name, runs, data.nominal)
        BANK.draw(bank, runs, data.nominal)
        legend(drag)
    errors.draw_downrange(histogram, data.results)
    return data.noted(figure)


def _aims_at_a_place(data: FigureData) -> bool:
    return error_of("downrange") in data.results


def navigation(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Errors of the navigation over time; None where it is perfect."""
    runs, scenario = data.trajectories, data.scenario
    if runs is None or scenario is None or navigated("altitude") not in runs:
        return None
    figure = draw_navigation_errors(scenario, runs, data.title)
    return data.noted(figure, histories=True)


HISTORIES: Mapping[str, DrawFigure] = {
    "drag": functools.partial(_of_trajectories, DRAG),
    "drag_deviation": drag_deviation,
    "altitude": functools.partial(_of_trajectories, ALTITUDE),
    "bank": functools.partial(_of_trajectories, BANK),
    "corridor": corridor,
    "navigation": navigation,
}
"""Percentile bands of the runs at equal velocity, the bank of some runs over time, and the
errors of a navigation that is not perfect"""

USUAL: Mapping[str, DrawFigure] = {
    **HISTORIES,
    "downrange": downrange,
    "footprint": footprint,
    "overview": overview,
}
"""Default figures of a mission: bands, and errors along and across the track"""

GLIDE: Mapping[str, DrawFigure] = {
    "end_errors": end_errors,
    **HISTORIES,
    "states": states,
    "controls": controls,
    "constraints": constraints,
}
"""Figures of a glide to a target with a required heading: bands, errors, all runs over
time"""


def campaign_figures(
    data: FigureData, figures: Mapping[str, DrawFigure] = USUAL
) -> dict[str, "matplotlib.figure.Figure"]:
    """All figures of a campaign by name.

    Figures whose data are missing, such as trajectories or a limit, are left out.

    **Arguments:**

    - `data`: the runs, `FigureData.of(results, trajectories, nominal, scenario, title)`.
    - `figures`: figures to draw: `USUAL`, `GLIDE`, or your own functions by name.

        figures = campaign_figures(data, mission.figures)
        save_figures(figures, "figures")
    """
    with in_style():
        drawn = {name: draw(data) for name, draw in figures.items()}
    return {name: figure for name, figure in drawn.items() if figure is not None}


FORMATS = "png", "pdf", "svg"
"""Formats of figure files"""


def save_figures(
    figures: Mapping[str, "matplotlib.figure.Figure"],
    folder: str | Path,
    formats: Sequence[str] = FORMATS[:1],
) -> list[Path]:
    """Write each figure as `folder/<name>.png` with 150 dots per inch; return the paths.

    `formats` selects png, pdf and svg.

    **Raises:** `ValueError` for another format.
    """
    for unknown in set(formats) - set(FORMATS):
        raise ValueError(
            f"the format of figures is {unknown!r}: choose from {', '.join(FORMATS)}"
        )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        for kind in formats:
            paths.append(folder / f"{name}.{kind}")
            write_whole(paths[-1], _drawn(figure, kind))
    return paths


def _drawn(figure: "matplotlib.figure.Figure", kind: str) -> bytes:
    """The contents of a figure file. Equal figures give equal bytes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    drawn = io.BytesIO()
    with in_style():
        if kind == "png":
            # `savefig` would draw twice, the first time for the layout only.
            figure.set_dpi(150)
            # Files are a seventh larger than at the default level, which takes 0.1 s more.
            FigureCanvasAgg(figure).print_png(drawn, pil_kwargs={"compress_level": 1})
        else:
            date = {"CreationDate" if kind == "pdf" else "Date": None}
            figure.savefig(drawn, format=kind, metadata=date)
    return drawn.getvalue()
