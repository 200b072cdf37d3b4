"""Trains a network that predicts the velocity at the target, on samples of flights."""

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from ..flight.scenario import Scenario
from ..guidance.bezier.prediction import (
    VELOCITIES,
    Inputs,
    NetworkPredictor,
    Situation,
    features,
)
from ..onboard.network import Network
from ..planning.bezier_curve import bezier_law
from .descent import descended, robust
from .velocity_samples import Samples


class Trained(eqx.Module):
    """A trained network, with its errors on held-out vehicles."""

    predictor: NetworkPredictor
    card: dict[str, Any] = eqx.field(static=True)


def train_predictor(
    scenario: Scenario,
    samples: Samples,
    inputs: Inputs,
    key: Key[Array, ""],
    *,
    hidden: tuple[int, ...] = (24, 24),
    warm_up: int = 3000,
    iterations: int = 5000,
    fitted: int = 20000,
    held_out: float = 0.1,
    report: Callable[[str], None] = lambda line: None,
) -> Trained:
    """Fit a network to samples with Adam, and then with L-BFGS on a part of them.

    The loss is `robust` of the error in m/s. A share of the vehicles, with all their
    samples, is held out to measure the error.

    **Arguments:**

    - `hidden`: number of neurons in each hidden layer.
    - `warm_up`: number of steps of Adam, with 2048 samples each.
    - `iterations`: number of iterations of L-BFGS, with `fitted` samples.
    - `held_out`: share of the vehicles that is held out.
    - `report`: function that is called with lines of text on the progress.
    """
    began = time.perf_counter()
    glide = bezier_law(scenario).glide(scenario.constraints)
    network_key, split_key, batch_key, fitted_key = jax.random.split(key, 4)
    vehicles = int(np.max(samples.vehicles)) + 1
    out = np.asarray(jax.random.uniform(split_key, (vehicles,))) < held_out
    out = out[samples.vehicles]
    inside = np.flatnonzero(~out)

    @eqx.filter_jit
    def prepared(situations: Situation):
        read = jax.vmap(lambda s: features(glide, s, inputs))(situations)
        to_go = situations.target.along - situations.point.along
        return read, to_go, situations.velocity

    read, to_go, velocity = prepared(jax.tree.map(jnp.asarray, samples.situations))
    final = jnp.asarray(samples.final_velocity)
    outputs = np.asarray(jnp.log(velocity / final) / to_go)
    network = Network.untrained(
        inputs.names, np.asarray(read)[inside], outputs[inside], hidden, network_key
    )

    given = read, to_go, velocity, final

    def errors(network: Network, chosen: Array) -> Array:
        read, to_go, velocity, final = (jnp.asarray(x)[chosen] for x in given)
        return velocity * jnp.exp(-to_go * jax.vmap(network)(read)) - final

    def loss(network: Network, chosen: Array) -> Array:
        return robust(errors(network, chosen))

    network = descended(
        network,
        loss,
        jnp.asarray(inside),
        batch_key,
        fitted_key,
        warm_up=warm_up,
        iterations=iterations,
        part=fitted,
        report=report,
    )

    slowest, fastest = (f(samples.final_velocity[inside]) for f in (np.min, np.max))
    predictor = NetworkPredictor(network, jnp.stack([slowest, fastest]), inputs)
    held = samples.of(out)

    @eqx.filter_jit
    def predicted(situations: Situation):
        return jax.vmap(lambda s: predictor.predict(glide, s))(situations)

    answers = predicted(jax.tree.map(jnp.asarray, held.situations))
    error = np.abs(np.asarray(answers) - held.final_velocity)
    answered = np.isfinite(error)
    entry = held.at_entry & answered
    at_entry = held.final_velocity[entry]
    card = {
        "purpose": f"final velocity from {inputs.value}",
        "anchoring": type(glide.anchoring).__name__,
        "output": "ln(v / v_f) / X: velocity v, velocity at the target v_f, "
        "angle to go X in rad",
        VELOCITIES: [float(slowest), float(fastest)],
        "samples": len(samples) - len(held),
        "flights": int(len(np.unique(samples.flights))),
        "left out": samples.left_out,
        "held out samples": len(held),
        "held out samples outside of the ranges": int(np.sum(~answered)),
        "held out mean error, m/s": float(error[answered].mean()),
        "held out 95 % error, m/s": float(np.percentile(error[answered], 95)),
        "held out samples at the entry": int(entry.sum()),
        "held out mean error at the entry, m/s": float(error[entry].mean()),
        "mean deviation at the entry from the median, m/s": float(
            np.abs(at_entry - np.median(at_entry)).mean()
        ),
        "steps of Adam, iterations of L-BFGS": [warm_up, iterations],
        "training, s": round(time.perf_counter() - began, 1),
    }
    return Trained(predictor, card)
