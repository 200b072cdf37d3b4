"""`jentry fly`: one flight of a mission."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Case,
    Config,
    History,
    Law,
    MissionName,
    Set,
    Step,
    World,
    app,
    chosen_scenario,
    note_step,
    set_up,
)


@app.command("fly")
def command(
    mission: MissionName,
    law: Law = None,
    case: Case = None,
    world: World = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
    history: History = None,
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, help="Result file (netCDF) to write, with the history."
        ),
    ] = None,
    figure: Annotated[
        Path | None,
        typer.Option(
            help="Figure to write, FILE.png, .pdf or .svg: path, controls, limits and "
            "ground track of the flight. Unless navigation is perfect, its errors over "
            "time are FILE-navigation.png."
        ),
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            help="Trajectory to write for other programs: FILE.csv, .kml (Google Earth) or "
            ".czml (Cesium).",
        ),
    ] = None,
) -> None:
    """Fly a mission once, without dispersions."""
    set_up(workers=1)

    from .._programs import cached
    from ..campaign.store import write_flight
    from ..campaign.trajectory_files import check_trajectory_file, write_trajectory
    from ..flight.flight import fly
    from ..flight.solver import FixedStep
    from ..plots.campaign import FORMATS, save_figures
    from ..world.perturbed_atmosphere import without_zero_perturbations
    from .mission_report import print_flight

    if figure is not None and figure.suffix[1:] not in FORMATS:
        raise ValueError(
            f"--figure is {figure}: give a file that ends in .{', .'.join(FORMATS)}"
        )
    if trajectory is not None:
        check_trajectory_file(trajectory)
    if any(file is not None for file in (out, figure, trajectory)) and history is None:
        history = 1.0
    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    solver = FixedStep(step)
    note_step(scenario, solver, history)
    flight = cached(fly)(without_zero_perturbations(scenario), solver, history)
    print_flight(chosen, scenario, flight)
    if out is not None:
        labels = {**chosen.labels, **overrides.choice.labels}
        write_flight(out, scenario, flight, solver, history, **labels)
        typer.echo(f"written: {out}")
    if figure is not None:
        from ..plots.one_flight import flight_figures

        drawn = flight_figures(scenario, flight, chosen.title, figure.stem)
        for path in save_figures(drawn, figure.parent, [figure.suffix[1:]]):
            typer.echo(f"figure: {path}")
    if trajectory is not None:
        write_trajectory(scenario, flight, trajectory)
        typer.echo(f"written: {trajectory}")
