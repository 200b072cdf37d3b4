"""Figure of one flight: path, controls, path constraints and ground track."""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from .._printed import in_words
from ..flight.flight import Flight, History
from ..flight.scenario import Scenario
from ..units import degree, km
from .navigation import draw_navigation_errors
from .style import ENDS, MUTED, NOMINAL, RUNS, in_style, legend_above, panelled


if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure


def draw_flight(
    scenario: Scenario, flight: Flight, title: str = ""
) -> "matplotlib.figure.Figure":
    """Altitude over velocity, controls and path constraints over time, and ground track.

    The commanded bank and angle of attack are drawn as well if the history has them.

    **Raises:** `ValueError` for a flight without a history.
    """
    history = flight.history
    if history is None:
        raise ValueError(
            "the flight has no history to draw: store one, fly(..., history=1.0)"
        )
    draw = [_path, _controls]
    if _limited(scenario):
        draw.append(_limits)
    if scenario.dynamics.has_crossrange:
        draw.append(_track)
    with in_style():
        figure, panels = panelled(4.3 * len(draw), 3.9, len(draw), title, measured=True)
        for axes, panel in zip(panels, draw, strict=True):
            panel(axes, scenario, flight, history)
            legend_above(axes)
    return figure


def flight_figures(
    scenario: Scenario, flight: Flight, title: str = "", name: str = "flight"
) -> "dict[str, matplotlib.figure.Figure]":
    """Figures of one flight: `draw_flight` by its name and, unless navigation is perfect,
    `draw_navigation_errors` by the name with `-navigation`.

    **Raises:** `ValueError` for a flight without a history.
    """
    figures = {name: draw_flight(scenario, flight, title)}
    history = flight.history
    if history is not None and history.navigated is not None:
        errors = draw_navigation_errors(scenario, history, title)
        figures[f"{name}-navigation"] = errors
    return figures


def _limited(scenario: Scenario) -> dict[str, float]:
    """Positive limits of the path constraints, of which shares can be drawn."""
    limits = {name: each.limit for name, each in scenario.constraints.items()}
    return {n: float(x) for n, x in limits.items() if x is not None and float(x) > 0.0}


def _flown(history: History, values, end=None) -> np.ndarray:
    """Values during the flight, followed by the value at its end if one is passed."""
    flown = np.asarray(values)[np.isfinite(np.asarray(history.time))]
    return flown if end is None else np.append(flown, np.asarray(end))


def _path(
    axes: "matplotlib.axes.Axes", scenario: Scenario, flight: Flight, history: History
) -> None:
    states, end = history.states, flight.state
    velocity = _flown(history, states.velocity, end.velocity)
    altitude = _flown(history, states.altitude, end.altitude)
    axes.plot(velocity, altitude / km, color=RUNS)
    axes.plot(velocity[-1], altitude[-1] / km, "o", color=NOMINAL, ms=4.0)
    axes.invert_xaxis()
    axes.set_xlabel("Velocity (m/s)")
    axes.set_ylabel("Altitude (km)")
    axes.set_title("time →", loc="right", color=MUTED)


def _controls(
    axes: "matplotlib.axes.Axes", scenario: Scenario, flight: Flight, history: History
) -> None:
    time = _flown(history, history.time)
    lines = [("", history.controls, "-")]
    if history.commands is not None:
        lines.insert(0, ("commanded ", history.commands, ":"))
    for kind, controls, style in lines:
        bank = np.arctan2(np.asarray(controls.sin_bank), np.asarray(controls.cos_bank))
        for name, values, colour in (
            ("bank", bank, ENDS[0]),
            ("angle of attack", controls.angle_of_attack, ENDS[1]),
        ):
            angle = _flown(history, values) / degree
            axes.plot(time, angle, color=colour, ls=style, lw=1.3, label=kind + name)
    axes.set_xlabel("Time (s)")
    axes.set_ylabel("Controls (deg)")


def _limits(
    axes: "matplotlib.axes.Axes", scenario: Scenario, flight: Flight, history: History
) -> None:
    time = _flown(history, history.time)
    colours = itertools.cycle(ENDS)
    for name, limit in _limited(scenario).items():
        share = _flown(history, history.constraints[name]) / limit
        axes.plot(time, share, color=next(colours), label=in_words(name))
    axes.axhline(1.0, color=NOMINAL, lw=1.0, ls=(0, (5, 3)))
    axes.set_xlabel("Time (s)")
    axes.set_ylabel("Share of the limit")
    axes.set_ylim(bottom=0.0)


def _track(
    axes: "matplotlib.axes.Axes", scenario: Scenario, flight: Flight, history: History
) -> None:
    states, end = history.states, flight.state
    longitude = _flown(history, states.longitude, end.longitude) / degree
    latitude = _flown(history, states.latitude, end.latitude) / degree
    axes.plot(longitude, latitude, color=RUNS)
    axes.plot(longitude[-1], latitude[-1], "o", color=NOMINAL, ms=4.0)
    axes.set_xlabel("Longitude (deg)")
    axes.set_ylabel("Latitude (deg)")
