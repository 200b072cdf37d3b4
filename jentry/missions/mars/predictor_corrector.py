"""Mars lander, numerical predictor-corrector, in the plane and in three dimensions.

The entry, the target and the dispersions of `drag_tracking`. What is chosen says so.
"""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ...flight.scenario import Scenario
from ...guidance.bank_shapes import ConstantBankShape
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import AbstractLateralLogic, FixedSide, PredictedCrossrange
from ...guidance.predictor_corrector import PredictorCorrector
from ...guidance.range_network import BASIS, PURPOSE, RangeNetwork
from ...motion.dynamics import AbstractDynamics, EntryDynamics, EquatorialDynamics
from ...onboard.model import OnboardModel
from ...onboard.network import load_network, save_network
from ...units import km
from .drag_tracking import entry, independent


FOLDER = Path(__file__).parent / "networks"
"""Folder of the weights that come with the package"""

_FILE = "range.npz"


def _guided(dynamics: AbstractDynamics, lateral: AbstractLateralLogic) -> Scenario:
    start = entry()
    target = start.target
    law = PredictorCorrector(
        model=OnboardModel(start.planet, start.vehicle),
        shape=ConstantBankShape(),
        end=GuidedEnd(target.velocity, target.altitude, ceiling=135.0 * km),
        origin=start.initial_state,
        downrange=target.downrange,
        crossrange=target.crossrange,
        altitude=target.altitude,
        lateral=lateral,
        in_space=dynamics.has_crossrange,
    )
    guided = eqx.tree_at(lambda s: s.guidance, start, law)
    return dataclasses.replace(guided, dynamics=dynamics)


def in_plane() -> Scenario:
    """A constant bank to the end, corrected every 2 s, in the vertical plane."""
    return _guided(EquatorialDynamics(), FixedSide())


@functools.cache
def range_network(folder: Path = FOLDER) -> RangeNetwork:
    """The stored network of `networked`. Raises `ValueError` for another one."""
    network, card = load_network(folder / _FILE, PURPOSE)
    told = card.get("of")
    if not isinstance(told, dict) or set(told) != set(BASIS):
        raise ValueError(
            f"{folder / _FILE} does not say what it is of ({', '.join(BASIS)}): train it "
            "again with `jentry train mars-range-tracking`"
        )
    return RangeNetwork(network, jnp.array([float(told[name]) for name in BASIS]))


def networked() -> Scenario:
    """As `in_plane`, with a network in place of the prediction."""
    return eqx.tree_at(
        lambda s: s.guidance.network,
        in_plane(),
        range_network(),
        is_leaf=lambda x: x is None,
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
    """Fly the data, train the network of `networked` and store it; gives its card by name.

    **Arguments:**

    - `flights`, `again`: as of `predict_samples`.
    - `iterations`: of L-BFGS.
    - `report`: is told what is done.
    """
    # optax takes a while
    from ...learning.range_network import predict_samples, train_range_network

    flights_key, key = jax.random.split(jax.random.key(seed))
    scenario = in_plane()
    report(f"{flights} flights and {again} predictions")
    samples = predict_samples(scenario, independent(), flights, again, flights_key)
    trained = train_range_network(
        scenario, samples, key, iterations=iterations, report=report
    )
    card = trained.card | {
        "seed": seed,
        "command": f"jentry train mars-range-tracking --seed {seed} --flights {flights} "
        f"--again {again} --iterations {iterations}",
    }
    save_network(folder / _FILE, trained.network.network, card)
    return {"range": card}


def three_dimensional() -> Scenario:
    """The same in three dimensions, with reversals as predicted."""
    return _guided(EntryDynamics(), PredictedCrossrange())
