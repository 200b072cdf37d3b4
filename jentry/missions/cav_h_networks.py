"""The networks of the CAV-H mission: what they are for, and how they are trained."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax

from ..design.network_training import fly_samples, train_predictor
from ..flight.scenario import Scenario
from ..guidance.velocity_prediction import Inputs, NetworkPredictor
from ..onboard.network import load_network, save_network
from .cav_h_dispersions import training_dispersions


FOLDER = Path(__file__).parent / "networks"
"""Of the weights that come with the package"""

BETWEEN = 2350.0, 2900.0
"""m/s at the target: what the flights end between that the networks learn from"""


class Purpose(NamedTuple):
    """One network."""

    anchoring: str
    inputs: Inputs

    @property
    def sentence(self) -> str:
        """As in its model card."""
        return (
            f"CAV-H velocity at the target from {self.inputs.value}, {self.anchoring}"
        )


PURPOSES = {
    "stored": Purpose("stored k1 and k2", Inputs.ALL),
    "subdivision": Purpose("subdivided curve", Inputs.ALL),
    "state-only": Purpose("stored k1 and k2", Inputs.STATE),
}
"""By the name of the file. The last one is the paper's, for comparison."""


@functools.cache
def network_predictor(name: str, folder: Path = FOLDER) -> NetworkPredictor:
    """A stored network as a predictor.

    Raises `ValueError` for a file that is damaged or of another network.
    """
    network, _ = load_network(folder / f"{name}.npz", PURPOSES[name].sentence)
    return NetworkPredictor(network, PURPOSES[name].inputs)


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
    - `flights`, `again`: as of `fly_samples`, for each law.
    - `iterations`: of L-BFGS, for each network.
    - `report`: is told what is done.
    """
    cards = {}
    samples = {}
    for number, (name, purpose) in enumerate(PURPOSES.items()):
        scenario = scenarios[name]
        key = jax.random.fold_in(jax.random.key(seed), number)
        if purpose.anchoring not in samples:
            report(f"{name}: flying {flights} + {again} flights")
            samples[purpose.anchoring] = fly_samples(
                scenario,
                training_dispersions(),
                flights,
                key,
                again=again,
                between=BETWEEN,
            )

        def told(line: str, name: str = name) -> None:
            report(f"{name}: {line}")

        trained = train_predictor(
            scenario,
            samples[purpose.anchoring],
            purpose.inputs,
            key,
            iterations=iterations if purpose.inputs is Inputs.ALL else 500,
            report=told,
        )
        cards[name] = trained.card | {
            "purpose": purpose.sentence,
            "velocity at the target, m/s": list(BETWEEN),
            "seed": seed,
            "command": f"jentry train cav-h --seed {seed} --flights {flights} "
            f"--again {again} --iterations {iterations}",
        }
        save_network(folder / f"{name}.npz", trained.predictor.network, cards[name])
    return cards
