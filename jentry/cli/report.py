"""What the commands print."""

import contextlib
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from .._printed import in_words
from ..addresses import field_metadata, leaves_by_address, unit_of
from ..campaign.outputs import at_end, error_of, is_error, is_output, peak_of, shown
from ..campaign.populations import finite_flights, population, sets_of
from ..fields import units_of
from ..flight.closed_loop import Instant
from ..flight.effect import unfelt
from ..flight.flight import Flight, caveat_sentence
from ..flight.miss import Misses, misses
from ..flight.scenario import Scenario, allowed
from ..flight.termination import Outcome, has_end
from ..missions.mission import Mission
from ..motion.constraints import AbstractPathConstraint
from ..motion.state import EntryState
from ..units import at_edge
from .tables import in_digits, new_console, new_table, print_under


_PERCENTILES = (1, 5, 50, 95, 99)

SETS = 16
"""Of the size of the paper's, at least, beside a published value"""

_END_STATE = {at_end(name) for name in units_of(EntryState)}
"""Its errors are shown instead"""


def print_missions(missions: Iterable[Mission]) -> None:
    """Name, title, source, variants and dispersions of each."""
    console = new_console()
    for mission in missions:
        console.print(mission.name, style="bold", end="")
        console.print(f": {mission.title}")
        if mission.source:
            console.print(f"  source       {mission.source}")
        console.print(f"  variants     {', '.join(mission.variants)}")
        console.print(f"  dispersions  {', '.join(mission.dispersions)}")


def print_leaves(scenario: Scenario) -> None:
    """Address, value and unit of every leaf, and which of them have no effect."""
    table = new_table("address", "value", "unit", "allowed")
    for address, leaf in leaves_by_address(scenario).items():
        shape = " x ".join(str(n) for n in leaf.shape)
        value = f"{float(leaf):.10g}" if leaf.shape == () else f"table of {shape}"
        described = field_metadata(scenario, address)
        table.add_row(address, value, unit_of(scenario, address), allowed(described))
    console = new_console()
    console.width = max(console.width, 100)
    print_under(console, "scenario", table)
    idle = unfelt(scenario)
    if idle:
        console.print(f"without effect in this scenario: {', '.join(idle)}")


def print_flight(mission: Mission, scenario: Scenario, flight: Flight) -> None:
    """Outcome, final state, misses and peaks of one flight."""
    outcome = Outcome(int(flight.outcome))
    # Of a flight that stopped elsewhere no condition was met.
    met = has_end(outcome) or outcome == Outcome.BEGAN_BEYOND_END
    ended_by = scenario.termination.names[int(flight.ended_by)]
    table = new_table("", "value", "unit")
    table.add_row("time", f"{float(flight.time):.4f}", units_of(Flight)["time"])
    table.add_section()
    for name, unit in units_of(EntryState).items():
        _add_number(table, in_words(name), getattr(flight.state, name), unit)
    table.add_section()
    missed = misses(scenario, flight)
    for name, unit in units_of(Misses).items():
        value = getattr(missed, name)
        if value is not None:
            _add_number(table, in_words(error_of(name)), value, unit)
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
    for name, share in flight.caveats.items():
        if share > 0.0:
            console.print(f"caveat: {caveat_sentence(name, share)}")


def _add_number(table: Table, words: str, value, unit: str) -> None:
    number, shown_unit = at_edge(value, unit)
    table.add_row(words, f"{float(number):z.6f}", shown_unit)


def _add_peak(
    table: Table, name: str, constraint: AbstractPathConstraint, peak
) -> None:
    """A row with the peak, and one with the limit where there is one."""
    words = in_words(peak_of(name))
    unit = constraint.shown_unit or constraint.unit
    _add_number(table, words, peak, unit)
    if constraint.limit is not None:
        _add_number(table, f"limit of the {words}", constraint.limit, unit)


def print_campaign(mission: Mission, results, as_published: bool) -> None:
    """Outcomes, statistics of the finite flights, and the published values beside ours.

    These are shown where the campaign is as published and has enough sets of their size;
    else it is said what they are of.
    """
    console = new_console()
    flown = finite_flights(results)
    _print_outcomes(console, results, flown)
    _print_limits(console, flown)
    for name, shares in results.data_vars.items():
        if shares.attrs.get("caveat") and np.any(shares > 0.0):
            console.print(f"caveat: {caveat_sentence(str(name), shares)}")
    if flown.sizes["run"] == 0:
        return
    _print_statistics(console, mission, flown)
    if not mission.published:
        return
    size = mission.published_runs
    if not as_published:
        console.print(
            f"published values are of the variant {mission.published_variant} with the "
            f"dispersions {mission.published_dispersions}, unchanged, by plain draws"
        )
    elif results.sizes["run"] < SETS * size:
        console.print(
            f"published values are of {size} runs, and other {size} have other "
            f"statistics: --runs {SETS * size} compares them with {SETS} sets"
        )
    else:
        _print_published(console, mission, results)


