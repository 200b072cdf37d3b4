"""Output of `jentry corridor`: table, numbers and figure."""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .._files import write_whole
from .._printed import in_words
from ..campaign.outputs import peak_of
from ..fields import units_of
from ..flight.flight import Flight, caveat_sentence
from ..flight.scenario import Scenario
from ..flight.termination import Outcome
from ..missions.choice import Choice
from ..missions.mission import Mission
from ..motion.orbit import orbit_of
from ..motion.state import EntryState
from ..planning.aerocapture_corridor import CaptureCorridor
from ..plots import save_figures
from ..plots.aerocapture_corridor import LIFT, draw_corridor
from ..units import at_edge, degree, parse_quantity
from .tables import new_console, new_table, print_under


_ANGLE, _ALTITUDE = (
    units_of(EntryState)[name] for name in ("flight_path_angle", "altitude")
)


def angle(option: str, text: str) -> float:
    """A flight-path angle of the command line, rad. Raises `ValueError` with the option."""
    try:
        return parse_quantity(text, _ANGLE)
    except ValueError as error:
        raise ValueError(f"{option} {text}: {error}") from None


def print_corridor(
    mission: Mission,
    choice: Choice,
    scenario: Scenario,
    corridor: CaptureCorridor,
    flights: dict[str, Flight],
) -> None:
    """Print both limits with their flights, and where the entry lies between them."""
    console = new_console()
    table = new_table("", *(f"{name} limit" for name in flights), "unit")

    def row(words: str, values: Iterable[Any], unit: str, digits: int) -> None:
        shown, shown_unit = at_edge([float(x) for x in values], unit)
        table.add_row(words, *(f"{x:z.{digits}f}" for x in shown), shown_unit)

    table.add_row("lift", *(LIFT[name] for name in flights), "")
    row("flight-path angle", [getattr(corridor, n) for n in flights], _ANGLE, 5)
    ends = [Outcome(int(flight.outcome)).message for flight in flights.values()]
    table.add_row("end", *ends, "")
    row(
        "time",
        [flight.time for flight in flights.values()],
        units_of(Flight)["time"],
        2,
    )
    lowest = [_lowest_altitude(flight) for flight in flights.values()]
    row("lowest altitude", lowest, _ALTITUDE, 3)
    row("apoapsis altitude", _apoapsides(scenario, flights), _ALTITUDE, 1)
    for name, constraint in scenario.constraints.items():
        unit = constraint.shown_unit or constraint.unit
        peaks = [flight.peaks[name] for flight in flights.values()]
        row(in_words(peak_of(name)), peaks, unit, 4)
    print_under(
        console, f"{mission.name}, {_flown(choice)}: entry corridor of a capture", table
    )
    width, start = (
        float(corridor.width),
        float(scenario.initial_state.flight_path_angle),
    )
    console.print(f"width: {width / degree:.5f} deg")
    if width > 0.0:
        share = 100.0 * float(corridor.shallow - start) / width
        where = (
            f"{share:.1f} % of the way from the shallow to the steep limit"
            if 0.0 <= share <= 100.0
            else "outside the corridor"
        )
        console.print(f"entry of the scenario: {start / degree:.5f} deg, {where}")
    else:
        console.print("no flight-path angle allows a capture")
    console.print("angles are those of the velocity relative to the planet")
    for name, flight in flights.items():
        for caveat, share in flight.caveats.items():
            if share > 0.0:
                by = flight.beyond_tables.get(caveat)
                said = caveat_sentence(caveat, share, by)
                console.print(f"caveat of the {name} limit: {said}")


def as_json(
    mission: Mission,
    choice: Choice,
    scenario: Scenario,
    corridor: CaptureCorridor,
    flights: dict[str, Flight],
) -> str:
    """The corridor as JSON, SI. Numbers that are not finite are null."""
    contents = {
        "mission": mission.name,
        "case": choice.case,
        "worlds": list(choice.worlds),
        "unit": _ANGLE,
        "shallow": float(corridor.shallow),
        "steep": float(corridor.steep),
        "width": float(corridor.width),
        "entry": float(scenario.initial_state.flight_path_angle),
        "flights": {
            name: {
                "outcome": Outcome(int(flight.outcome)).name.lower(),
                "time": _finite(flight.time),
                "lowest_altitude": _finite(_lowest_altitude(flight)),
                "apoapsis_altitude": _finite(apoapsis),
                **{peak_of(n): _finite(peak) for n, peak in flight.peaks.items()},
            }
            for (name, flight), apoapsis in zip(
                flights.items(), _apoapsides(scenario, flights), strict=True
            )
        },
    }
    return json.dumps(contents, indent=2, allow_nan=False) + "\n"


def write_corridor(
    folder: Path,
    mission: Mission,
    choice: Choice,
    corridor: CaptureCorridor,
    flights: dict[str, Flight],
    numbers: str,
) -> list[Path]:
    """Write the numbers, which are JSON, and the figure."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "corridor.json"
    write_whole(file, numbers.encode())
    figure = draw_corridor(corridor, flights, f"{mission.name}: {_flown(choice)}")
    return [file, *save_figures({"corridor": figure}, folder / "figures")]


def _flown(choice: Choice) -> str:
    """The choice with a constant bank in place of its law."""
    return str(dataclasses.replace(choice, law="constant bank"))


def _apoapsides(scenario: Scenario, flights: dict[str, Flight]) -> list[float]:
    """Altitudes of the apoapsides of the orbits after the flights, m."""
    orbits = (orbit_of(scenario.planet, flight.state) for flight in flights.values())
    return [float(orbit.apoapsis_altitude) for orbit in orbits]


def _lowest_altitude(flight: Flight) -> float:
    """Lowest altitude of the history and of the end, m."""
    assert flight.history is not None
    history = float(np.nanmin(np.asarray(flight.history.states.altitude)))
    return min(history, float(flight.state.altitude))


def _finite(number: Any) -> float | None:
    value = float(number)
    return value if np.isfinite(value) else None
