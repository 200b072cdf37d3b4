"""`jentry fly`: one flight of a mission."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Config,
    MissionName,
    Set,
    Step,
    Variant,
    app,
    chosen_scenario,
    set_up,
)


@app.command("fly")
def command(
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

    from .._programs import kept
    from ..campaign.store import write_flight
    from ..flight.flight import fly
    from ..flight.solver import FixedStep
    from .mission_report import print_flight

    if out is not None and history is None:
        history = 1.0
    chosen, scenario, _ = chosen_scenario(mission, variant, config, set_)
    solver = FixedStep(step)
    flight = kept(fly)(scenario, solver, history)
    print_flight(chosen, scenario, flight)
    if out is not None:
        write_flight(out, scenario, flight, solver, history, **chosen.labels)
        typer.echo(f"written: {out}")
