"""`jentry train`: train the networks of a mission."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .ending import rounding_off
from .options import MissionName, Workers, app, folder_of_results, set_up


if TYPE_CHECKING:
    from ..missions.mission import Mission


_FLIGHTS, _AGAIN, _ITERATIONS = 2000, 10_000, 5000


@app.command("train")
def command(
    mission: MissionName,
    law: Annotated[
        str | None,
        typer.Option(
            help="Neural law to train through the flight; without it the networks of "
            "the mission that predict."
        ),
    ] = None,
    imitate: Annotated[
        bool,
        typer.Option("--imitate", help="With --law: begin with another law's flights."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the networks; results/MISSION-networks if not given."
        ),
    ] = None,
    seed: Annotated[
        list[int] | None,
        typer.Option(
            help="Seed of flights and weights; 0 if not given. With --law repeatable: "
            "each seed is trained, and the best is taken."
        ),
    ] = None,
    flights: Annotated[
        int | None,
        typer.Option(help=f"Flights from the entry; {_FLIGHTS} if not given."),
    ] = None,
    again: Annotated[
        int | None,
        typer.Option(help=f"Flights from points along those; {_AGAIN} if not given."),
    ] = None,
    iterations: Annotated[
        int | None,
        typer.Option(help=f"Steps of the optimizer; {_ITERATIONS} if not given."),
    ] = None,
    workers: Workers = None,
) -> None:
    """Train the networks of a mission: those that predict, or that of a neural law.

    The training of a law resumes if its folder has an unfinished one.
    """
    set_up(workers)
    from ..campaign.dispersions import key_of
    from ..missions import ALL, find_mission

    chosen = find_mission(mission)
    seeds = seed or [0]
    for each in seeds:
        key_of(each)
    folder = folder_of_results(out, f"{chosen.name}-networks")
    given = {"flights": flights, "again": again, "iterations": iterations}
    if law is not None:
        for name, value in given.items():
            if value is not None:
                raise ValueError(
                    f"--{name} is for networks that predict: leave it out with --law, "
                    "whose mission states the flights and the steps"
                )
        if len(seeds) == 1:
            _train_law(chosen, law, seeds[0], folder, imitate)
        else:
            _train_seeds(chosen, law, seeds, folder, imitate)
        return
    if len(seeds) > 1:
        raise ValueError(
            f"there are {len(seeds)} seeds: networks that predict have one; leave out the "
            "others, or give --law"
        )
    if imitate:
        raise ValueError("--imitate is for a law: give it with --law, or leave it out")
    if chosen.train is None:
        able = ", ".join(m.name for m in ALL.values() if m.train is not None)
        laws = ", ".join(chosen.law_trainings)
        instead = f", or train its law with --law {laws}" if laws else ""
        raise ValueError(
            f"mission {chosen.name} has no networks to train: see {able}{instead}"
        )
    usual = {"flights": _FLIGHTS, "again": _AGAIN, "iterations": _ITERATIONS}
    numbers = {n: usual[n] if x is None else x for n, x in given.items()}
    for name in ("flights", "again"):
        if numbers[name] < 100:
            raise ValueError(
                f"--{name} is {numbers[name]}: a network needs 100 or more"
            )
    if numbers["iterations"] < 1:
        raise ValueError(
            f"--iterations is {numbers['iterations']}: it must be 1 or more"
        )
    with rounding_off("nothing is stored") as look:

        def report(line: str) -> None:
            typer.echo(line, err=True)
            look()

        cards = chosen.train(folder, seeds[0], **numbers, report=report)
    from .training_report import print_cards

    print_cards(chosen, cards)
    typer.echo(f"networks: {folder}")


def _train_law(
    mission: "Mission", law: str, seed: int, folder: Path, imitate: bool
) -> None:
    from ..learning.law_training import train_law
    from .training_report import print_trained_law

    training = mission.law_training(law)
    card = _card(mission, law, [seed], imitate)
    with _reporting() as calls:
        trained = train_law(training, seed, folder, imitate=imitate, card=card, **calls)
    print_trained_law(mission, law, training, trained)
    typer.echo(f"network: {folder}")


def _train_seeds(
    mission: "Mission", law: str, seeds: list[int], folder: Path, imitate: bool
) -> None:
    from ..learning.law_seeds import train_law_of_seeds
    from .training_report import print_seeds

    training = mission.law_training(law)
    card = _card(mission, law, seeds, imitate)
    with _reporting() as calls:
        trained = train_law_of_seeds(
            training, seeds, folder, imitate=imitate, card=card, **calls
        )
    print_seeds(mission, law, training, trained)
    typer.echo(f"network: {folder}")


def _card(
    mission: "Mission", law: str, seeds: list[int], imitate: bool
) -> dict[str, Any]:
    """Entries of a model card: mission, law, and the command that trains it."""
    words = ["jentry", "train", mission.name, "--law", law]
    for seed in seeds:
        words += ["--seed", str(seed)]
    command = " ".join(words + ["--imitate"] * imitate)
    return {"mission": mission.name, "law": law, "command": command}


@contextlib.contextmanager
def _reporting() -> Iterator[dict[str, Any]]:
    """Functions that print the progress of a training; an interruption ends it well."""
    from .training_report import judged_line

    with rounding_off("the same command goes on from here") as look:

        def say(line: str) -> None:
            typer.echo(line, err=True)
            look()

        def report(training: Any, judged: Any) -> None:
            say(judged_line(training, judged))

        yield {"say": say, "report": report}
