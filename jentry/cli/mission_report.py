"""Tables of missions, of their scenarios and of one flight."""

from collections.abc import Iterable

from rich.table import Table

from .._printed import in_words, sentence
from ..addresses import field_metadata, leaves_by_address, unit_of
from ..campaign.outputs import error_of, peak_of
from ..fields import allowed, units_of
from ..flight.effect import unfelt
from ..flight.flight import Flight, caveat_sentence
from ..flight.lane import Instant
from ..flight.miss import Misses, believed_misses, misses
from ..flight.scenario import Scenario
from ..flight.termination import Outcome, has_end
from ..missions.mission import Mission
from ..motion.constraints import AbstractPathConstraint
from ..motion.state import EntryState
from ..units import at_edge
from .tables import new_console, new_table, print_under


def print_missions(missions: Iterable[Mission]) -> None:
    """Print name, title and source of each mission, and a sentence for each choice."""
    console = new_console()
    for mission in missions:
        console.print(mission.name, style="bold", end="")
        console.print(f": {mission.title}")
        if mission.source:
            console.print(f"  source       {mission.source}")
        for axis in ("laws", "cases", "worlds", "dispersions"):
            named = getattr(mission, axis)
            if not named:
                continue
            console.print(f"  {axis}")
            width = max(map(len, named))
            for name, function in named.items():
                line = f"    {name:{width}}  {sentence(function)}".rstrip()
                console.print(line, highlight=False)


def print_leaves(scenario: Scenario) -> None:
    """Print address, value and unit of every leaf, and those without effect."""
    table = new_table("address", "value", "unit", "allowed")
    for address, leaf in leaves_by_address(scenario).items():
        shape = " x ".join(str(n) for n in leaf.shape)
        value = f"{float(leaf):.10g}" if leaf.shape == () else f"table of {shape}"
        described = field_metadata(scenario, address)
        table.add_row(address, value, unit_of(scenario, address), allowed(described))
    console = new_console()
    console.width = max(console.width, 100)
    print_under(console, "scenario", table)
    console.print(f"downrange and crossrange: {scenario.target.counted_from}")
    idle = unfelt(scenario)
    if idle:
        console.print(f"without effect on the flight: {', '.join(idle)}")


def print_flight(mission: Mission, scenario: Scenario, flight: Flight) -> None:
    """Print outcome, final state, misses and peaks of one flight."""
    outcome = Outcome(int(flight.outcome))
    # A flight that stopped otherwise met no end condition.
    met = has_end(outcome) or outcome == Outcome.BEGAN_BEYOND_END
    ended_by = scenario.termination.names[int(flight.ended_by)]
    known = flight.navigated
    table = new_table("", "value", "unit", *([] if known is None else ["believed"]))
    table.add_row("time", f"{float(flight.time):.4f}", units_of(Flight)["time"])
    table.add_section()
    for name, unit in units_of(EntryState).items():
        believed = None if known is None else getattr(known, name)
        _add_number(table, in_words(name), getattr(flight.state, name), unit, believed)
    if has_end(outcome):
        table.add_section()
        missed = misses(scenario, flight)
        reported = believed_misses(scenario, flight)
        for name, unit in units_of(Misses).items():
            value = getattr(missed, name)
            believed = None if reported is None else getattr(reported, name)
            if value is not None:
                _add_number(table, in_words(error_of(name)), value, unit, believed)
        for name, value in flight.at_end.items():
            constraint = scenario.constraints[name]
            unit = constraint.shown_unit or constraint.unit
            _add_number(table, f"{in_words(name)} at the end", value, unit)
        table.add_section()
        for name, peak in flight.peaks.items():
            _add_peak(table, name, scenario.constraints[name], peak)
        for name, there in flight.at_peaks.items():
            table.add_section()
            words = f"at {in_words(peak_of(name))}"
            unit = units_of(Instant)["time"]
            table.add_row(f"time {words}", f"{float(there.time):.4f}", unit)
            for component, unit in units_of(EntryState).items():
                value = getattr(there.state, component)
                _add_number(table, f"{in_words(component)} {words}", value, unit)
    title = f"{mission.name}: {outcome.message}" + (f" ({ended_by})" if met else "")
    console = new_console()
    print_under(console, title, table)
    if known is not None:
        console.print("believed: what the vehicle would report of its end")
    console.print(f"downrange and crossrange: {scenario.target.counted_from}")
    for name, share in flight.caveats.items():
        if share > 0.0:
            console.print(
                f"caveat: {caveat_sentence(name, share, flight.beyond_tables.get(name))}"
            )


def _add_number(table: Table, words: str, value, unit: str, believed=None) -> None:
    """Add a row with a number, and with what the vehicle believes of it, if anything."""
    numbers = [value] if believed is None else [value, believed]
    shown, shown_unit = at_edge([float(x) for x in numbers], unit)
    number, *known = (f"{x:z.6f}" for x in shown)
    table.add_row(words, number, shown_unit, *known)


def _add_peak(
    table: Table, name: str, constraint: AbstractPathConstraint, peak
) -> None:
    """Add a row with the peak, and a row with the limit if there is one."""
    words = in_words(peak_of(name))
    unit = constraint.shown_unit or constraint.unit
    _add_number(table, words, peak, unit)
    if constraint.limit is not None:
        limit = f"limit of the {words}"
        if float(peak) > float(constraint.limit):
            limit += ", exceeded"
        _add_number(table, limit, constraint.limit, unit)
