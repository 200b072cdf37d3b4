"""Flown runs as an `xarray.Dataset`, with units and long names."""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from ..addresses import unit_of
from ..fields import Scalar
from ..flight.scenario import Scenario
from ..flight.termination import Outcome
from ..motion.constraints import AbstractPathConstraint
from ..motion.state import Controls
from .campaign import Campaign


if TYPE_CHECKING:
    import xarray

_STATE = {
    "altitude": "m",
    "longitude": "rad",
    "latitude": "rad",
    "velocity": "m/s",
    "flight_path_angle": "rad",
    "heading": "rad",
}
_CONTROLS = {"bank_angle": "rad", "angle_of_attack": "rad"}
_MISSES = {
    "downrange": "m",
    "crossrange": "m",
    "altitude": "m",
    "velocity": "m/s",
    "flight_path_angle": "rad",
    "heading": "rad",
}


def _angles(controls: Controls) -> dict[str, Scalar]:
    return {name: getattr(controls, name) for name in _CONTROLS}


def _limit(constraint: AbstractPathConstraint) -> dict[str, float]:
    """The attribute of a variable that has a limit."""
    limit = constraint.limit
    return {} if limit is None else {"limit": float(limit)}


def _words(name: str) -> str:
    return name.replace("_", " ")


def dataset(
    scenario: Scenario, campaign: Campaign, history: float | None = None
) -> "xarray.Dataset":
    """Inputs by address, outcome, final state, misses, peaks and, if kept, histories.

    And the caveats of the law: a variable with the attribute `caveat` is a share, and
    where it is not zero the run did not go as the law is meant to.

    Dimensions: run, and time for histories, whose interval is `history` (s). Errors are
    actual minus desired.
    """
    import xarray

    flights = campaign.flights
    variables: dict[str, Any] = {}

    def put(name, values, unit, long_name, dims=("run",), **attributes):
        described = {"units": unit, "long_name": long_name, **attributes}
        variables[name] = (dims, np.asarray(values), described)

    for address, values in campaign.inputs.items():
        put(address, values, unit_of(scenario, address), f"input {address}")
    names = scenario.termination.names
    put(
        "outcome",
        np.asarray(flights.outcome, dtype=np.int8),
        "1",
        "how the flight ended",
        flag_values=np.array([int(o) for o in Outcome], dtype=np.int8),
        flag_meanings=" ".join(o.name.lower() for o in Outcome),
    )
    put(
        "ended_by",
        np.asarray(flights.ended_by, dtype=np.int8),
        "1",
        "end condition that was met",
        flag_values=np.arange(len(names), dtype=np.int8),
        flag_meanings=" ".join(names),
    )
    put("end_time", flights.time, "s", "time at the end")
    for name, unit in _STATE.items():
        values = getattr(flights.state, name)
        put(f"end_{name}", values, unit, f"{_words(name)} at the end")
    for name, unit in _MISSES.items():
        values = getattr(campaign.misses, name)
        if values is not None:
            words = f"{_words(name)} error, actual minus desired"
            put(f"{name}_error", values, unit, words)
    if scenario.target.heading is not None:
        distance = campaign.misses.distance
        put("miss_distance", distance, "m", "distance from the target at the end")
    for name, peak in flights.peaks.items():
        constraint, words = scenario.constraints[name], f"peak {_words(name)}"
        put(f"peak_{name}", peak, constraint.unit, words, **_limit(constraint))
        there = flights.at_peaks.get(name)
        if there is not None:
            put(f"peak_{name}_time", there.time, "s", f"time of the {words}")
            for component, unit in _STATE.items():
                value = getattr(there.state, component)
                long_name = f"{_words(component)} at the {words}"
                put(f"peak_{name}_{component}", value, unit, long_name)
    for name, shares in flights.caveats.items():
        put(name, shares, "1", f"{_words(name)}, share", caveat=1)

    coordinates: dict[str, Any] = {"run": campaign.runs}
    kept = flights.history
    if kept is not None:
        if history is None:
            raise ValueError("the campaign kept histories: give their interval")
        grid = history * np.arange(kept.time.shape[1])
        described = {"units": "s", "long_name": "time since the start"}
        coordinates["time"] = ("time", grid, described)
        both = ("run", "time")
        for name, unit in _STATE.items():
            put(name, getattr(kept.states, name), unit, _words(name), both)
        for before, kind in (("", kept.controls), ("commanded_", kept.commands)):
            if kind is not None:
                angles = jax.vmap(jax.vmap(_angles))(kind)
                for name, unit in _CONTROLS.items():
                    put(before + name, angles[name], unit, _words(before + name), both)
        for name, values in kept.constraints.items():
            constraint, words = scenario.constraints[name], _words(name)
            put(name, values, constraint.unit, words, both, **_limit(constraint))
    return xarray.Dataset(variables, coordinates)
