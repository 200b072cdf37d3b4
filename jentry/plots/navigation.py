"""Figure of the errors of the navigation over time."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..campaign.outputs import navigated
from ..fields import units_of
from ..flight.flight import History
from ..flight.miss import Misses
from ..flight.scenario import Scenario
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..units import edge_unit
from ..world.planet import Planet
from .style import MEAN, NOMINAL, RUNS, in_style, legend_above, panelled, typeset


if TYPE_CHECKING:
    import matplotlib.figure
    import xarray


_MOST = 100
"""Number of runs that are drawn"""

_PANELS = "downrange", "crossrange", "altitude", "velocity"


def draw_navigation_errors(
    scenario: Scenario,
    flown: "History | xarray.Dataset",
    title: str = "",
    deviations: Mapping[str, Any] | None = None,
) -> "matplotlib.figure.Figure":
    """Errors of the navigation over time, believed minus actual.

    Downrange and crossrange are those of the believed place from the actual one, along and
    across the actual heading, as arcs on the ground. Crossrange is positive to the left.

    **Arguments:**

    - `flown`: history of one flight, `flight.history`, or results of a campaign with
      histories, of which the first hundred runs are drawn.
    - `deviations`: standard deviations by the names `downrange`, `crossrange`, `altitude`
      (m) and `velocity` (m/s), of shape (time,) or (runs, time), such as those of a filter.
      Three of them are drawn on both sides of zero; of many runs their root mean square.

    **Raises:** `ValueError` without what the vehicle believes, and for another name of
    standard deviations.
    """
    deviations = {} if deviations is None else deviations
    for name in deviations:
        if name not in _PANELS:
            raise ValueError(
                f"deviations has {name!r}: choose from {', '.join(_PANELS)}"
            )
    time, actual, believed = _states(flown)
    errors = _errors(scenario.planet, actual, believed)
    units = units_of(Misses)
    with in_style():
        width = 4.3 * len(_PANELS)
        figure, panels = panelled(width, 3.9, len(_PANELS), title, measured=True)
        for axes, name in zip(panels, _PANELS, strict=True):
            unit, size = edge_unit(units[name], errors[name])
            drawn = errors[name][:_MOST].T / size
            if drawn.shape[1] == 1:
                axes.plot(time, drawn, color=RUNS, lw=1.3)
            else:
                lines = axes.plot(time, drawn, color=RUNS, lw=0.6, alpha=0.45)
                lines[0].set_label(f"{drawn.shape[1]} runs")
            axes.axhline(0.0, color=NOMINAL, lw=0.8)
            if name in deviations:
                three = 3.0 * _root_mean_square(deviations[name]) / size
                dashed = {"color": MEAN, "lw": 1.2, "ls": (0, (5, 3))}
                axes.plot(time, three, label="3 standard deviations", **dashed)
                axes.plot(time, -three, **dashed)
            axes.set_xlabel("Time (s)")
            axes.set_ylabel(
                f"{name.capitalize()}, believed minus actual ({typeset(unit)})"
            )
            legend_above(axes)
    return figure


def _states(
    flown: "History | xarray.Dataset",
) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Times, and actual and believed states by component, of shape (runs, time)."""
    names = list(units_of(EntryState))
    if isinstance(flown, History):
        if flown.navigated is None:
            raise ValueError(
                "the history has no navigated states: navigation is perfect"
            )
        time = np.asarray(flown.time)
        if time.ndim != 1:
            raise ValueError(
                f"the history has the shape {time.shape}: give that of one flight, or for "
                "many the results of their campaign, `campaign.to_xarray`"
            )
        states = flown.states, flown.navigated
        found = [{n: np.asarray(getattr(s, n))[None] for n in names} for s in states]
        return time, found[0], found[1]
    if "time" not in flown.dims or navigated(names[0]) not in flown:
        raise ValueError(
            "the results have no histories of navigated states: fly with a navigation that "
            "is not perfect, and with history=1.0"
        )
    first = flown.isel(run=slice(_MOST))
    actual = {name: first[name].values for name in names}
    believed = {name: first[navigated(name)].values for name in names}
    return flown["time"].values, actual, believed


def _errors(
    planet: Planet, actual: dict[str, np.ndarray], believed: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Errors by the names of the panels, (runs, time)."""

    @jax.jit
    @jax.vmap
    @jax.vmap
    def along_and_across(here, there):
        return ground_track(planet, EntryState(**here), EntryState(**there))

    along, across = along_and_across(actual, believed)
    return {
        "downrange": np.asarray(along),
        "crossrange": np.asarray(across),
        "altitude": believed["altitude"] - actual["altitude"],
        "velocity": believed["velocity"] - actual["velocity"],
    }


def _root_mean_square(deviations: Any) -> np.ndarray:
    """Root mean square over the runs that still fly; NaN where none does."""
    square = np.square(np.atleast_2d(np.asarray(deviations, dtype=float)))
    flying = np.isfinite(square)
    count = flying.sum(axis=0)
    mean = np.where(flying, square, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(mean), np.nan)
