"""The entry corridor: limits of the path constraints, with flights."""

import itertools
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from .._printed import in_words
from .._programs import cached
from ..motion.corridor import bounding, entry_corridor
from ..units import at_edge
from .bands import at_velocity, velocity_grid
from .figure_data import FigureData
from .style import ENDS, legend, panelled, scaled, typeset
from .trajectories import ALTITUDE, DRAG


if TYPE_CHECKING:
    import matplotlib.figure


_VELOCITIES = 80
"""Number of velocities at which the limits are drawn"""

_MARGIN = 1.3
"""Largest drag of the figure, in units of the largest drag of the runs and the limits"""


def corridor(data: FigureData) -> "matplotlib.figure.Figure | None":
    """Altitude and drag over velocity, with the limit of each path constraint.

    The limits are those of `Scenario.constraints` for level flight with the angle of attack
    of the nominal flight at that velocity.

    **Returns:** the figure. None if there are no trajectories, or if no constraint has a
    limit and a value at each point.
    """
    scenario, runs, flown = data.scenario, data.trajectories, data.nominal
    if scenario is None or runs is None or flown is None:
        return None
    held = bounding(scenario.constraints)
    velocity = velocity_grid(flown["velocity"].values, _VELOCITIES)
    if not held or not velocity.size:
        return None
    (angle,) = at_velocity(
        flown["velocity"].values, flown["angle_of_attack"].values, velocity
    )
    curves = cached(entry_corridor)(
        held,
        scenario.planet,
        scenario.vehicle,
        scenario.initial_state,
        jnp.asarray(velocity),
        jnp.asarray(angle),
        scenario.dynamics,
    )
    shown = [each for each in (ALTITUDE, DRAG) if each.name in runs]
    figure, panels = panelled(5.6 * len(shown), 4.2, len(shown), data.title)
    for axes, trajectory in zip(panels, shown, strict=True):
        trajectory.draw(axes, runs, flown)
        size = scaled(runs[trajectory.name]).size
        speed = scaled(runs["velocity"]).size
        colours = itertools.cycle(ENDS[1:])
        flown_values = runs[trajectory.name].values
        if not np.isfinite(flown_values).any():
            return None
        largest = [np.nanmax(flown_values) / size]
        for (name, point), colour in zip(curves.items(), colours, strict=False):
            limit = np.asarray(getattr(point, trajectory.name)) / size
            label = _limit_in_words(name, held[name])
            axes.plot(velocity / speed, limit, color=colour, lw=1.6, label=label)
            if np.isfinite(limit).any():
                largest.append(np.nanmin(limit))
        axes.set_ylim(bottom=0.0)
        if trajectory is DRAG:
            axes.set_ylim(top=_MARGIN * max(largest))
        legend(axes)
    return data.noted(figure, histories=True)


def _limit_in_words(name: str, constraint) -> str:
    unit = constraint.shown_unit or constraint.unit
    limit, unit = at_edge(constraint.limit, unit)
    unit = "" if unit == "1" else f" {typeset(unit)}"
    return f"{in_words(name)}, {float(limit):.4g}{unit}"
