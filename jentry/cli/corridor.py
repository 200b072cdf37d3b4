"""`jentry corridor`: from which flight-path angles an aerocapture is possible."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Case,
    Config,
    Json,
    MissionName,
    Set,
    Step,
    World,
    app,
    chosen_scenario,
    folder_of_results,
    set_up,
)


@app.command("corridor")
def command(
    mission: MissionName,
    steepest: Annotated[
        str, typer.Option(help="Steepest flight-path angle that is searched.")
    ] = "-20deg",
    shallowest: Annotated[
        str, typer.Option(help="Shallowest flight-path angle that is searched.")
    ] = "-5deg",
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            help="Folder for numbers and figure: results/MISSION-corridor if not given.",
        ),
    ] = None,
    json: Json = False,
    case: Case = None,
    world: World = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
) -> None:
    """Find the entry corridor of an aerocapture: lift down and lift up all the way.

    The flights have a constant bank in place of the guidance law.
    """
    set_up(workers=1)

    from ..flight.solver import FixedStep
    from ..planning.aerocapture_corridor import capture_corridor, limiting_flights
    from .corridor_report import angle, as_json, print_corridor, write_corridor

    limits = angle("--steepest", steepest), angle("--shallowest", shallowest)
    chosen, scenario, overrides = chosen_scenario(
        mission, (None, case, world), config, set_, law_flies=False
    )
    solver = FixedStep(step)
    found = capture_corridor(scenario, *limits, solver)
    flights = limiting_flights(scenario, found, solver)
    folder = folder_of_results(out, f"{chosen.name}-corridor")
    numbers = as_json(chosen, overrides.choice, scenario, found, flights)
    # Written before anything is printed: whoever reads the output may close it.
    paths = write_corridor(folder, chosen, overrides.choice, found, flights, numbers)
    if json:
        typer.echo(numbers, nl=False)
        return
    print_corridor(chosen, overrides.choice, scenario, found, flights)
    for path in paths:
        typer.echo(f"written: {path}")
