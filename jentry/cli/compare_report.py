"""Flights, tables and files of `jentry compare`."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._files import write_whole
from ..campaign.results import output_names
from ..campaign.store import run_campaign
from ..flight.solver import FixedStep
from ..flight.termination import Outcome
from ..missions import find_mission
from ..plots import save_figures
from ..plots.comparison import draw_comparison
from ..statistics.alternatives import Alternatives, no_output, shared_runs
from ..statistics.comparison import PERCENTILE, Comparison
from ..statistics.intervals import CONFIDENCE, Interval
from .options import (
    chosen_scenario,
    dispersion_table,
    folder_of_results,
    refuse_set_in_vain,
)
from .progress import reported
from .tables import in_digits, new_console, print_in_pieces


if TYPE_CHECKING:
    import xarray


Entries = dict[str, tuple[Path, int | None]]
"""By the name of a campaign: its folder, and how many of its runs count, None for all"""


def stored_entries(folders: Sequence[str], runs: int | None = None) -> Entries:
    """Stored campaigns by the names of their folders; their first `runs`, or all."""
    if len(folders) < 2:
        raise ValueError("a comparison takes two campaigns or more: give their folders")
    paths = [Path(folder) for folder in folders]
    names = [path.resolve().name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    if len(set(names)) < len(names):
        raise ValueError("a campaign is given twice: give another")
    return {name: (path, runs) for name, path in zip(names, paths, strict=True)}


def fly_entries(
    mission: str,
    laws: Sequence[str],
    where: tuple[str | None, Sequence[str] | None],
    configs: Sequence[Path],
    runs: int,
    seed: int,
    dispersions: str | None,
    assignments: list[str] | None,
    step: float | None,
    out: Path | None,
    quiet: bool,
    outputs: Sequence[str] | None,
    look: Callable[[], None],
) -> tuple[Entries, Path]:
    """Fly laws and configurations of a mission on the same draws, each into a folder.

    `where` is the case and the worlds, common to all.
    """
    if "all" in laws:
        laws = [*find_mission(mission).laws]
    choices: list[tuple[str, str | None, Path | None]]
    choices = [(name, name, None) for name in dict.fromkeys(laws)]
    choices += [(path.stem, None, path) for path in dict.fromkeys(configs)]
    if len(choices) == 1 and configs:
        choices.insert(0, ("mission", None, None))
    names = [name for name, _, _ in choices]
    if len(choices) < 2:
        raise ValueError(
            "a comparison takes two: give --law twice, or --config; or the folders of "
            "stored campaigns"
        )
    if len(set(names)) < len(names):
        raise ValueError(f"{', '.join(names)}: two have the same name; rename a file")
    prepared = []
    for name, law, config in choices:
        # Prepare all before the first is flown: errors come at once.
        try:
            chosen, scenario, overrides = chosen_scenario(
                mission, (law, *where), config, assignments
            )
            _, table = dispersion_table(chosen, overrides, dispersions)
            refuse_set_in_vain(scenario, overrides, table)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        labels = {**chosen.labels, **overrides.choice.labels}
        prepared.append((name, chosen, scenario, table, labels))
    for name, _, scenario, *_ in prepared:
        known = output_names(scenario)
        for output in outputs or ():
            if output not in known:
                raise ValueError(no_output(name, output, known))
    folder = folder_of_results(out, f"{prepared[0][1].name}-compared")
    solver = FixedStep(step)
    for name, _, scenario, table, labels in prepared:
        with reported(runs, quiet) as told:

            def report(stored: int, told: Callable[[int], None] = told) -> None:
                told(stored)
                look()

            try:
                run_campaign(
                    folder / name,
                    scenario,
                    table,
                    seed,
                    runs,
                    solver=solver,
                    report=report,
                    **labels,
                )
            except ValueError as error:
                raise ValueError(f"{name} cannot be flown: {error}") from None
    return {name: (folder / name, runs) for name in names}, folder


def print_alternatives(found: Alternatives) -> None:
    """Print a table with a row for each campaign, the failures, and the differences."""
    _print_rows(found)
    for (one, other), comparison in found.differences.items():
        _print_comparison(one, other, comparison)
    console = new_console()
    for (one, other), why in found.untold.items():
        console.print(f"{other} less {one} is not known: {why}")


def _print_rows(found: Alternatives) -> None:
    console = new_console()
    heads, rows = ["", "runs", "failures"], []
    for output in found.outputs:
        unit = [] if output.shown_unit == "1" else [output.shown_unit]
        top = [*output.words.split(), *unit]
        levels = found.rows[0].levels[output.name]
        for what in (*(f"{p:.10g} %" for p in levels.percentiles), "maximum"):
            heads.append("\n".join([*top, what]))
    for row in found.rows:
        cells = [row.name, str(row.runs), str(row.failures)]
        for output in found.outputs:
            levels = row.levels[output.name]
            cells += [
                _LOST if np.isinf(p) else in_digits(p / output.shown_size)
                for p in levels.percentiles.values()
            ]
            cells.append(in_digits(levels.maximum / output.shown_size))
        rows.append(cells)
    how = (
        f"on the same draws: {found.why}"
        if found.same_draws
        else f"NOT on the same draws ({found.why})"
    )
    title = f"{len(rows)} alternatives {how}"
    print_in_pieces(console, title, heads, rows, repeated=3)
    if found.beyond:
        console.print(f"{found.beyond} runs that not all of them have are left out")
    for row in found.rows:
        for outcome, runs in row.outcomes.items():
            if outcome is not Outcome.REACHED:
                console.print(f"{row.name}: {runs} of {row.runs} {outcome.message}")
    lost = [f"{row.not_finite} of {row.name}" for row in found.rows if row.not_finite]
    if lost:
        console.print(
            f"not finite, or without an end: {', '.join(lost)}. Percentiles count them as "
            f"larger than any number, and show {_LOST!r} where one of them is the "
            "percentile. Maxima are of the other runs"
        )


_LOST = "no end"


def _print_comparison(first: str, second: str, found: Comparison) -> None:
    """Print the second campaign minus the first, with intervals."""
    console = new_console()
    heads = [
        *("", "unit", f"mean, {first}", f"mean, {second}", "difference"),
        *("of std", f"of {PERCENTILE:g} %", f"{second} smaller"),
    ]
    rows = []
    for each in found.differences:
        size = each.shown_size
        rows.append(
            (
                each.words,
                each.shown_unit,
                in_digits(each.first / size),
                in_digits(each.second / size),
                _told(each.mean, size),
                _told(each.standard_deviation, size),
                _told(each.percentile, size),
                "-" if each.smaller is None else _share(each.smaller),
            )
        )
    ours, theirs = found.flights
    kind = f"{theirs} and {ours} flights, not paired"
    if found.paired:
        kind = f"{found.runs} pairs"
    title = f"{second} less {first}: {kind}, since {found.why}"
    print_in_pieces(console, title, heads, rows, repeated=2)
    console.print(
        f"in brackets: intervals of {CONFIDENCE:.0%}, by bootstrap; an interval without "
        "zero shows a difference; - with too few runs. Half of equal values count as "
        "smaller"
    )
    if found.beyond:
        console.print(f"{found.beyond} runs that only one of them has are not compared")
    if found.spread:
        console.print(
            "a sampler spreads the runs evenly: statistics repeat better than these "
            "intervals say"
        )
    if found.left_out:
        console.print(f"{found.left_out} left out: not finite, or without an end")
    if found.only_one:
        console.print(f"outputs of only one of them: {', '.join(found.only_one)}")


def _told(interval: Interval, size: float) -> str:
    value, low, high = (in_digits(x / size, "+") for x in interval)
    return f"{value} [-]" if np.isnan(interval.lower) else f"{value} [{low}, {high}]"


def _share(share: Interval) -> str:
    value, low, high = (f"{100.0 * x:.1f}" for x in share)
    return f"{value} % [{low}, {high}]"


def write_files(
    folder: Path, campaigns: "Mapping[str, xarray.Dataset]", found: Alternatives
) -> list[Path]:
    """Write all numbers as JSON, the rows as csv, and a figure of the first outputs."""
    names = [output.name for output in found.outputs]
    if found.same_draws:
        shared = shared_runs(campaigns)
        campaigns = {name: x.sel(run=shared) for name, x in campaigns.items()}
    figure = draw_comparison(campaigns, names)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"comparison.{kind}" for kind in ("json", "csv")]
    for path, text in zip(paths, (found.as_json(), found.as_csv()), strict=True):
        write_whole(path, text.encode())
    return [*paths, *save_figures({"comparison": figure}, folder)]
