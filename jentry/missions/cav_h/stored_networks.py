"""The networks that come with the CAV-H mission, and the purpose of each."""

from pathlib import Path
from typing import NamedTuple

from ..._computed_once import computed_once
from ...guidance.bezier.prediction import VELOCITIES, Inputs, NetworkPredictor
from ...onboard.network import card_ranges, load_network


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""


class Purpose(NamedTuple):
    """Purpose and inputs of a network."""

    anchoring: str
    inputs: Inputs

    @property
    def sentence(self) -> str:
        """The purpose as a text, as in the model card."""
        return (
            f"CAV-H velocity at the target from {self.inputs.value}, {self.anchoring}"
        )


PURPOSES = {
    "stored": Purpose("stored k1 and k2", Inputs.ALL),
    "subdivision": Purpose("subdivided curve", Inputs.ALL),
    "state-only": Purpose("stored k1 and k2", Inputs.STATE),
}
"""Purposes of the networks by the names of their files; the last one is the paper's."""


@computed_once
def network_predictor(name: str, folder: Path = FOLDER) -> NetworkPredictor:
    """A stored network as a predictor of the velocity at the target.

    Raises `ValueError` for a file that is damaged or that contains another network.
    """
    path = folder / f"{name}.npz"
    network, card = load_network(path, PURPOSES[name].sentence)
    try:
        (velocities,) = card_ranges({VELOCITIES: card.get(VELOCITIES)})
        return NetworkPredictor(network, velocities, PURPOSES[name].inputs)
    except ValueError as error:
        raise ValueError(f"{path} contradicts its purpose: {error}") from None
