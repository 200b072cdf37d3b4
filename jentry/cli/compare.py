"""`jentry compare`: campaigns beside one another, on the same draws."""

from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import (
    Case,
    ClusterAt,
    Dispersions,
    Fast,
    Quiet,
    Set,
    Step,
    Workers,
    World,
    app,
    flying_at,
    set_up,
)


@app.command("compare")
def command(
    what: Annotated[
        list[str],
        typer.Argument(
            help="Folders of two or more stored campaigns; or a mission, of which laws "
            "or configurations are flown on the same draws."
        ),
    ],
    law: Annotated[
        list[str] | None,
        typer.Option(
            help="Guidance law of the mission that is flown. Repeated; `all` for all."
        ),
    ] = None,
    case: Case = None,
    world: World = None,
    config: Annotated[
        list[Path] | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Configuration of the mission that is flown, such as tuned gains. "
            "Repeated.",
        ),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(
            help="Of each that is flown, 1000 if not given; the first so many of stored "
            "campaigns, all if not given."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Of the draws, the same for all; 0 if not given."),
    ] = None,
    dispersions: Dispersions = None,
    set_: Set = None,
    step: Step = None,
    outputs: Annotated[
        str | None,
        typer.Option(
            help="What is compared, with commas, such as downrange_error,peak_heat_rate; "
            "in the table miss distance and errors if not given, and all outputs in the "
            "differences."
        ),
    ] = None,
    percentiles: Annotated[
        str | None,
        typer.Option(
            help="Percentiles of the table, with commas; 50, 95 and 99 if not given."
        ),
    ] = None,
    all_pairs: Annotated[
        bool,
        typer.Option(
            "--all-pairs",
            help="Differences of each from each, not from the first alone.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            help="Folder of what is flown, of the numbers and of the figure; "
            "results/MISSION-compared if not given, and no files of stored campaigns.",
        ),
    ] = None,
    json: Annotated[
        bool,
        typer.Option("--json", help="Print all of it as JSON, and nothing else."),
    ] = False,
    quiet: Quiet = False,
    workers: Workers = None,
    cluster: ClusterAt = None,
    fast: Fast = False,
) -> None:
    """Compare campaigns run by run: what one law or gain set changes.

    One table has a row for each; the differences are those from the first.
    """
    set_up(workers, fast)
    from ..campaign.store import open_campaign
    from ..statistics.alternatives import PERCENTILES, alternatives_of
    from .compare_report import (
        fly_entries,
        print_alternatives,
        stored_entries,
        write_files,
    )
    from .report_choices import chosen_percentiles, refuse_both

    refuse_both(json, quiet)
    percentages = chosen_percentiles(percentiles, PERCENTILES)
    names = None
    if outputs is not None:  # as the table has them, or as they are called in results
        names = [
            name.strip().strip("|").replace(" ", "_") for name in outputs.split(",")
        ]

    asked = [*(law or ()), *(config or ()), *(world or ())]
    asked += [] if case is None else [case]
    if len(what) == 1 and not Path(what[0]).is_dir():
        folder = out
        with rounding_off("the same command resumes") as look, flying_at(cluster):
            entries, folder = fly_entries(
                what[0],
                law or [],
                (case, world),
                config or [],
                1000 if runs is None else runs,
                seed or 0,
                dispersions,
                set_,
                step,
                out,
                quiet,
                names,
                look,
            )
    else:
        given = (step, seed, cluster)
        if asked or dispersions or set_ or any(x is not None for x in given):
            raise ValueError(
                "stored campaigns are compared as they are: leave out --law, "
                "--case, --world, --config, --dispersions, --set, --step, --seed and "
                "--cluster"
            )
        if runs is not None and runs < 2:
            raise ValueError(f"--runs is {runs}: a comparison takes 2 or more")
        entries, folder = stored_entries(what, runs), out
    campaigns = {
        name: open_campaign(path, limit) for name, (path, limit) in entries.items()
    }
    for name, results in campaigns.items():
        if runs is not None and results.sizes["run"] < runs:
            raise ValueError(
                f"--runs is {runs}, and {name} has {results.sizes['run']}: give no more"
            )
    found = alternatives_of(campaigns, names, percentages, all_pairs=all_pairs)
    # Before anything is printed, which somebody may cut off.
    paths = [] if folder is None else write_files(folder, campaigns, found)
    if json:
        typer.echo(found.as_json(), nl=False)
    elif not quiet:
        print_alternatives(found)
        if paths:
            typer.echo(f"written: {', '.join(map(str, paths))}")
