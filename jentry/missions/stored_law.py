"""The weights of a neural law that come with a mission."""

from pathlib import Path

from .._computed_once import computed_once
from ..guidance.neural_law import PURPOSE
from ..onboard.recurrent_network import RecurrentNetwork, load_recurrent_network


@computed_once
def law_network(folder: Path) -> RecurrentNetwork:
    """The network of the law in a folder. Raises `ValueError` for a file with another."""
    network, _ = load_recurrent_network(folder / "law.npz", PURPOSE)
    return network
