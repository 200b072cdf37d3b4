"""Results of campaigns as an `xarray.Dataset`, with units and long names."""

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from .._printed import in_words
from ..addresses import field_metadata, unit_of
from ..fields import Scalar, units_of
from ..flight.flight import Flight, History
from ..flight.lane import Instant
from ..flight.miss import Misses, misses_towards
from ..flight.scenario import Scenario
from ..flight.sensing import first_moving
from ..flight.termination import Outcome
from ..motion.constraints import AbstractPathConstraint
from ..motion.state import Controls, EntryState
from ..onboard.inertial import TrackError
from ..world.tabulated import distance_of, unit_of_caveat
from .campaign import Campaign, errors_of
from .outputs import (
    NORMALISED,
    VELOCITY_INCREMENT,
    at_end,
    believed,
    difference_of,
    error_of,
    is_error,
    measured_by,
    navigated,
    navigation_deviation_of,
    navigation_error_of,
    peak_of,
)


if TYPE_CHECKING:
    import xarray

_ANGLES = ("bank_angle", "angle_of_attack")
"""Components of the controls in results"""

_UNSIGNED = "distance", VELOCITY_INCREMENT
"""Misses that are no errors, which the navigation does not have"""

_OF_ORBIT = "apoapsis", "inclination"
"""Misses that the navigation does not have, since its errors are those of a place"""


def _angles(controls: Controls) -> dict[str, Scalar]:
    return {name: getattr(controls, name) for name in _ANGLES}


def _of(constraint: AbstractPathConstraint) -> dict[str, Any]:
    """Attributes of the variable of a path constraint."""
    limit = {} if constraint.limit is None else {"limit": float(constraint.limit)}
    return limit | _shown(constraint)


def _shown(constraint: AbstractPathConstraint) -> dict[str, str]:
    shown = constraint.shown_unit
    return {} if shown is None else {"shown_units": shown}


@dataclasses.dataclass(frozen=True)
class OutputNamed:
    """One output of a flight, by its name in results, such as `downrange_error`.

    It is a function of the scenario, whose target defines the misses, and of the flight.
    """

    name: str

    def __call__(self, scenario: Scenario, flight: Flight) -> Scalar:
        outputs = {at_end("time"): flight.time}
        for constraint, peak in flight.peaks.items():
            outputs[peak_of(constraint)] = peak
        for component in units_of(EntryState):
            outputs[at_end(component)] = getattr(flight.state, component)
            if flight.navigated is not None:
                known = getattr(flight.navigated, component)
                outputs[at_end(navigated(component))] = known
        for constraint, value in flight.at_end.items():
            outputs[at_end(constraint)] = value
        if flight.knowledge is not None:
            squared = flight.knowledge.normalised_error_squared
            outputs |= {} if squared is None else {at_end(NORMALISED): squared}
        if self.name in outputs:
            return outputs[self.name]
        # Errors are computed only if requested: a miss distance may have no derivative.
        for name, errors, component in _errors(*errors_of(scenario, flight)):
            if name == self.name:
                return getattr(errors, component)
        raise ValueError(f"no output {self.name} of one flight has a derivative")


def _errors(
    missed: Misses, known: Misses | None, off: Misses | None
) -> Iterator[tuple[str, Misses, str]]:
    """Names of errors in results, each with the object that has it and its field there.

    **Arguments:** what `errors_of` returns.
    """
    for component in units_of(Misses):
        miss = error_of(component)
        yield miss, missed, component
        if known is not None:
            yield believed(miss), known, component
        if off is not None and component not in _UNSIGNED:
            yield navigation_error_of(component), off, component


def output_names(scenario: Scenario) -> list[str]:
    """Names of the outputs of a scenario in results, without a flight."""
    states = list(units_of(EntryState))
    found = [at_end(name) for name in ("time", *states, *scenario.values_at_end)]
    believes = eqx.filter_eval_shape(first_moving, scenario).navigated is not None
    if believes:
        found += [at_end(navigated(name)) for name in states]
    if getattr(scenario.navigation, "filter", None) is not None:
        found.append(at_end(NORMALISED))
    aims = misses_towards(scenario.target)
    for miss in units_of(Misses):
        aimed, of_place = miss in aims, miss not in (*_UNSIGNED, *_OF_ORBIT)
        found += [error_of(miss)] if aimed else []
        found += [believed(error_of(miss))] if aimed and believes else []
        found += [navigation_error_of(miss)] if believes and of_place else []
    for name in scenario.constraints:
        found.append(peak_of(name))
        if name in scenario.located_peaks:
            found += [peak_of(f"{name}_{x}") for x in ("time", *states)]
    return found


