"""Table of `jentry train`: each network with its errors."""

from collections.abc import Mapping
from typing import Any

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
