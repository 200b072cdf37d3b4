"""The networks of the CAV-H mission: what they are for, and how they are trained."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax

from ...flight.scenario import Scenario
from ...guidance.bezier.prediction import Inputs, NetworkPredictor
from ...learning.velocity_network import VELOCITIES, train_predictor
from ...learning.velocity_samples import fly_samples
from ...onboard.network import card_ranges, load_network, save_network
from .dispersions import state_training_dispersions, training_dispersions


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

BETWEEN = 1600.0, 3600.0
"""m/s at the target, with which the flights end that the networks with factors learn from.
Equation (38) asks before anything is adjusted: 8000 dispersed vehicles then end
between 1860 and 3364 m/s on the stored curve, and as slow as 1776 on a subdivided one."""


class Purpose(NamedTuple):
    """What a network is for, and what it reads."""

    anchoring: str
    inputs: Inputs

    @property
    def sentence(self) -> str:
        """The purpose in words, as in the model card."""
        return (
            f"CAV-H velocity at the target from {self.inputs.value}, {self.anchoring}"
        )


PURPOSES = {
    "stored": Purpose("stored k1 and k2", Inputs.ALL),
    "subdivision": Purpose("subdivided curve", Inputs.ALL),
    "state-only": Purpose("stored k1 and k2", Inputs.STATE),
}
"""Purposes of the networks by the names of their files; the last one is the paper's."""


@functools.cache
def network_predictor(name: str, folder: Path = FOLDER) -> NetworkPredictor:
    """A stored network as a predictor.

    Raises `ValueError` for a file that is damaged or of another network.
    """
    path = folder / f"{name}.npz"
    network, card = load_network(path, PURPOSES[name].sentence)
    try:
        (velocities,) = card_ranges({VELOCITIES: card.get(VELOCITIES)})
        return NetworkPredictor(network, velocities, PURPOSES[name].inputs)
    except ValueError as error:
        raise ValueError(f"{path} contradicts its purpose: {error}") from None


def train(
    scenarios: dict[str, Scenario],
    folder: Path,
    seed: int,
    *,
    flights: int = 2000,
    again: int = 10000,
    iterations: int = 5000,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, dict[str, Any]]:
    """Fly the data, train all networks and store them; gives the model cards by name.

    **Arguments:**

    - `scenarios`: with the law that each is for, by the names of `PURPOSES`.
    - `flights`, `again`: as of `fly_samples`, for each network that reads the curve. For
      the others as much is flown, all of it from the entry with the nominal curve, and
      nothing that reaches the target is left out: what they do not know is meant to be in
      their error.
    - `iterations`: of L-BFGS, for each network.
    - `report`: is told what is done.
    """
    cards = {}
    for number, (name, purpose) in enumerate(PURPOSES.items()):
        scenario = scenarios[name]
        key = jax.random.fold_in(jax.random.key(seed), number)
        if purpose.inputs is Inputs.ALL:
            report(f"{name}: flying {flights} + {again} flights")
            samples = fly_samples(
                scenario,
                training_dispersions(),
                flights,
                key,
                again=again,
                between=BETWEEN,
            )
        else:
            # A flight from a place on the way is half as long.
            count = flights + again // 2
            report(f"{name}: flying {count} flights")
            samples = fly_samples(
                scenario, state_training_dispersions(), count, key, on_curve=False
            )

        def told(line: str, name: str = name) -> None:
            report(f"{name}: {line}")

        told(f"{len(samples)} samples")
        for reason, left_out in samples.left_out.items():
            told(f"{left_out} samples left out: of flights that {reason}")
        trained = train_predictor(
            scenario,
            samples,
            purpose.inputs,
            key,
            iterations=iterations,
            report=told,
        )
        cards[name] = trained.card | {
            "purpose": purpose.sentence,
            "seed": seed,
            "command": f"jentry train cav-h --seed {seed} --flights {flights} "
            f"--again {again} --iterations {iterations}",
        }
        save_network(folder / f"{name}.npz", trained.predictor.network, cards[name])
    return cards