def dataset(
    scenario: Scenario, campaign: Campaign, history: float | None = None
) -> "xarray.Dataset":
    """The results of a campaign as a dataset, with units.

    It has the inputs by address, outcome, final state, misses, peaks and caveats, and the
    histories if there are any. A variable with the attribute `caveat` is a share. If it is
    not zero, the law did not work as intended in the run, or the run left a table.

    Dimensions: run, and time for histories with the interval `history` (s). Errors are
    actual minus desired. If navigation is not perfect, `believed_..._error` are believed
    minus desired, and `navigation_..._error` believed minus actual. With a navigation
    filter, `..._measured` is the number of values of a sensor, of which the caveat
    `..._rejected` is a share, and `navigation_..._deviation` are histories of its standard
    deviations. Names and units are those of the fields of the flight.
    """
    import xarray

    state_units = units_of(EntryState)

    flights = campaign.flights
    variables: dict[str, Any] = {}

    def put(name, values, unit, long_name, dims=("run",), **attributes):
        described = {"units": unit, "long_name": long_name, **attributes}
        variables[name] = (dims, np.asarray(values), described)

    for address, values in campaign.inputs.items():
        told = {"choice": 1} if field_metadata(scenario, address).get("choice") else {}
        put(address, values, unit_of(scenario, address), f"input {address}", **told)
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
    seconds = units_of(Flight)["time"]
    put(at_end("time"), flights.time, seconds, "time at the end")
    for name, unit in state_units.items():
        values = getattr(flights.state, name)
        put(at_end(name), values, unit, f"{in_words(name)} at the end")
        if flights.navigated is not None:
            known, believed = getattr(flights.navigated, name), navigated(name)
            put(at_end(believed), known, unit, f"{in_words(believed)} at the end")
    if flights.knowledge is not None:
        consistent = flights.knowledge.normalised_error_squared
        if consistent is not None:
            words = (
                "navigation error squared at the end, by the covariance of the filter"
            )
            put(at_end(NORMALISED), consistent, "1", words)
        for sensor, counts in flights.knowledge.measured.items():
            name = measured_by(sensor)
            put(name, counts, "1", f"{in_words(name)}, number of values")
    for name, values in flights.at_end.items():
        constraint, words = scenario.constraints[name], f"{in_words(name)} at the end"
        put(at_end(name), values, constraint.unit, words, **_shown(constraint))
    of_all = campaign.misses, campaign.believed_misses, campaign.navigation_errors
    for name, errors, component in _errors(*of_all):
        values = getattr(errors, component)
        if values is not None:
            signed = {"comment": difference_of(name)} if is_error(name) else {}
            if component in ("downrange", "crossrange"):
                signed["counted_from"] = scenario.target.counted_from
            unit = units_of(Misses)[component]
            put(name, values, unit, in_words(name), **signed)
    for name, peak in flights.peaks.items():
        constraint, words = scenario.constraints[name], in_words(peak_of(name))
        put(peak_of(name), peak, constraint.unit, words, **_of(constraint))
        there = flights.at_peaks.get(name)
        if there is not None:
            time = peak_of(f"{name}_time")
            put(time, there.time, units_of(Instant)["time"], f"time of the {words}")
            for component, unit in state_units.items():
                value = getattr(there.state, component)
                long_name = f"{in_words(component)} at the {words}"
                put(peak_of(f"{name}_{component}"), value, unit, long_name)
    for name, shares in flights.caveats.items():
        put(name, shares, "1", f"{in_words(name)}, share", caveat=1)
    for name, distances in flights.beyond_tables.items():
        # The caveat is the share of the time. This is the distance.
        far, unit = distance_of(name), unit_of_caveat(name)
        put(far, distances, unit, f"largest {in_words(far)}", distance_of=name)

    coordinates: dict[str, Any] = {"run": campaign.runs}
    kept = flights.history
    if kept is not None:
        if history is None:
            raise ValueError("the campaign has histories: give their interval")
        grid = history * np.arange(kept.time.shape[1])
        described = {"units": units_of(History)["time"], "long_name": "time"}
        coordinates["time"] = ("time", grid, described)
        both = ("run", "time")
        for name, unit in state_units.items():
            put(name, getattr(kept.states, name), unit, in_words(name), both)
            if kept.navigated is not None:
                known, believed = getattr(kept.navigated, name), navigated(name)
                put(believed, known, unit, in_words(believed), both)
        known = None if kept.knowledge is None else kept.knowledge.track_deviation
        if known is not None:
            for component, unit in units_of(TrackError).items():
                name = navigation_deviation_of(component)
                words = (
                    f"standard deviation of the {component} by the navigation filter"
                )
                put(name, getattr(known, component), unit, words, both)
        angle_units = units_of(Controls)
        for before, kind in (("", kept.controls), ("commanded_", kept.commands)):
            if kind is not None:
                angles = jax.vmap(jax.vmap(_angles))(kind)
                for angle, values in angles.items():
                    name, unit = before + angle, angle_units[angle]
                    put(name, values, unit, in_words(name), both)
        for name, values in kept.constraints.items():
            constraint, words = scenario.constraints[name], in_words(name)
            put(name, values, constraint.unit, words, both, **_of(constraint))
    return xarray.Dataset(variables, coordinates)
