"""Figures of the RLV mission: deviations from the reference, and controls."""

from typing import TYPE_CHECKING

from ...plots.figure_data import FigureData
from ...plots.style import NOMINAL, RUNS, panelled, scaled
from .scenario import END_VELOCITY, gate


if TYPE_CHECKING:
    import matplotlib.figure


def deviations(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Every run over the velocity: deviations of drag and angle of attack."""
    return _over_velocity(data, ("drag_deviation", "angle_of_attack_deviation"))


def flown(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Every run over the velocity: angle of attack, bank and flight-path angle."""
    return _over_velocity(data, ("angle_of_attack", "bank_angle", "flight_path_angle"))


def _over_velocity(
    data: FigureData, names: tuple[str, ...]
) -> "matplotlib.figure.Figure | None":
    """Figure from the start of modulation on; the nominal flight is black."""
    runs, nominal = data.trajectories, data.nominal
    if runs is None:
        return None
    figure, panels = panelled(4.4 * len(names), 3.6, len(names), data.title)
    velocity = scaled(runs["velocity"])
    for axes, name in zip(panels, names, strict=True):
        drawn = scaled(runs[name])
        axes.plot(velocity.values.T, drawn.values.T, color=RUNS, lw=0.4, alpha=0.25)
        if nominal is not None:
            at, alone = nominal["velocity"], nominal[name]
            there = at.values.T / velocity.size, alone.values.T / drawn.size
            axes.plot(*there, color=NOMINAL, lw=1.0)
        axes.set(xlabel=velocity.label, ylabel=drawn.label)
        axes.set_xlim(
            float(gate().velocity) / velocity.size, END_VELOCITY / velocity.size
        )
    return data.noted(figure, histories=True)
