"""Training of the networks of the CAV-H mission."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from ...flight.scenario import Scenario
from ...guidance.bezier.prediction import Inputs
from ...learning.velocity_network import train_predictor
from ...learning.velocity_samples import fly_samples
from ...onboard.network import save_network
from .dispersions import state_training_dispersions, training_dispersions
from .stored_networks import PURPOSES


BETWEEN = 1600.0, 3600.0
"""Range of the velocity at the target, m/s, of flights that train the networks with
factors. Equation (38) needs a prediction before the first adjustment: 8000 dispersed
vehicles then end between 1860 and 3364 m/s on the stored curve, and down to 1776 m/s on a
subdivided one."""


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
    """Fly the data, train all networks and store them; returns the model cards by name.

    **Arguments:**

    - `scenarios`: scenarios with the law of each network, by the names of `PURPOSES`.
    - `flights`, `again`: those of `fly_samples`, for each network with the curve as input.
      The other networks use as much data, all from the entry with the nominal curve. None
      of these flights that reaches the target is left out: the error of these networks
      shall include the effect of what they do not know.
    - `iterations`: number of iterations of L-BFGS for each network.
    - `report`: function that receives lines of progress.
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
            # A flight from a place along the nominal flight is half as long.
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
