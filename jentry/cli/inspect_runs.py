"""`jentry inspect`: the worst runs of a campaign and their causes; one run again."""

from typing import Annotated

import typer

from .options import OwnMission, StoredFolder, Workers, app, set_up


@app.command("inspect")
def command(
    folder: StoredFolder,
    by: Annotated[
        str | None,
        typer.Option(
            help="Output that orders the runs, such as downrange_error; the miss distance "
            "if not given. Errors count by their magnitude."
        ),
    ] = None,
    smallest: Annotated[
        bool, typer.Option("--smallest", help="The smallest values are the worst.")
    ] = False,
    worst: Annotated[
        int, typer.Option(help="How many of the worst runs to show.")
    ] = 10,
    run: Annotated[
        int | None,
        typer.Option(
            help="Fly this run again, store its history in FOLDER/inspect, and show which "
            "inputs drive it. If not given, they are shown for the worst run."
        ),
    ] = None,
    history: Annotated[
        float | None, typer.Option(help="Interval of the history of --run, s.")
    ] = None,
    gradient: Annotated[
        bool,
        typer.Option(help="Show derivatives of the run's output by its inputs."),
    ] = True,
    mission: OwnMission = None,
    workers: Workers = None,
) -> None:
    """Show the worst runs of a stored campaign, and which inputs drive them."""
    from ..campaign.parts import read_manifest

    description = read_manifest(folder)
    # The XLA options of the campaign: with others the numbers differ by rounding.
    set_up(workers, fast=any("fusion" in o for o in description["xla_options"]))
    from ..campaign.outputs import is_error
    from ..campaign.store import open_campaign
    from ..missions.stored import stored_mission, stored_scenario, stored_solver
    from ..statistics.ranking import (
        inputs_of,
        ordered_by,
        rank_correlations,
        require_output,
        worst_runs,
    )
    from .inspect_report import (
        fly_again,
        print_correlations,
        print_gradient,
        print_worst,
    )

    if history is not None and run is None:
        raise ValueError(
            "--history is the interval of the history of --run: give the number of a run"
        )
    if history is not None and not history > 0.0:
        raise ValueError(f"--history is {history}: the interval must be positive")
    if worst < 1:
        raise ValueError(f"--worst is {worst}: it must be 1 or more")
    results = open_campaign(folder)
    count = results.sizes["run"]
    if run is not None and not 0 <= run < count:
        raise ValueError(f"--run is {run}, but {folder} has the runs 0 to {count - 1}")
    name = ordered_by(results) if by is None else by.strip().strip("|")
    name = name.replace(" ", "_").replace("-", "_")
    require_output(results, name)
    if run is not None or gradient:
        chosen = stored_mission(description, mission)
        scenario = stored_scenario(description, chosen)
        solver = stored_solver(description)
    bad = worst_runs(results, name, worst, smallest=smallest)
    print_worst(results, name, bad, count)
    asked = f"|{name}|" if is_error(name) else name
    print_correlations(results, asked, *rank_correlations(results, asked))
    if run is None and not gradient:
        return
    which = bad[0].run if run is None else run
    if run is not None:
        fly_again(folder, chosen, scenario, results, run, solver, description, history)
    if gradient:
        inputs = {a: float(x[which]) for a, x in inputs_of(results).items()}
        print_gradient(scenario, solver, results, name, which, inputs)
