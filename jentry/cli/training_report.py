"""Tables of `jentry train`: each network with its errors, and the course of a law."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..learning.law_seeds import SeedsOfLaw
from ..learning.law_training import LawTraining
from ..learning.neural_law import TrainedLaw
from ..learning.training_record import PERCENTILES, Judged
from ..missions.mission import Mission
from .tables import new_console, new_table, print_under


_COLUMNS = {
    # Errors of the velocity at the target. At the entry the flight is adjusted first; the
    # error of the median of all flights is there for comparison.
    "mean error at the entry, m/s": "held out mean error at the entry, m/s",
    "of the median there, m/s": "mean deviation at the entry from the median, m/s",
    "mean, all times to go, m/s": "held out mean error, m/s",
    "95 %, all times to go, m/s": "held out 95 % error, m/s",
    # Errors of the range.
    "mean error, m": "held out mean error, m",
    "95 %, m": "held out 95 % error, m",
    "mean, below 100 km, m": "held out mean error below 100 km, m",
    "95 %, below 100 km, m": "held out 95 % error below 100 km, m",
}
"""Columns with their keys on the card of a network, for keys that the card has"""


def print_cards(mission: Mission, cards: Mapping[str, Mapping[str, Any]]) -> None:
    """Print the purpose of each trained network, and its errors on held-out flights."""
    some = next(iter(cards.values()))
    columns = {title: key for title, key in _COLUMNS.items() if key in some}
    table = new_table("network", *columns)
    for name, card in cards.items():
        table.add_row(name, *(f"{card[key]:.3f}" for key in columns.values()))
    console = new_console()
    print_under(console, f"{mission.name}: trained networks, held-out errors", table)
    for name, card in cards.items():
        console.print(
            f"{name}: {card['purpose']}; trained on {card['samples']} samples"
        )
        for reason, count in card["left out"].items():
            console.print(f"  left out: {count} of flights that {reason}")
        count = card["held out samples outside of the ranges"]
        console.print(f"  held-out samples outside of the ranges: {count}")


def judged_line(training: LawTraining, judged: Judged) -> str:
    """Line about a judgement in the course of the training of a law."""
    method = training.methods[judged.method]
    name = type(method).__name__.removesuffix("Steps")
    off = ", ".join(
        f"{p:g} % {d:.4g}" for p, d in zip(PERCENTILES, judged.distances, strict=True)
    )
    return (
        f"{name} {judged.method + 1}, {judged.step} of {method.steps} steps, "
        f"{judged.flights} flights, {judged.seconds:.0f} s: distance {off}"
        + (f"; {judged.without_end} without an end" if judged.without_end else "")
    )


def print_seeds(
    mission: Mission, law: str, training: LawTraining, trained: SeedsOfLaw
) -> None:
    """Print the errors of the law of each seed, their spread, and those of the best."""
    table = new_table("flights", *(f"{p:g} %" for p in PERCENTILES), "without an end")
    rows = {f"seed {seed}": x for seed, x in trained.choosing.items()}
    rows[f"others, seed {trained.best}"] = trained.final
    for name, held_out in rows.items():
        numbers = (f"{d:.4g}" for d in held_out.distances)
        table.add_row(name, *numbers, str(held_out.without_end))
    console = new_console()
    print_under(console, f"{mission.name}, {law}: distance on held-out flights", table)
    place = PERCENTILES.index(training.judged_by)
    all_seeds = [x.distances[place] for x in trained.choosing.values()]
    console.print(
        f"best of {len(all_seeds)} seeds by {training.judged_by:g} %: seed {trained.best}; "
        f"{training.judged_by:g} % is from {min(all_seeds):.4g} to {max(all_seeds):.4g}, "
        f"median {np.median(all_seeds):.4g}"
    )
    console.print(
        "all seeds flew the same flights, which chose the best; the others chose nothing"
    )


def print_trained_law(
    mission: Mission, law: str, training: LawTraining, trained: TrainedLaw
) -> None:
    """Print the errors of a trained law on held-out flights, and what was left out."""
    table = new_table("flights", *(f"{p:g} %" for p in PERCENTILES), "without an end")
    best = trained.course[trained.best]
    for name, judged in (("that chose the weights", best), ("others", trained.final)):
        numbers = (f"{d:.4g}" for d in judged.distances)
        table.add_row(name, *numbers, str(judged.without_end))
    console = new_console()
    print_under(console, f"{mission.name}, {law}: distance on held-out flights", table)
    last = trained.course[-1]
    console.print(
        f"best weights after {best.flights} of {last.flights} flights with derivatives, "
        f"{last.seconds:.0f} s"
        + " of the last training"
        * (training.before is not None)
    )
    console.print(
        f"left out: {last.left_out} flights without an end or finite derivatives; counted "
        f"less than half: {last.clipped} with large derivatives"
    )
