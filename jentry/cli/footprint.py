"""`jentry footprint`: where a vehicle can end its flight."""

from pathlib import Path
from typing import Annotated

import typer

from .optimize import AngleOfAttack, Bank, End, Every, Limits, Nodes, OverIndex
from .options import (
    Case,
    Config,
    Law,
    MissionName,
    Set,
    Step,
    World,
    app,
    chosen_scenario,
    folder_of_results,
    set_up,
)


@app.command("footprint")
def command(
    mission: MissionName,
    directions: Annotated[
        int,
        typer.Option(help="Points on the outline, in addition to the four outermost."),
    ] = 16,
    problem: Annotated[
        str | None,
        typer.Option(
            help="Problem of the mission that has the free controls and the constraints; "
            "the one named footprint, or the first, if not given."
        ),
    ] = None,
    end: End = None,
    limits: Limits = True,
    bank: Bank = None,
    angle_of_attack: AngleOfAttack = None,
    nodes: Nodes = None,
    over: OverIndex = None,
    every: Every = None,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            help="Folder for table and figure: results/MISSION-footprint if not given.",
        ),
    ] = None,
    law: Law = None,
    case: Case = None,
    world: World = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
) -> None:
    """Find the landing footprint: flights that end farthest out in every direction."""
    set_up(workers=1)

    from ..flight.solver import FixedStep
    from ..planning.landing_footprint import footprint
    from .optimization_options import problem_asked
    from .optimization_report import print_footprint, write_footprint
    from .progress import reported

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_, law_flies=False
    )
    if problem is None and "footprint" in chosen.problems:
        problem = "footprint"
    asked = problem_asked(
        chosen,
        problem,
        scenario,
        maximize=None if problem or chosen.problems else "downrange",
        minimize=None,
        end=end or (),
        keeps_limits=limits,
        bank=bank,
        angle_of_attack=angle_of_attack,
        nodes=nodes,
        over=over,
        history=every,
    )
    with reported(directions + 4) as told:
        found = footprint(scenario, asked, directions, FixedStep(step), told)
    print_footprint(chosen, overrides.choice, found)
    folder = folder_of_results(out, f"{chosen.name}-footprint")
    for written in write_footprint(folder, chosen, overrides.choice, found):
        typer.echo(f"written: {written}")
