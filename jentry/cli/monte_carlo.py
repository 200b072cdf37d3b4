"""`jentry monte-carlo`: a campaign of dispersed runs, stored, printed and drawn."""

import itertools
from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import (
    Case,
    ClusterAt,
    Config,
    Device,
    Dispersions,
    Fast,
    Formats,
    History,
    Json,
    Law,
    MissionName,
    Percentiles,
    Quiet,
    Require,
    RequirementsFile,
    Sampler,
    Sampling,
    Seed,
    Set,
    Step,
    Workers,
    World,
    app,
    chosen_scenario,
    dispersion_table,
    flying_at,
    folder_of_results,
    import_meanwhile,
    note_step,
    refuse_set_in_vain,
    set_up,
)


@app.command("monte-carlo")
def command(
    mission: MissionName,
    runs: Annotated[
        int | None,
        typer.Option(help="Number of runs; 1000, or all of --inputs, if not given."),
    ] = None,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results; results/MISSION if not given. The same command "
            "resumes a campaign that is there."
        ),
    ] = None,
    workers: Workers = None,
    device: Device = None,
    cluster: ClusterAt = None,
    law: Law = None,
    case: Case = None,
    world: World = None,
    dispersions: Dispersions = None,
    sampler: Sampler = Sampling.PLAIN,
    inputs: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Inputs to fly in place of drawn ones: a csv file with addresses in the "
            "first line and one run in each further line.",
        ),
    ] = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
    history: History = None,
    fast: Fast = False,
    figures: Annotated[
        bool,
        typer.Option(
            help="Draw the overview in OUT/figures; jentry report draws all figures."
        ),
    ] = True,
    format_: Formats = "png",
    percentiles: Percentiles = None,
    require: Require = None,
    requirements: RequirementsFile = None,
    until_decided: Annotated[
        bool,
        typer.Option(
            "--until-decided",
            help="Fly --runs, and then more runs until a sequential test decides the "
            "requirements.",
        ),
    ] = False,
    most_runs: Annotated[
        int | None,
        typer.Option(
            help="Most runs that --until-decided flies; 100 000 if not given."
        ),
    ] = None,
    slice_: Annotated[
        str | None,
        typer.Option(
            "--slice",
            metavar="I/N",
            help="Fly only the I-th of N slices of the runs, such as 3/10, on one of N "
            "machines; `jentry merge` puts their folders together.",
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fly dispersed runs, store them, print their statistics and draw figures."""
    set_up(workers, fast, device)
    drawing = (
        ("matplotlib.figure", "matplotlib.backends.backend_agg") if figures else ()
    )
    import_meanwhile(
        "xarray", "h5netcdf", "rich.table", "rich.progress", "scipy.special", *drawing
    )
    from ..campaign.dispersions import addresses_of_dispersion
    from ..campaign.parts import digest_of, read_manifest
    from ..campaign.store import open_campaign, run_campaign, runs_of_part
    from ..flight.solver import FixedStep
    from ..missions.stored import is_as_published
    from ..statistics.acceptance import require_outputs
    from ..statistics.summary import summarize
    from .campaign_files import (
        decided_by,
        note_until_decided,
        write_figures,
        write_page,
        write_summary,
    )
    from .campaign_report import print_campaign
    from .dispersions_report import print_what_is_flown
    from .figures import (
        FIGURES,
        histories_of,
        store_histories,
        with_overview_alone,
    )
    from .overrides import read_inputs
    from .progress import reported
    from .report_choices import (
        chosen_formats,
        chosen_percentiles,
        chosen_requirements,
        chosen_slice,
        leave,
        refuse_both,
        require_runs,
    )
    from .until_decided import further_runs

    refuse_both(json, quiet)
    formats = chosen_formats(format_)
    percentages = chosen_percentiles(percentiles)
    asked = chosen_requirements(require, requirements)
    if until_decided and not asked:
        raise ValueError("--until-decided needs a requirement: give --require")
    if until_decided and inputs is not None:
        raise ValueError("--until-decided draws more runs, but --inputs has no more")
    if most_runs is not None and not until_decided:
        raise ValueError("--most-runs needs --until-decided: give that as well")
    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    if sampler is not Sampling.PLAIN and asked:
        raise ValueError(
            f"--sampler {sampler} spreads the runs evenly, but requirements are judged "
            "from independent runs: leave one of them out"
        )
    if inputs is not None and (dispersions is not None or overrides.disperses):
        raise ValueError("--inputs takes the place of dispersions: give one of them")
    base, table = "", {}
    if inputs is None:
        base, table = dispersion_table(chosen, overrides, dispersions)
        refuse_set_in_vain(scenario, overrides, table)
    part = None if slice_ is None else chosen_slice(slice_)
    if part is not None and (asked or until_decided or json):
        raise ValueError(
            "--slice flies a share of the runs without a summary: leave out --require, "
            "--requirements, --until-decided and --json, and report the merged campaign"
        )
    given = None if inputs is None else read_inputs(inputs)
    if given is not None:
        rows = len(next(iter(given.values())))
        runs = rows if runs is None else runs
        require_runs(runs, rows, inputs)
    elif runs is None:
        runs = 1000
    dispersed = (addresses_of_dispersion(scenario, *item) for item in table.items())
    require_outputs(asked, scenario, given or itertools.chain.from_iterable(dispersed))
    most = 100_000 if most_runs is None else most_runs
    if until_decided and most < runs:
        raise ValueError(
            f"--most-runs is {most}, and --runs, with which it begins, is {runs}: give more"
        )
    named = chosen.name
    if part is not None:
        figures = False
        named += f"-{part[0]}-of-{part[1]}"
    folder = folder_of_results(out, named)
    solver = FixedStep(step)
    if not quiet and not json:
        note_step(scenario, solver, history)
    spread = sampler.of(runs)
    histories = histories_of(
        scenario, table, seed, given, runs, history, solver, spread
    )
    resumed = rounding_off("the same command resumes")
    to_fly = most if until_decided else runs
    if part is not None:
        to_fly = len(runs_of_part(runs, part))
    with (
        resumed as look,
        reported(to_fly, quiet) as told,
        histories,
        flying_at(cluster),
    ):

        def report(stored: int) -> None:
            if figures:  # run_campaign has checked that the campaign can be flown
                histories.begin()
            told(stored)
            look()

        while True:
            run_campaign(
                folder,
                scenario,
                table if given is None else None,
                seed,
                runs,
                inputs=given,
                solver=solver,
                history=history,
                sampler=spread,
                report=report,
                part=part,
                **chosen.labels,
                **overrides.choice.labels,
            )
            if part is not None:
                break
            results = open_campaign(folder, runs)
            if not until_decided:
                break
            note_until_decided(folder, asked, digest_of(read_manifest(folder)))
            more = further_runs(asked, results, most)
            if not more:
                break
            runs += more
    if part is not None:
        if not quiet:
            flown = runs_of_part(runs, part)
            typer.echo(
                f"stored: {folder}, runs {flown[0]} to {flown[-1]} of {runs}; put the "
                f"{part[1]} slices together with jentry merge"
            )
        return
    description = read_manifest(folder)
    digest = digest_of(description)
    decided = decided_by(folder, digest)
    summary = summarize(
        results, percentages, asked or decided or (), sequential=decided is not None
    )
    if not quiet and not json:
        if given is None:
            print_what_is_flown(chosen, scenario, overrides, base, table)
        as_published = is_as_published(description, chosen)
        print_campaign(chosen, results, as_published, summary)
        typer.echo(f"stored: {folder}")
    write_summary(folder, summary)
    drawn = []
    if figures:
        flown = histories.flown()
        drawn = write_figures(
            folder, with_overview_alone(chosen), scenario, results, flown, formats
        )
        store_histories(folder, flown, digest)
        if not quiet and not json:
            typer.echo(f"figures: {folder / FIGURES}; jentry report draws all of them")
    write_page(folder, chosen.title, summary, drawn)
    if json:
        typer.echo(summary.as_json(), nl=False)
    leave(summary.verdicts)
