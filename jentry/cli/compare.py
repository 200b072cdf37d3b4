"""`jentry compare`: campaigns beside one another, on the same draws."""

from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import (
    ClusterAt,
    Dispersions,
    Fast,
    Quiet,
    Set,
    Step,
    Workers,
    app,
    flying_at,
    set_up,
)


@app.command("compare")
def command(
    what: Annotated[
        list[str],
        typer.Argument(
            help="Folders of two or more stored campaigns; or a mission, of which variants "
            "or configurations are flown on the same draws."
        ),
    ],
    variant: Annotated[
        list[str] | None,
        typer.Option(help="Variant of the mission that is flown. Repeated."),
    ] = None,
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
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of what is flown and of the figure; results/MISSION-compared if "
            "not given, and no figure of stored campaigns."
        ),
    ] = None,
    quiet: Quiet = False,
    workers: Workers = None,
    cluster: ClusterAt = None,
    fast: Fast = False,
) -> None:
    """Compare campaigns run by run: what one law, gain set or variant changes."""
    set_up(workers, fast)
    from ..campaign.store import open_campaign
    from ..statistics.comparison import compared
    from .compare_report import (
        draw,
        fly_entries,
        print_comparison,
        stored_entries,
    )

    asked = [*(variant or ()), *(config or ())]
    if len(what) == 1 and not Path(what[0]).is_dir():
        folder = out
        with rounding_off("the same command resumes") as look, flying_at(cluster):
            entries, folder = fly_entries(
                what[0],
                variant or [],
                config or [],
                1000 if runs is None else runs,
                seed or 0,
                dispersions,
                set_,
                step,
                out,
                quiet,
                look,
            )
    else:
        given = (step, seed, cluster)
        if asked or dispersions or set_ or any(x is not None for x in given):
            raise ValueError(
                "stored campaigns are compared as they are: leave out --variant, "
                "--config, --dispersions, --set, --step, --seed and --cluster"
            )
        if runs is not None and runs < 2:
            raise ValueError(f"--runs is {runs}: a comparison takes 2 or more")
        entries, folder = stored_entries(what, runs), out
    campaigns = {
        name: open_campaign(path, limit) for name, (path, limit) in entries.items()
    }
    (one, reference), *others = campaigns.items()
    for name, results in others:
        found = compared(reference, results)
        if not quiet:
            print_comparison(one, name, found)
    if folder is not None:
        figure = draw(folder, campaigns)
        if not quiet:
            typer.echo(f"figure: {figure}")
