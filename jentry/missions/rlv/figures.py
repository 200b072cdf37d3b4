"""Figures of the RLV mission: what is tracked over the velocity, and what it costs."""

from typing import TYPE_CHECKING

from ...plots.figure_data import FigureData
from ...plots.style import NOMINAL, RUNS, panelled, scaled
from .scenario import JUDGED_BELOW


if TYPE_CHECKING:
    import matplotlib.figure


TRACKED = "drag_deviation", "angle_of_attack_deviation"
FLOWN = "angle_of_attack", "bank_angle", "flight_path_angle"


def deviations(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Every run over the velocity: how far drag and angle of attack are off."""
    return _over_velocity(data, TRACKED)


def flown(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Every run over the velocity: angle of attack, bank and flight-path angle."""
    return _over_velocity(data, FLOWN)


def _over_velocity(
    data: FigureData, names: tuple[str, ...]
) -> "matplotlib.figure.Figure | None":
    runs, nominal = data.trajectories, data.nominal
    if runs is None:
        return None
    figure, panels = panelled(4.4 * len(names), 3.6, len(names), data.title)
    velocity = scaled(runs["velocity"])
    for axes, name in zip(panels, names, strict=True):
        drawn = scaled(runs[name])
        axes.plot(
            velocity.values.T, drawn.values.T, color=RUNS, lw=0.4, alpha=0.25
        )
        if nominal is not None:
            alone = scaled(nominal[name])
            axes.plot(
                scaled(nominal["velocity"]).values.T,
                alone.values.T * (alone.size / drawn.size),
                color=NOMINAL,
                lw=1.0,
            )
        axes.set(xlabel=velocity.label, ylabel=drawn.label)
        axes.set_xlim(JUDGED_BELOW / velocity.size, None)
        axes.invert_xaxis()
    return data.noted(figure, histories=True)
