"""The commands that fly, and the entry point; what they print is in `report`."""

import errno
import gc
import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

from .._warnings import ResultWarning
from . import design as design
from .ending import fail, forget_output, leaving_at_once, open_streams, rounding_off
from .options import (
    Config,
    Dispersions,
    Fast,
    MissionName,
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


@app.command("list")
def list_missions() -> None:
    """The missions, their variants and their dispersions."""
    from ..missions import ALL
    from .report import print_missions

    print_missions(ALL.values())


@app.command()
def show(
    mission: MissionName,
    variant: Variant = None,
    set_: Set = None,
    config: Config = None,
) -> None:
    """Every number of a mission: address, value and unit."""
    set_up(workers=1)
    from .report import print_leaves

    print_leaves(chosen_scenario(mission, variant, config, set_)[1])


@app.command()
def fly(
    mission: MissionName,
    variant: Variant = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
    history: Annotated[
        float | None, typer.Option(help="Keep the flight at this interval, s.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Result file (netCDF) to write, with the history."),
    ] = None,
) -> None:
    """Fly a mission once, without dispersions."""
    set_up(workers=1)
    import equinox as eqx

    from ..campaign.store import write_flight
    from ..flight.fly import fly as fly_once
    from ..flight.solver import FixedStep
    from .report import print_flight

    if out is not None and history is None:
        history = 1.0
    chosen, scenario, _ = chosen_scenario(mission, variant, config, set_)
    solver = FixedStep(step)
    flight = eqx.filter_jit(fly_once)(scenario, solver, history)
    print_flight(chosen, scenario, flight)
    if out is not None:
        write_flight(out, scenario, flight, solver, history, mission=mission)
        typer.echo(f"written: {out}")


@app.command("monte-carlo")
def monte_carlo(
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
    import_meanwhile("xarray", "h5netcdf", "rich.table", "rich.progress")
    from ..campaign.store import open_campaign, run_campaign
    from ..flight.solver import FixedStep
    from ..overrides import read_inputs
    from .figures import draw_figures
    from .report import print_campaign, progress

    chosen, scenario, overrides = chosen_scenario(mission, variant, config, set_)
    variant = first_given(variant, overrides.variant, *chosen.variants)
    reading, table = dispersion_table(chosen, overrides, dispersions)
    if inputs is not None and (dispersions is not None or overrides.disperses):
        raise ValueError("--inputs takes the place of dispersions: give one of them")
    as_published = (
        inputs is None
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
    folder = Path("results") / mission if out is None else out
    solver = FixedStep(step)
    with rounding_off("the same command resumes") as look, progress(runs) as told:

        def report(stored: int) -> None:
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
            report=report,
            mission=mission,
            variant=variant,
        )
    results = open_campaign(folder, runs)
    print_campaign(chosen, results, as_published)
    typer.echo(f"stored: {folder}")
    if figures:
        drawn = draw_figures(folder, chosen, scenario, results, solver)
        typer.echo(f"figures: {drawn}")


def main() -> None:
    """Run the command; errors that a person can act on are one line, without a traceback.

    Exit codes: 0 done, 1 whoever read the output has left, 2 wrong input, 3 results that
    cannot be used, 4 the machine (no space, no permission, no memory), 130 interrupted.
    """
    # Tracing makes many objects and little rubbish: look for it less often.
    gc.set_threshold(100_000)
    open_streams()
    with leaving_at_once(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ResultWarning)  # it is printed
        _run()


def _run() -> None:
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        forget_output()
        sys.exit(1)
    except Exception as error:
        code, message = _explained(error)
        if isinstance(error, OSError):
            forget_output()
        fail(message, code)


def _explained(error: Exception) -> tuple[int, str]:
    """Exit code and words for what a person can act on; raises all else again."""
    less = "there is not enough memory: fly fewer runs, or keep less of them"
    match error:
        case ValueError():
            return 2, str(error)
        case OSError():
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            advice = "; free some space and run the same command, which resumes"
            return 4, f"{error}{advice if full else ''}"
        case MemoryError():
            return 4, less
        case RuntimeError() if "RESOURCE_EXHAUSTED" in str(error):
            return 4, less
    from ..campaign.errors import CampaignError

    if isinstance(error, CampaignError):
        return 3, str(error)
    raise error
