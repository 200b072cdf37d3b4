"""How the networks of the CAV-H mission are trained."""

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
"""m/s at the target, with which the flights end that the networks with factors learn from.
Equation (38) asks before anything is adjusted: 8000 dispersed vehicles then end
between 1860 and 3364 m/s on the stored curve, and as slow as 1776 on a subdivided one."""


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
