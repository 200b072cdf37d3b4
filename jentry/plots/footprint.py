"""The landing footprint: its outline, and the ground tracks of its flights."""

from typing import TYPE_CHECKING

import jax
import numpy as np

from ..motion.quantities import ground_track
from ..planning.landing_footprint import Footprint
from ..units import km
from .style import MUTED, NOMINAL, RUNS, RUNS_LIGHT, in_style, legend, panelled


if TYPE_CHECKING:
    import matplotlib.figure


def draw_footprint(found: Footprint, title: str = "") -> "matplotlib.figure.Figure":
    """Downrange and crossrange of the points, with the ground tracks of their flights."""
    with in_style():
        figure, (axes,) = panelled(8.0, 5.0, 1, title)
        for number, best in enumerate(found.flights):
            downrange, crossrange = _track(best)
            label = "ground tracks" if number == 0 else None
            axes.plot(downrange, crossrange, color=RUNS_LIGHT, lw=0.8, label=label)
        ends = found.downrange / km, found.crossrange / km
        around = (np.append(x, x[0]) for x in ends)
        axes.plot(*around, color=RUNS, lw=1.4, label="outline of the ends")
        axes.plot(*ends, "o", color=NOMINAL, ms=4.0, label="flights found")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("Downrange (km)")
        axes.set_ylabel("Crossrange, to the left (km)")
        axes.set_title(f"{len(found.flights)} flights", loc="left")
        if found.failed:
            said = f"{len(found.failed)} directions without a flight"
            axes.set_title(said, loc="right", color=MUTED)
        legend(axes)
    return figure


def _track(best) -> tuple[np.ndarray, np.ndarray]:
    """Downrange and crossrange along a flight up to its end, km."""
    scenario, history = best.scenario, best.flight.history
    origin = scenario.target.origin
    origin = scenario.initial_state if origin is None else origin
    place = jax.vmap(lambda state: ground_track(scenario.planet, origin, state))
    flown = np.isfinite(np.asarray(history.time))
    along, across = (np.asarray(x)[flown] for x in place(history.states))
    last = ground_track(scenario.planet, origin, best.flight.state)
    along = np.append(along, float(last[0]))
    # An arc changes its sign beyond half of the circumference.
    along = np.unwrap(along / float(scenario.planet.radius))
    along = along * float(scenario.planet.radius)
    return along / km, np.append(across, float(last[1])) / km
