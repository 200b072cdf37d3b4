"""Trains a neural law from several seeds, and takes the best on flights of its own."""

import dataclasses
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .._setup import needs_float64
from ..campaign.campaign import drawn_inputs
from ..campaign.dispersions import key_of
from ..flight.scenario import Scenario
from ..onboard.recurrent_network import load_recurrent_network, save_recurrent_network
from ..tuning.batch_gradients import Simulation
from .law_training import NETWORK_FILE, LawTraining, train_law
from .neural_law import TrainedLaw, distances_of
from .training_record import PERCENTILES, HeldOut, Judged


@dataclasses.dataclass(frozen=True)
class SeedsOfLaw:
    """Laws that were trained alike from different seeds, and which of them is the best."""

    laws: dict[int, TrainedLaw]
    """Trained law of each seed"""
    choosing: dict[int, HeldOut]
    """Distances of each law on the flights that choose. All laws have the same draws"""
    best: int
    """Seed of the best law"""
    final: HeldOut
    """Distances of the best law on further flights, which have chosen nothing"""

    @property
    def scenario(self) -> Scenario:
        """The scenario with the best law."""
        return self.laws[self.best].scenario


@needs_float64
def train_law_of_seeds(
    training: LawTraining,
    seeds: Sequence[int],
    folder: Path | str,
    *,
    held_out: int = 2048,
    imitate: bool = False,
    card: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = lambda line: None,
    report: Callable[[LawTraining, Judged], None] = lambda training, judged: None,
) -> SeedsOfLaw:
    """Train a neural law from several seeds, and store the network of the best.

    Each seed has a folder of its own, such as `seed-3`, in which `train_law` stores its
    network, and from which the same call resumes with the same bits. The best law has the
    fewest flights without an end and, if equal, the smallest percentile `judged_by` of the
    distance. Its network is in the folder itself. Its model card has the distances of all
    seeds.

    The flights that choose the seed are not those that chose the weights. The best of many
    is a little better on the flights that chose it than on others: `SeedsOfLaw.final` is on
    further flights.

    **Arguments:**

    - `seeds`: seeds of weights and flights, each once.
    - `held_out`: number of flights that choose, and of further flights.
    - `imitate`, `card`, `say`, `report`: as for `train_law`.

    **Raises:** `ValueError` for no seeds, for a seed that is there twice, and as
    `train_law`.
    """
    seeds, folder = list(seeds), Path(folder)
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds is {seeds}: give at least one seed, and each once")
    if held_out < 1:
        raise ValueError(f"held_out is {held_out}: it must be at least 1")
    for seed in seeds:
        key_of(seed)
    laws: dict[int, TrainedLaw] = {}
    for seed in seeds:
        say(f"seed {seed}, in {folder_of(folder, seed)}")
        laws[seed] = train_law(
            training,
            seed,
            folder_of(folder, seed),
            imitate=imitate,
            card=card,
            say=say,
            report=report,
        )
    choosing = {
        seed: _flown(training, law.scenario, "choice of a seed", held_out)
        for seed, law in laws.items()
    }
    best = best_seed(choosing, training.judged_by)
    final = _flown(training, laws[best].scenario, "after the choice", held_out)
    network, about = load_recurrent_network(folder_of(folder, best) / NETWORK_FILE)
    about |= dict(card or {})
    about |= {
        "chosen from seeds": {str(seed): _shown(x) for seed, x in choosing.items()},
        "chosen by": f"{training.judged_by:g} %",
        "held out flights without an end": final.without_end,
        "held out distance": _shown(final),
    }
    save_recurrent_network(folder / NETWORK_FILE, network, about)
    return SeedsOfLaw(laws, choosing, best, final)


def folder_of(folder: Path, seed: int) -> Path:
    """Folder of the training of a seed."""
    return folder / f"seed-{seed}"


def best_seed(choosing: Mapping[int, HeldOut], percentile: float) -> int:
    """The seed with the fewest flights without an end, and then the smallest percentile of
    the distance; the first one of equals."""
    place = PERCENTILES.index(percentile)

    def order(seed: int) -> tuple[int, float]:
        held_out = choosing[seed]
        return held_out.without_end, held_out.distances[place]

    return min(choosing, key=order)


def _shown(held_out: HeldOut) -> dict[str, float]:
    return {f"{p:g} %": d for p, d in zip(PERCENTILES, held_out.distances, strict=True)}


def _flown(
    training: LawTraining, scenario: Scenario, purpose: str, flights: int
) -> HeldOut:
    """Distances of flights whose draws depend on their purpose alone, and on no seed."""
    key = jax.random.fold_in(key_of(0), zlib.crc32(purpose.encode()))
    runs = np.arange(flights)
    inputs = drawn_inputs(scenario, training.dispersions, key, runs)
    simulation = Simulation(training.residuals, training.solver, training.history)
    return distances_of(scenario, simulation, inputs)