def _print_outcomes(console: Console, results, flown) -> None:
    """How many runs ended how, and how many of these are left out of the statistics."""
    count = results.sizes["run"]
    kept = np.isin(results["run"].values, flown["run"].values)
    outcomes = results["outcome"].values
    for code in np.unique(outcomes):
        ended = outcomes == code
        left_out = int(np.sum(ended & ~kept))
        line = f"{np.sum(ended)} of {count} runs {Outcome(int(code)).message}"
        if left_out:
            line += f"; {left_out} of them left out of the statistics"
        console.print(line)


def _print_limits(console: Console, flown) -> None:
    """How many of the flights keep each path constraint below its limit."""
    for name, peaks in flown.data_vars.items():
        limit = peaks.attrs.get("limit")
        if limit is None:
            continue
        beyond = int(np.sum(peaks.values > limit))
        number, unit = at_edge(limit, peaks.attrs["units"])
        # The same number where it is shown by another name, such as g.
        unit = peaks.attrs.get("shown_units", unit)
        words = f"the limit of the {in_words(str(name))}, {float(number):g} {unit}"
        console.print(f"{beyond} of {peaks.size} flights exceed {words}")


def _print_statistics(console: Console, mission: Mission, results) -> None:
    percentiles = [f"{p} %" for p in _PERCENTILES]
    table = new_table("", "unit", "minimum", "maximum", "mean", "std", *percentiles)
    for name in map(str, results.data_vars):
        if not is_output(name) or name in _END_STATE:
            continue
        values, unit = shown(results[name])
        words = in_words(name)
        _add_statistics(table, words, unit, values)
        if is_error(name):
            _add_statistics(table, f"|{words}|", unit, np.abs(values))
    count = results.sizes["run"]
    title = f"{mission.name}: {count} finite flights, errors are actual minus desired"
    print_under(console, title, table)


def _add_statistics(table: Table, words: str, unit: str, values: np.ndarray) -> None:
    spread = np.std(values, ddof=1) if values.size > 1 else np.nan
    numbers = [values.min(), values.max(), values.mean(), spread]
    numbers += list(np.percentile(values, _PERCENTILES))
    table.add_row(words, unit, *(in_digits(number) for number in numbers))


def _print_published(console: Console, mission: Mission, results) -> None:
    size = mission.published_runs
    sets = sets_of(results, size)
    columns = "published", "mean of sets", "std of a set", "deviations", "sets below"
    table = new_table("", "unit", *columns)
    for published in mission.published:
        ours = population(published.statistic, sets)
        deviations = ours.deviations(published.value)
        table.add_row(
            published.name,
            published.unit,
            in_digits(published.value),
            in_digits(ours.mean),
            in_digits(ours.spread),
            "-" if np.isnan(deviations) else f"{deviations:+.1f}",
            f"{ours.below(published.value)} of {len(sets)}",
        )
    title = f"{len(sets)} sets of {size} runs against {mission.published_note}"
    print_under(console, title, table)
    console.print(
        "deviations: how many of the standard deviations of a set the published value "
        "lies above the mean of the sets"
    )


class _Rate(ProgressColumn):
    """Runs per second since the start of this process."""

    def render(self, task: Task) -> str:
        speed = task.finished_speed or task.speed
        return "" if speed is None else f"{speed:.0f} runs/s"


@contextlib.contextmanager
def progress(runs: int) -> Iterator[Callable[[int], None]]:
    """A bar with rate and time left on a terminal; nothing otherwise.

    Gives the function to report the number of stored runs to.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda stored: None
        return
    bar = Progress(
        TextColumn("runs"),
        BarColumn(),
        MofNCompleteColumn(),
        _Rate(),
        TimeRemainingColumn(),
        console=console,
    )
    with bar:
        task = bar.add_task("runs", total=runs)

        def report(stored: int) -> None:
            bar.update(task, completed=stored)

        yield report
