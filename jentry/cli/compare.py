"""`jentry compare`: several campaigns, compared on the same draws."""

from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import (
    Case,
    ClusterAt,
    Device,
    Dispersions,
    Fast,
    Json,
    Quiet,
    Set,
    Step,
    Workers,
    World,
    app,
    flying_at,
    import_meanwhile,
    set_up,
)


@app.command("compare")
def command(
    what: Annotated[
        list[str],
        typer.Argument(
            help="Folders of two or more stored campaigns; or a mission, whose laws or "
            "configurations are flown on the same draws."
        ),
    ],
    law: Annotated[
        list[str] | None,
        typer.Option(
            help="Guidance law of the mission to fly. May be repeated; `all` for all."
        ),
    ] = None,
    case: Case = None,
    world: World = None,
    config: Annotated[
        list[Path] | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Configuration of the mission to fly, such as tuned gains. May be "
            "repeated.",
        ),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(
            help="Runs of each campaign: flown, 1000 if not given; or the first runs of "
            "stored campaigns, all if not given."
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of the draws, common to all; 0 if not given."),
    ] = None,
    dispersions: Dispersions = None,
    set_: Set = None,
    step: Step = None,
    outputs: Annotated[
        str | None,
        typer.Option(
            help="Outputs to compare, separated by commas, such as "
            "downrange_error,peak_heat_rate. If not given, the table has the miss distance "
            "and the errors, and the differences have all outputs."
        ),
    ] = None,
    percentiles: Annotated[
        str | None,
        typer.Option(
            help="Percentiles of the table, separated by commas; 50, 95 and 99 if not "
            "given."
        ),
    ] = None,
    all_pairs: Annotated[
        bool,
        typer.Option(
            "--all-pairs",
            help="Differences between all pairs, not only from the first.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            help="Folder for the flown campaigns, the numbers and the figure. If not "
            "given: results/MISSION-compared, and no files for stored campaigns.",
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
    workers: Workers = None,
    device: Device = None,
    cluster: ClusterAt = None,
    fast: Fast = False,
) -> None:
    """Compare campaigns run by run: the effect of another law or of other gains.

    One table has a row for each campaign; the differences are those from the first.
    """
    set_up(workers, fast, device)
    import_meanwhile("scipy.stats")
    from ..campaign.store import open_campaign
    from ..statistics.alternatives import PERCENTILES, alternatives_of
    from .compare_report import (
        fly_entries,
        print_alternatives,
        stored_entries,
        write_files,
    )
    from .report_choices import chosen_percentiles, refuse_both, require_runs

    refuse_both(json, quiet)
    percentages = chosen_percentiles(percentiles, PERCENTILES)
    names = None
    if outputs is not None:  # names of the table or of the results
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
        require_runs(runs, results.sizes["run"], name)
    found = alternatives_of(campaigns, names, percentages, all_pairs=all_pairs)
    # Written before anything is printed: whoever reads the output may close it.
    paths = [] if folder is None else write_files(folder, campaigns, found)
    if json:
        typer.echo(found.as_json(), nl=False)
    elif not quiet:
        print_alternatives(found)
        if paths:
            typer.echo(f"written: {', '.join(map(str, paths))}")
