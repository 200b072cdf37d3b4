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

from .._addresses import leaves_by_address, unit_of
from ..flight.fly import Flight, caveat_sentence
from ..flight.misses import misses
from ..flight.scenario import Scenario
from ..flight.termination import Outcome
from ..missions.mission import Mission
from .tables import at_edge, new_console, new_table, print_under, unit_of_output


_PERCENTILES = (1, 5, 50, 95, 99)


def print_missions(missions: Iterable[Mission]) -> None:
    """Name, title, source, variants and dispersions of each."""
    console = new_console()
    for mission in missions:
        console.print(f"[bold]{mission.name}[/]: {mission.title}")
        console.print(f"  source       {mission.source}")
        console.print(f"  variants     {', '.join(mission.variants)}")
        console.print(f"  dispersions  {', '.join(mission.dispersions)}")


def print_leaves(scenario: Scenario) -> None:
    """Address, value and unit of every leaf."""
    table = new_table("address", "value", "unit")
    for address, leaf in leaves_by_address(scenario).items():
        shape = " x ".join(str(n) for n in leaf.shape)
        value = f"{float(leaf):.10g}" if leaf.shape == () else f"table of {shape}"
        table.add_row(address, value, unit_of(scenario, address))
    console = new_console()
    console.width = max(console.width, 100)
    print_under(console, "scenario", table)


def print_flight(mission: Mission, scenario: Scenario, flight: Flight) -> None:
    """Outcome, final state, misses and peaks of one flight."""
    outcome = Outcome(int(flight.outcome))
    ended_by = scenario.termination.names[int(flight.ended_by)]
    table = new_table("", "value", "unit")
    table.add_row("time", f"{float(flight.time):.4f}", "s")
    groups = (
        ("", scenario.initial_state, flight.state),
        (" error", misses(scenario, flight), misses(scenario, flight)),
        ("peak ", flight.peaks, flight.peaks),
    )
    for label, described, values in groups:
        table.add_section()
        for name, leaf in leaves_by_address(values).items():
            unit = unit_of_output(described, name)
            value, unit = at_edge(leaf, unit)
            words = name.replace("_", " ")
            words = label + words if label.endswith(" ") else words + label
            table.add_row(words, f"{float(value):z.6f}", unit)
    title = f"{mission.name}: {outcome.message} ({ended_by})"
    console = new_console()
    print_under(console, title, table)
    for name, share in flight.caveats.items():
        if share > 0.0:
            console.print(f"caveat: {caveat_sentence(name, share)}")


def print_campaign(mission: Mission, results, as_published: bool) -> None:
    """Outcomes, statistics, and the published values beside ours.

    These are shown where the campaign is as published; else it is said what they are of.
    """
    console = new_console()
    count = results.sizes["run"]
    codes, numbers = np.unique(results["outcome"], return_counts=True)
    for code, number in zip(codes, numbers, strict=True):
        console.print(f"{number} of {count} runs {Outcome(int(code)).message}")
    for name, shares in results.data_vars.items():
        if shares.attrs.get("caveat") and np.any(shares > 0.0):
            console.print(f"caveat: {caveat_sentence(str(name), shares)}")
    finite = results["outcome"] != Outcome.NOT_FINITE
    flown = results.isel(run=np.flatnonzero(finite))
    if flown.sizes["run"] < count:
        console.print(f"statistics are of the {flown.sizes['run']} that are finite")
    if flown.sizes["run"] == 0:
        return
    _print_statistics(console, mission, flown)
    if mission.published and as_published:
        _print_published(console, mission, flown)
    elif mission.published:
        console.print(
            f"published values are of the variant {mission.published_variant} with the "
            f"dispersions {mission.published_dispersions}, unchanged"
        )


def _print_statistics(console: Console, mission: Mission, results) -> None:
    percentiles = [f"{p} %" for p in _PERCENTILES]
    table = new_table("", "unit", "minimum", "maximum", "mean", "std", *percentiles)
    for name in map(str, results.data_vars):
        error = name.endswith("_error") and "." not in name
        shown = ("end_time", "peak_", "miss_distance")
        if not (error or name.startswith(shown)):
            continue
        values, unit = at_edge(results[name], results[name].attrs["units"])
        words = name.replace("_", " ")
        _add_statistics(table, words, unit, values)
        if error:
            _add_statistics(table, f"|{words}|", unit, np.abs(values))
    title = f"{mission.name}: errors are actual minus desired"
    print_under(console, title, table)


def _add_statistics(table: Table, words: str, unit: str, values: np.ndarray) -> None:
    spread = np.std(values, ddof=1) if values.size > 1 else np.nan
    numbers = [values.min(), values.max(), values.mean(), spread]
    numbers += list(np.percentile(values, _PERCENTILES))
    table.add_row(words, unit, *(_shown(number) for number in numbers))


def _shown(number: float, sign: str = "") -> str:
    """To four decimals, or in powers of ten where these are all zero."""
    small = 0.0 < abs(number) < 5e-5
    return f"{number:{sign}.1e}" if small else f"{number:{sign}z.4f}"


def _print_published(console: Console, mission: Mission, results) -> None:
    table = new_table("", "unit", "published", "jentry", "difference")
    for published in mission.published:
        ours = published.statistic(results)
        table.add_row(
            published.name,
            published.unit,
            _shown(published.value),
            _shown(ours),
            _shown(ours - published.value, "+"),
        )
    print_under(console, mission.published_note, table)


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
