"""What `jentry train` prints: each network, and how well it does."""

from collections.abc import Mapping
from typing import Any

from ..missions.mission import Mission
from .tables import new_console, new_table, print_under


def print_cards(mission: Mission, cards: Mapping[str, Mapping[str, Any]]) -> None:
    """What each trained network is for, and how well it does on flights held out.

    At the entry, where a flight is adjusted first, beside the mean over all times to go;
    and what a prediction of the median would miss by there.
    """
    keys = {
        "mean error at the entry": "held out mean error at the entry, m/s",
        "of the median there": "mean deviation at the entry from the median, m/s",
        "mean, all times to go": "held out mean error, m/s",
        "95 %, all times to go": "held out 95 % error, m/s",
    }
    table = new_table("network", *(f"{title}, m/s" for title in keys))
    for name, card in cards.items():
        table.add_row(name, *(f"{card[key]:.3f}" for key in keys.values()))
    console = new_console()
    print_under(console, f"{mission.name}: trained networks, held-out errors", table)
    for name, card in cards.items():
        console.print(
            f"{name}: {card['purpose']}; trained on {card['samples']} samples"
        )
        for reason, count in card["left out"].items():
            console.print(f"  left out: {count} of flights that {reason}")
        count = card["held out samples outside of the ranges"]
        console.print(f"  held out and outside of the ranges: {count}")
