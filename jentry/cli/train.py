"""`jentry train`: train the networks of a mission."""

from pathlib import Path
from typing import Annotated

import typer

from .ending import rounding_off
from .options import MissionName, Workers, app, folder_of_results, set_up


@app.command("train")
def command(
    mission: MissionName,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the networks; results/MISSION-networks if not given."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of flights and weights.")] = 0,
    flights: Annotated[int, typer.Option(help="Flights from the entry.")] = 2000,
    again: Annotated[
        int, typer.Option(help="Flights from points along those.")
    ] = 10000,
    iterations: Annotated[int, typer.Option(help="Steps of the optimizer.")] = 5000,
    workers: Workers = None,
) -> None:
    """Fly the training data of a mission and train its networks."""
    set_up(workers)
    from ..campaign.dispersions import key_of
    from ..missions import ALL, find_mission
    from .training_report import print_cards

    chosen = find_mission(mission)
    if chosen.train is None:
        able = ", ".join(m.name for m in ALL.values() if m.train is not None)
        raise ValueError(f"mission {chosen.name} has no networks to train: see {able}")
    for name, value in (("flights", flights), ("again", again)):
        if value < 100:
            raise ValueError(f"--{name} is {value}: a network needs 100 or more")
    key_of(seed)
    if iterations < 1:
        raise ValueError(f"--iterations is {iterations}: it must be 1 or more")
    folder = folder_of_results(out, f"{chosen.name}-networks")
    with rounding_off("nothing is stored") as look:

        def report(line: str) -> None:
            typer.echo(line, err=True)
            look()

        cards = chosen.train(
            folder,
            seed,
            flights=flights,
            again=again,
            iterations=iterations,
            report=report,
        )
    print_cards(chosen, cards)
    typer.echo(f"networks: {folder}")
