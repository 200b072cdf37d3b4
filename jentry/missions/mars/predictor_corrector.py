"""Mars lander, numerical predictor-corrector, in the plane and in three dimensions.

Entry, target and dispersions are those of `drag_tracking`. Choices of our own are marked.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._computed_once import computed_once
from ...fields import Vector
from ...flight.scenario import Scenario
from ...guidance.bank_shapes import ConstantBankShape
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import PredictedCrossrange
from ...guidance.predictor_corrector import PredictorCorrector
from ...guidance.range_network import ACROSS, AHEAD, BASIS, PURPOSE, RangeNetwork
from ...motion.dynamics import EntryDynamics
from ...onboard.model import OnboardModel
from ...onboard.network import Network, load_network, save_network
from ...units import km
from .drag_tracking import entry, independent, to_the_place


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

_RANGE, _AHEAD, _ACROSS = "range", "ahead", "across"
"""Names of the files of the networks: one for the plane, and two for three dimensions"""


def guided() -> Scenario:
    """A constant bank to the end, corrected every 2 s by predictions of the flight.

    The prediction also determines the bank reversals."""
    start = entry()
    target = start.place
    law = PredictorCorrector(
        model=OnboardModel(start.planet, start.vehicle),
        shape=ConstantBankShape(),
        end=GuidedEnd(target.velocity, target.altitude, ceiling=135.0 * km),
        lateral=PredictedCrossrange(),
        in_space=True,
    )
    guided = eqx.tree_at(lambda s: s.guidance, to_the_place(start), law)
    return dataclasses.replace(guided, dynamics=EntryDynamics())


@computed_once
def range_network(folder: Path = FOLDER) -> RangeNetwork:
    """The stored network for flights in the vertical plane.

    Raises `ValueError` for a file with another network.
    """
    return RangeNetwork(*_stored(folder, _RANGE, PURPOSE))


@computed_once
def range_network_in_space(folder: Path = FOLDER) -> RangeNetwork:
    """The stored networks for flights in three dimensions.

    Raises `ValueError` for files with other networks, and for two networks that have not
    been trained for one model and one end.
    """
    ahead, of = _stored(folder, _AHEAD, AHEAD)
    across, of_across = _stored(folder, _ACROSS, ACROSS)
    both = zip(BASIS, np.asarray(of), np.asarray(of_across), strict=True)
    unlike = [f"{name} {a:.9g} and {b:.9g}" for name, a, b in both if a != b]
    if unlike:
        raise ValueError(
            f"{_AHEAD}.npz and {_ACROSS}.npz of {folder} are for different predictions: "
            f"{', '.join(unlike)}; train both again with `jentry train "
            "mars-range-tracking`"
        )
    return RangeNetwork(ahead, of, across)


def _stored(folder: Path, name: str, purpose: str) -> tuple[Network, Vector]:
    """A stored network, and the model and end for which it has been trained."""
    path = folder / f"{name}.npz"
    network, card = load_network(path, purpose)
    told = card.get("of")
    if not isinstance(told, dict) or set(told) != set(BASIS):
        raise ValueError(
            f"{path} does not state what it is for ({', '.join(BASIS)}): train it "
            "again with `jentry train mars-range-tracking`"
        )
    return network, jnp.array([float(told[name]) for name in BASIS])


def networked() -> Scenario:
    """The law `predictor-corrector` with networks in place of the predictions.

    They also replace the prediction for the bank reversals."""
    return _asking(guided(), range_network_in_space())


def _asking(scenario: Scenario, network: RangeNetwork) -> Scenario:
    return eqx.tree_at(
        lambda s: s.guidance.network, scenario, network, is_leaf=lambda x: x is None
    )


def train(
    folder: Path,
    seed: int,
    *,
    flights: int = 2000,
    again: int = 10000,
    iterations: int = 5000,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, dict[str, Any]]:
    """Fly the data, and train and store the networks; returns their model cards by name.

    The networks are those for flights in the plane and in three dimensions.

    **Arguments:**

    - `flights`, `again`: those of `predict_samples`, for the plane and for three
      dimensions.
    - `iterations`: number of iterations of L-BFGS.
    - `report`: function that receives lines of progress.
    """
    # optax takes a while
    from ...learning.range_network import predict_samples, train_range_network

    flights_key, key = jax.random.split(jax.random.key(seed))
    made = {
        "seed": seed,
        "command": f"jentry train mars-range-tracking --seed {seed} --flights {flights} "
        f"--again {again} --iterations {iterations}",
    }
    cards = {}
    from .range_tracking import in_plane

    for scenario in (in_plane(guided()), guided()):
        in_space = scenario.dynamics.has_crossrange
        where = "three dimensions" if in_space else "the plane"
        report(f"{flights} flights and {again} predictions in {where}")
        samples = predict_samples(scenario, independent(), flights, again, flights_key)
        trained = train_range_network(
            scenario, samples, key, iterations=iterations, report=report
        )
        for name, card in trained.cards.items():
            network = trained.networks[name]
            cards[name] = card | made
            save_network(folder / f"{name}.npz", network, cards[name])
    return cards
