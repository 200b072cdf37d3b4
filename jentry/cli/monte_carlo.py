"""`jentry monte-carlo`: a campaign of dispersed runs, stored, printed and drawn."""

from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import (
    Config,
    Dispersions,
    Fast,
    MissionName,
    Sampler,
    Sampling,
    Set,
    Step,
    Variant,
    Workers,
    app,
    chosen_scenario,
    dispersion_table,
    first_given,
    import_meanwhile,
    set_up,
)


@app.command("monte-carlo")
def command(
    mission: MissionName,
    runs: Annotated[
        int | None,
        typer.Option(help="Number of runs; 1000, or all of --inputs, if not given."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the draws.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the results; results/MISSION if not given. The same command "
            "resumes what is there."
        ),
    ] = None,
    workers: Workers = None,
    variant: Variant = None,
    dispersions: Dispersions = None,
    sampler: Sampler = Sampling.PLAIN,
    inputs: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Fly given inputs in place of drawn ones: csv, addresses in the first "
            "line, a run in each other.",
        ),
    ] = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
    history: Annotated[
        float | None, typer.Option(help="Keep all trajectories at this interval, s.")
    ] = None,
    fast: Fast = False,
    figures: Annotated[
        bool, typer.Option(help="Draw figures into OUT/figures.")
    ] = True,
) -> None:
    """Fly dispersed runs, store them, print their statistics and draw figures."""
    set_up(workers, fast)
    drawing = (
        ("matplotlib.figure", "matplotlib.backends.backend_agg") if figures else ()
    )
    import_meanwhile("xarray", "h5netcdf", "rich.table", "rich.progress", *drawing)
    from ..campaign.store import open_campaign, run_campaign
    from ..flight.solver import FixedStep
    from .dispersions_report import print_what_is_flown
    from .figures import draw_figures, histories_of
    from .overrides import read_inputs
    from .report import print_campaign, progress

    chosen, scenario, overrides = chosen_scenario(mission, variant, config, set_)
    variant = first_given(variant, overrides.variant, *chosen.variants)
    reading, table = dispersion_table(chosen, overrides, dispersions)
    if inputs is not None and (dispersions is not None or overrides.disperses):
        raise ValueError("--inputs takes the place of dispersions: give one of them")
    as_published = (
        inputs is None
        and sampler is Sampling.PLAIN
        and not overrides.values
        and overrides.dispersions is None
        and variant == chosen.published_variant
        and reading == chosen.published_dispersions
    )
    given = None if inputs is None else read_inputs(inputs)
    if given is not None:
        rows = len(next(iter(given.values())))
        runs = rows if runs is None else runs
        if runs > rows:
            raise ValueError(f"--runs is {runs}, and {inputs} has {rows}: give no more")
    elif runs is None:
        runs = 1000
    folder = Path("results") / chosen.name if out is None else out
    solver = FixedStep(step)
    spread = sampler.of(runs)
    histories = histories_of(
        scenario, table, seed, given, runs, history, solver, spread
    )
    resumed = rounding_off("the same command resumes")
    with resumed as look, progress(runs) as told, histories:

        def report(stored: int) -> None:
            if figures:  # now that the campaign is one that can be flown
                histories.begin()
            told(stored)
            look()

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
            **chosen.labels,
            variant=variant,
        )
    results = open_campaign(folder, runs)
    if given is None:
        print_what_is_flown(chosen, scenario, overrides, reading, table)
    print_campaign(chosen, results, as_published)
    typer.echo(f"stored: {folder}")
    if figures:
        drawn = draw_figures(folder, chosen, scenario, results, histories)
        typer.echo(f"figures: {drawn}")
