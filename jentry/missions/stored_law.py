"""The weights of a neural law that come with a mission."""

from pathlib import Path

from .._computed_once import computed_once
from ..guidance.neural_law import purpose_of
from ..onboard.recurrent_network import RecurrentNetwork, load_recurrent_network


@computed_once
def law_network(folder: Path, with_angle: bool = False) -> RecurrentNetwork:
    """The network of the law in a folder, which commands the bank alone or the angle of
    attack too. Raises `ValueError` for a file with another."""
    purpose = purpose_of(with_angle)
    network, _ = load_recurrent_network(folder / "law.npz", purpose)
    return network
