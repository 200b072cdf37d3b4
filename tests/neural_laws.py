"""Small neural laws of the Mars lander, with random weights."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jentry.flight import FixedStep
from jentry.guidance import FixedCycle, NeuralLaw
from jentry.guidance.neural_law import INPUTS
from jentry.missions.mars.drag_tracking import entry, to_the_place
from jentry.motion import EntryDynamics
from jentry.onboard import OnboardModel, RecurrentNetwork


PERIOD = 4.0
SOLVER = FixedStep(2.0)


def network_of(seed=0, memory=3, hidden=(4,), size=1.0):
    """Random weights, normalised by samples about what occurs."""
    samples = {name: np.array([-2.0, 2.0]) for name in INPUTS}
    network = RecurrentNetwork.untrained(
        samples, memory, hidden, 1, jax.random.key(seed)
    )
    wide = jnp.asarray([[-100.0, 100.0]] * len(INPUTS))
    network = eqx.tree_at(lambda n: n.input_ranges, network, wide)
    last = lambda n: n.layers[-1].weight
    return eqx.tree_at(last, network, replace_fn=lambda w: size * w)


def law_of(network=None, **options):
    start = entry()
    return NeuralLaw(
        network=network_of() if network is None else network,
        model=OnboardModel(start.planet, start.vehicle),
        cycle=FixedCycle(PERIOD),
        **options,
    )


def scenario_of(law):
    start = dataclasses.replace(to_the_place(entry()), dynamics=EntryDynamics())
    return dataclasses.replace(start, guidance=law)
