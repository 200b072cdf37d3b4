"""`jentry report`: statistics and figures of a stored campaign, without flying."""

from typing import Annotated

import typer

from .options import (
    Formats,
    Json,
    OwnMission,
    Percentiles,
    Quiet,
    Require,
    RequirementsFile,
    StoredFolder,
    app,
    set_up,
)


@app.command("report")
def command(
    folder: StoredFolder,
    runs: Annotated[
        int | None,
        typer.Option(
            help="Number of runs to report, from the first; all if not given."
        ),
    ] = None,
    percentiles: Percentiles = None,
    require: Require = None,
    requirements: RequirementsFile = None,
    mission: OwnMission = None,
    figures: Annotated[
        bool, typer.Option(help="Draw the figures in FOLDER/figures again.")
    ] = True,
    figures_only: Annotated[
        bool,
        typer.Option("--figures-only", help="Draw the figures, and do nothing else."),
    ] = False,
    format_: Formats = "png",
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="Print all quantities with their intervals, and circular errors.",
        ),
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Report a stored campaign: a table, JSON, csv, a page, all figures."""
    set_up(workers=1)
    from ..campaign.errors import CampaignError
    from ..campaign.parts import digest_of, read_manifest
    from ..campaign.store import open_campaign
    from ..missions.stored import is_as_published, stored_mission, stored_scenario
    from ..statistics.summary import summarize
    from .campaign_files import decided_by, write_figures, write_page, write_summary
    from .campaign_report import print_campaign, print_summary
    from .figures import FIGURES, first_of, stored_histories
    from .report_choices import (
        chosen_formats,
        chosen_percentiles,
        chosen_requirements,
        leave,
        refuse_both,
        require_runs,
    )

    refuse_both(json, quiet)
    if runs is not None and runs < 1:
        raise ValueError(f"--runs is {runs}: it must be 1 or more")
    said = percentiles, require, requirements
    if figures_only and (json or any(x is not None for x in said)):
        raise ValueError(
            "--figures-only draws, and prints nothing: leave out --json, --percentiles, "
            "--require and --requirements"
        )
    if full and (quiet or json or figures_only):
        raise ValueError(
            "--full prints more, but --quiet, --json and --figures-only print no table: "
            "give one of them"
        )
    if figures_only and not figures:
        raise ValueError("--figures-only and --no-figures: give one of them")
    formats = chosen_formats(format_)
    asked = chosen_requirements(require, requirements)
    chosen_percentages = chosen_percentiles(percentiles)
    description = read_manifest(folder)
    results = open_campaign(folder, runs)
    require_runs(runs, results.sizes["run"], folder)
    digest = digest_of(description)
    decided = decided_by(folder, digest)
    summary = summarize(
        results,
        chosen_percentages,
        asked or decided or (),
        sequential=decided is not None,
    )
    chosen = why = None
    try:
        chosen = stored_mission(description, mission)
        scenario = stored_scenario(description, chosen)
    except CampaignError as error:
        if mission is not None or figures_only:
            raise
        chosen, scenario, why = None, None, str(error)
    if not quiet and not json and not figures_only:
        if chosen is not None:
            as_published = is_as_published(description, chosen)
            print_campaign(chosen, results, as_published, summary, full)
        else:
            name = str(description.get("mission", folder.name))
            print_summary(name, summary, full=full)
    written = []
    drawn = []
    if figures:
        if chosen is not None and scenario is not None:
            flown = stored_histories(folder, digest)
            if flown is not None:  # of these runs, and the nominal flight
                flown = flown.isel(run=first_of(flown, results.sizes["run"]))
            drawn = write_figures(folder, chosen, scenario, results, flown, formats)
            written.append(f"figures: {folder / FIGURES}")
            if flown is None and "time" not in results.dims:
                written.append(
                    "without those of histories, which are not stored: run the same "
                    "campaign again, which flies the histories"
                )
        else:
            written.append(f"no figures: {why}")
    if not figures_only:
        write_summary(folder, summary)
        title = folder.name if chosen is None else chosen.title
        written.append(f"page: {write_page(folder, title, summary, drawn)}")
    if json:
        typer.echo(summary.as_json(), nl=False)
    elif not quiet:
        for line in written:
            typer.echo(line)
    leave(summary.verdicts)
