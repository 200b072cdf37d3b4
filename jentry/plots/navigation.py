"""Figure of the errors of the navigation over time."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..campaign.outputs import navigated, navigation_deviation_of
from ..fields import units_of
from ..flight.flight import History
from ..flight.scenario import Scenario
from ..motion.state import EntryState
from ..onboard.inertial import TrackError, track_difference
from ..units import edge_unit
from ..world.planet import Planet
from .style import MEAN, NOMINAL, RUNS, in_style, legend_above, panelled, typeset


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure
    import xarray


_MOST = 100
"""Number of runs that are drawn"""

_PANELS = tuple(units_of(TrackError))


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
      (m) and `velocity` (m/s), of shape (time,) or (runs, time). None for those of the
      filter, if there is one. Three of them are drawn on both sides of zero; of many runs
      their root mean square. Where these fall to less than a twentieth, the scale is
      logarithmic on both sides of a linear part about zero.

    **Raises:** `ValueError` without what the vehicle believes, and for another name of
    standard deviations.
    """
    words = "3 standard deviations"
    if deviations is None:
        deviations, words = _of_filter(flown), "3 sigma of the filter"
    for name in deviations:
        if name not in _PANELS:
            raise ValueError(
                f"deviations has {name!r}: choose from {', '.join(_PANELS)}"
            )
    time, actual, believed = _states(flown)
    errors = _errors(scenario.planet, actual, believed)
    units = units_of(TrackError)
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
                axes.plot(time, three, label=words, **dashed)
                axes.plot(time, -three, **dashed)
                _scale(axes, three)
            axes.set_xlabel("Time (s)")
            axes.set_ylabel(
                f"{name.capitalize()}, believed minus actual ({typeset(unit)})"
            )
            legend_above(axes)
    return figure


_MUCH = 20.0
"""Ratio of standard deviations in a flight above which a linear scale hides the smaller"""


def _scale(axes: "matplotlib.axes.Axes", deviations: np.ndarray) -> None:
    """Scale on which the largest and the smallest of the deviations can be read."""
    found = deviations[np.isfinite(deviations) & (deviations > 0.0)]
    if not found.size or found.max() < _MUCH * found.min():
        return
    linear = 10.0 ** np.round(np.log10(found.min()))
    axes.set_yscale("symlog", linthresh=linear)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))


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


def _of_filter(flown: "History | xarray.Dataset") -> dict[str, np.ndarray]:
    """Standard deviations of the filter by the names of the panels; none without one."""
    if isinstance(flown, History):
        known = None if flown.knowledge is None else flown.knowledge.track_deviation
        return {} if known is None else _by_panel(known)
    names = {name: navigation_deviation_of(name) for name in _PANELS}
    first = flown.isel(run=slice(_MOST))
    return {n: first[column].values for n, column in names.items() if column in first}


def _errors(
    planet: Planet, actual: dict[str, np.ndarray], believed: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Errors by the names of the panels, (runs, time)."""

    @jax.jit
    @jax.vmap
    @jax.vmap
    def between(here, there):
        return track_difference(planet, EntryState(**here), EntryState(**there))

    return _by_panel(between(actual, believed))


def _by_panel(errors: TrackError) -> dict[str, np.ndarray]:
    return {name: np.asarray(getattr(errors, name)) for name in _PANELS}


def _root_mean_square(deviations: Any) -> np.ndarray:
    """Root mean square over the runs that still fly; NaN where none does."""
    square = np.square(np.atleast_2d(np.asarray(deviations, dtype=float)))
    flying = np.isfinite(square)
    count = flying.sum(axis=0)
    mean = np.where(flying, square, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, np.sqrt(mean), np.nan)
