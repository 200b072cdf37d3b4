"""`jentry linearize`: frozen eigenvalues of the closed loop along a flight."""

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Case,
    Config,
    Law,
    MissionName,
    Over,
    Set,
    Step,
    World,
    app,
    chosen_scenario,
    index_over,
    set_up,
)


@app.command("linearize")
def command(
    mission: MissionName,
    over: Annotated[
        Over,
        typer.Option(
            help="Index at which errors are compared; it must rise or fall all the way."
        ),
    ] = Over.TIME,
    points: Annotated[
        int, typer.Option(help="Points of the flight, evenly spaced over the index.")
    ] = 20,
    faster_than: Annotated[
        float | None,
        typer.Option(
            help="Least magnitude of eigenvalues whose damping counts, per SI unit of the "
            "index. Slow states, such as the heading, look undamped. If not given: over "
            "time that of the mission, otherwise all."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Figure to write, PNG. A JSON file of the same name beside it has all "
            "numbers."
        ),
    ] = None,
    law: Law = None,
    case: Case = None,
    world: World = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
) -> None:
    """Find eigenvalues of the closed loop along a flight, and zeros no gain can move."""
    if out is not None and out.suffix != ".png":
        raise ValueError(f"out is {str(out)!r}: it must be the name of a PNG, loop.png")
    if faster_than is not None and not faster_than >= 0.0:
        raise ValueError(f"--faster-than is {faster_than}: it must not be negative")
    set_up(workers=1)

    from ..analysis.frozen_loop import linearize
    from ..flight.solver import FixedStep
    from .linearization_report import print_loop, write_loop

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_
    )
    index = index_over(over, scenario)
    if faster_than is None:
        named = chosen.modes_faster_than if over is Over.TIME else None
        faster_than = named or 0.0
    loop = linearize(scenario, index, points, solver=FixedStep(step))
    print_loop(chosen, loop, faster_than)
    if out is not None:
        for path in write_loop(out, chosen, overrides.choice, loop, faster_than):
            typer.echo(f"written: {path}")
