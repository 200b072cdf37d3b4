"""`jentry optimize`: the best flight of a vehicle under constraints."""

import dataclasses
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
    folder_of_results,
    set_up,
)


_CONTROL = "START:LEAST:MOST"


End = Annotated[
    list[str] | None,
    typer.Option(
        metavar="QUANTITY=VALUE",
        help="End constraint, such as altitude=24.4km; it replaces those of the problem. "
        "LOW:HIGH in place of VALUE for a range. May be repeated.",
    ),
]
Limits = Annotated[
    bool, typer.Option(help="Impose the limits of the path constraints.")
]
Bank = Annotated[
    str | None,
    typer.Option(
        metavar=_CONTROL,
        help="Start of the bank, and the values between which it stays: "
        "-45deg:-89deg:1deg.",
    ),
]
AngleOfAttack = Annotated[
    str | None,
    typer.Option(
        metavar=_CONTROL,
        help="Start and range of the angle of attack. The law of the mission commands it "
        "if neither this option nor the problem frees it.",
    ),
]
Nodes = Annotated[
    int | None, typer.Option(help="Coefficients of each spline; 40 if not given.")
]
OverIndex = Annotated[
    Over | None,
    typer.Option(help="Index of the splines; energy if not given."),
]
Every = Annotated[
    float | None,
    typer.Option(help="Interval at which limits are imposed, s; 10 if not given."),
]


@app.command("optimize")
def command(
    mission: MissionName,
    problem: Annotated[
        str | None,
        typer.Option(
            help="Problem of the mission, its first if not given; the other options "
            "change it."
        ),
    ] = None,
    maximize: Annotated[
        str | None,
        typer.Option(
            metavar="QUANTITY",
            help="Quantity to maximize: latitude, downrange or another quantity at the "
            "end, or the peak of a path constraint by its name.",
        ),
    ] = None,
    minimize: Annotated[
        str | None,
        typer.Option(
            metavar="QUANTITY", help="Quantity to minimize, in place of --maximize."
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
            help="Folder for the best flight: results/MISSION-optimized if not given.",
        ),
    ] = None,
    law: Law = None,
    case: Case = None,
    world: World = None,
    set_: Set = None,
    config: Config = None,
    step: Step = None,
) -> None:
    """Find the best flight: optimize bank and angle of attack by exact gradients."""
    set_up(workers=1)

    from ..flight.solver import FixedStep
    from ..planning.flight_problem import best_flight
    from .optimization_options import problem_asked
    from .optimization_report import print_optimized, write_optimized

    chosen, scenario, overrides = chosen_scenario(
        mission, (law, case, world), config, set_, law_flies=False
    )
    asked = problem_asked(
        chosen,
        problem,
        scenario,
        maximize=maximize,
        minimize=minimize,
        end=end or (),
        keeps_limits=limits,
        bank=bank,
        angle_of_attack=angle_of_attack,
        nodes=nodes,
        over=over,
        history=every,
    )
    begin = None if overrides.free_controls is None else scenario.guidance
    if begin is not None and (nodes is not None or over is not None):
        raise ValueError(
            "--nodes or --over is given, and --config already has splines, "
            "[free_controls]: give the one or the other"
        )
    if overrides.values:
        asked = dataclasses.replace(asked, published={})
    best = best_flight(scenario, asked, FixedStep(step), begin)
    print_optimized(chosen, overrides.choice, asked, best)
    folder = folder_of_results(out, f"{chosen.name}-optimized")
    for written in write_optimized(
        folder, mission, chosen, overrides.choice, asked, best, overrides, step
    ):
        typer.echo(f"written: {written}")
