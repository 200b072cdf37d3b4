"""`jentry benchmark`: laws in cases and worlds, on the same draws, in one table."""

import json as json_
from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import Json, Quiet, Seed, Step, Workers, app, import_meanwhile, set_up


@app.command("benchmark")
def command(
    law: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE",
            help="Your own law, a file such as my_law.py that defines LAW: a law, or a "
            "function of a Scenario that returns one. It flies in every case. May be "
            "repeated.",
        ),
    ] = None,
    case: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE",
            help="Your own case, a file such as my_case.py that defines MISSION. It flies "
            "with its first dispersions. May be repeated.",
        ),
    ] = None,
    laws: Annotated[
        str | None,
        typer.Option(
            help="Laws to fly in place of those of the cases, separated by commas: any "
            "laws of the missions, and your own by the names of their files."
        ),
    ] = None,
    cases: Annotated[
        str | None,
        typer.Option(help="Cases to fly, separated by commas; all if not given."),
    ] = None,
    short: Annotated[
        bool, typer.Option("--short", help="4 sets of 100 flights in each case.")
    ] = False,
    sets: Annotated[
        int | None, typer.Option(help="Number of sets; 16 if not given.")
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(
            help="Runs of a set; if not given, 25 to 1000, as the case takes time."
        ),
    ] = None,
    seed: Seed = 0,
    step: Step = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="benchmark.json of another version, or of another machine, whose rows "
            "are put below. May be repeated.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            file_okay=False, help="Folder for the campaigns, the numbers and the page."
        ),
    ] = Path("results/benchmark"),
    json: Json = False,
    quiet: Quiet = False,
    workers: Workers = None,
) -> None:
    """Fly guidance laws in many cases on the same draws, and rank them.

    The same command resumes an interrupted benchmark.
    """
    if short and (sets is not None or runs is not None):
        raise ValueError("--short is 4 sets of 100: leave out --sets and --runs")
    for name, value in (("--sets", sets), ("--runs", runs)):
        if value is not None and value < 1:
            raise ValueError(f"{name} is {value}: it must be 1 or more")
    set_up(workers)
    import_meanwhile("scipy.special", "matplotlib.figure")
    from .._files import write_whole
    from ..missions.own_law import law_of_file
    from ..statistics.benchmark import statistics_of_case
    from .benchmark_page import PAGE, page_of_benchmark
    from .benchmark_record import (
        beside as stored_beside,
        record_of,
        refuse_other_settings,
        write_record,
    )
    from .benchmark_runs import chosen_cases, cost_of, fly, prepared
    from .benchmark_tables import (
        HOW_TO_READ,
        skipped_lines,
        table_of_all,
        table_of_case,
        table_of_cost,
    )
    from .progress import reported
    from .report_choices import refuse_both
    from .tables import new_console, print_in_pieces

    refuse_both(json, quiet)
    count = 4 if short else 16 if sets is None else sets
    chosen = chosen_cases(cases, case or [])
    sizes = {x.name: 100 if short else runs or x.runs for x in chosen}
    made = prepared(
        chosen,
        laws,
        [law_of_file(file) for file in law or ()],
        lambda x: count * sizes[x.name],
        seed,
        step,
    )
    flying = {x.case.name: sizes[x.case.name] for x in made if x.entries}
    settings = {"seed": seed, "sets": count, "step": step, "cases": flying}
    refuse_other_settings(out, settings)
    others = {str(path): stored_beside(path, settings) for path in beside or ()}

    found, costs = [], {}
    with rounding_off("the same command resumes") as look:
        for each in made:
            flown, size = {}, sizes[each.case.name]
            for entry in each.entries:
                folder = out / each.case.name / entry.law
                if not quiet and not json:
                    typer.echo(f"{each.case.name}, {entry.law}", err=True)
                with reported(count * size, quiet or json) as told:

                    def report(stored: int, told=told) -> None:
                        told(stored)
                        look()

                    try:
                        flown[entry.law] = fly(
                            folder, entry, seed, count * size, step, report
                        )
                    except ValueError as error:
                        raise ValueError(
                            f"{entry.law} cannot be flown in {each.case.name}: {error}"
                        ) from None
                costs.setdefault(each.case.name, {})[entry.law] = cost_of(folder)
            statistics = (
                statistics_of_case(
                    flown, each.case.measure, each.case.resolution, count
                )
                if flown
                else []
            )
            found.append((each, size, statistics))
    record = record_of(found, seed, count, step)
    tables = [table_of_case(x, count, others) for x in record["cases"] if x["laws"]]
    over_all = table_of_all(record)
    tables += [] if over_all is None else [over_all]
    cost = [table_of_cost(name, of) for name, of in costs.items()]
    written = write_record(out, record)
    write_whole(out / "cost.json", (json_.dumps(costs, indent=2) + "\n").encode())
    write_whole(out / PAGE, page_of_benchmark(record, tables, cost).encode())
    if json:
        typer.echo(written.read_text(encoding="utf-8"), nl=False)
    elif not quiet:
        console = new_console()
        for table in (*tables, *cost):
            print_in_pieces(console, table.title, table.heads, table.rows)
            for note in table.notes:
                console.print(note)
        console.print(HOW_TO_READ)
        for line in skipped_lines(record["skipped"]):
            console.print(line)
        typer.echo(f"written: {written}, {out / 'cost.json'}, {out / PAGE}")
