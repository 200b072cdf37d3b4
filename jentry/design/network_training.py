"""Training of a network that predicts the velocity at the target, on flights of its own.

The data are flown by the simulator: from the entry, and again from places along those
flights with another curve, so that the network also knows what a re-planned flight meets.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Key

from .._addresses import leaves_by_address
from ..campaign.dispersions import Dispersion
from ..campaign.monte_carlo import Campaign, monte_carlo
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..flight.termination import Outcome
from ..guidance.anchoring import Shape, parameters_of
from ..guidance.bezier import BezierGuidance
from ..guidance.velocity_prediction import (
    Inputs,
    NetworkPredictor,
    Situation,
    features,
)
from ..onboard.network import Network


INTERVAL = 20.0
"""s between the samples of a flight"""


class Samples(eqx.Module):
    """Situations on the way, and how the flights ended; every array has them in front."""

    situations: Situation
    final_velocity: Float[np.ndarray, " n"]
    """m/s"""
    flights: np.ndarray
    """Number of the flight that each is of"""

    def __len__(self) -> int:
        return len(self.flights)

    def of(self, chosen: np.ndarray) -> "Samples":
        """Some of them, by index or by a mask."""
        return jax.tree.map(lambda x: np.asarray(x)[chosen], self)


def fly_samples(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    flights: int,
    key: Key[Array, ""],
    *,
    again: int,
    solver: AbstractSolver,
) -> Samples:
    """Fly the law without velocity control, dispersed, and sample the flights.

    **Arguments:**

    - `dispersions`: of what the network is to know, wider than it will meet; those of
      lift and drag as factors of the vehicle.
    - `flights`: from the entry.
    - `again`: from places along those, with the curve and the place moved at random.
    - `solver`: as for `fly`.
    """
    first_key, second_key = jax.random.split(key)
    first = monte_carlo(
        scenario, dispersions, first_key, flights, solver=solver, history=INTERVAL
    )
    samples = _samples(scenario, first, 0)
    inputs = _moved_inputs(scenario, first, samples, again, second_key)
    second = monte_carlo(scenario, inputs=inputs, solver=solver, history=INTERVAL)
    more = _samples(scenario, second, flights)
    return jax.tree.map(lambda *parts: np.concatenate(parts), samples, more)


def _law(scenario: Scenario) -> BezierGuidance:
    law = scenario.guidance
    if not isinstance(law, BezierGuidance):
        raise ValueError(
            f"the network predicts for BezierGuidance: this is {type(law).__name__}"
        )
    return law


def _samples(scenario: Scenario, campaign: Campaign, before: int) -> Samples:
    """Of all flights that reached the target, at all times before."""
    law = _law(scenario)
    history = campaign.flights.history
    assert history is not None
    flight, place = _usable(law, campaign)
    states, decisions = jax.tree.map(
        lambda x: jnp.asarray(x[flight, place]), (history.states, history.decisions)
    )
    situations = eqx.filter_jit(jax.vmap(law.situation))(states, decisions)
    final = np.asarray(campaign.flights.state.velocity)[flight]
    situations = jax.tree.map(np.asarray, situations)
    return Samples(situations, final, before + flight)


def _moved_inputs(
    scenario: Scenario,
    campaign: Campaign,
    samples: Samples,
    count: int,
    key: Key[Array, ""],
) -> dict[str, np.ndarray]:
    """Starts on the way of flights, with another third control point, by address."""
    law = _law(scenario)
    history = campaign.flights.history
    assert history is not None
    keys = jax.random.split(key, 2)
    flight, place = _usable(law, campaign)
    chosen = np.asarray(jax.random.choice(keys[0], len(samples), (count,)))
    situations = jax.tree.map(jnp.asarray, samples.of(chosen).situations)
    share = jax.random.uniform(keys[1], (count,), minval=-1.0, maxval=1.0, dtype=float)

    def moved(situation: Situation, share: Array):
        lower, upper = law.anchoring.bounds(situation.point, situation.target)
        second = situation.shape.second + 0.2 * share * (upper - lower)
        shape = Shape(situation.shape.first, jnp.clip(second, lower, upper))
        return parameters_of(law.anchoring, shape, situation.point, situation.target)

    parameters = eqx.filter_jit(jax.vmap(moved))(situations, share)
    states = jax.tree.map(
        lambda x: np.asarray(x)[flight[chosen], place[chosen]], history.states
    )
    inputs = {a: np.asarray(v)[flight[chosen]] for a, v in campaign.inputs.items()}
    inputs |= {f"initial_state.{a}": v for a, v in leaves_by_address(states).items()}
    for name in ("k1", "k2"):
        inputs[f"guidance.parameters.{name}"] = np.asarray(getattr(parameters, name))
    return {address: np.asarray(values) for address, values in inputs.items()}


def _usable(law: BezierGuidance, campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Flight and place in the history of all that a network can learn from.

    Those of flights that reached the target with the angle of attack within its limits:
    one that saturates leaves the curve, and its end is another function.
    """
    history = campaign.flights.history
    assert history is not None
    reached = np.asarray(campaign.flights.outcome) == Outcome.REACHED
    followed = np.asarray(campaign.misses.distance) < 0.01
    return np.nonzero(np.isfinite(np.asarray(history.time)) & (reached & followed)[:, None])


class Trained(eqx.Module):
    """A network, and how well it predicts flights that it was not trained on."""

    predictor: NetworkPredictor
    card: dict[str, Any] = eqx.field(static=True)


def train_predictor(
    scenario: Scenario,
    samples: Samples,
    inputs: Inputs,
    key: Key[Array, ""],
    *,
    hidden: tuple[int, ...] = (24, 24),
    steps: int = 6000,
    batch: int = 2048,
    learning_rate: float = 1e-2,
    held_out: float = 0.1,
    report: Callable[[int, float], None] = lambda step, error: None,
) -> Trained:
    """Fit a network to samples by Adam with a falling learning rate.

    The loss is the mean square of the velocity error. One share of the flights, with all
    their samples, is held out and tells the error.

    **Arguments:**

    - `hidden`: neurons of the hidden layers.
    - `report`: is told the step and the root of the mean loss, m/s, now and then.
    """
    began = time.perf_counter()
    glide = _law(scenario).glide
    network_key, split_key, batch_key = jax.random.split(key, 3)
    last = np.max(samples.flights) + 1
    out = np.asarray(jax.random.uniform(split_key, (int(last),))) < held_out
    out = out[samples.flights]

    @eqx.filter_jit
    def prepared(situations: Situation):
        read = jax.vmap(lambda s: features(glide, s, inputs))(situations)
        to_go = situations.target.along - situations.point.along
        return read, to_go, situations.velocity

    situations = jax.tree.map(jnp.asarray, samples.situations)
    read, to_go, velocity = prepared(situations)
    final = jnp.asarray(samples.final_velocity)
    rate = jnp.log(velocity / final) / to_go
    inside = np.flatnonzero(~out)
    network = Network.untrained(
        np.asarray(read)[inside], np.asarray(rate)[inside], hidden, network_key
    )

    def errors(network: Network, chosen):
        predicted = velocity[chosen] * jnp.exp(
            -to_go[chosen] * jax.vmap(network)(read[chosen])
        )
        return predicted - final[chosen]

    layers = lambda n: (n.weights, n.biases)
    optimizer = optax.adam(optax.cosine_decay_schedule(learning_rate, steps))

    @eqx.filter_jit
    def descend(network, state, keys):
        def step(carry, key):
            network, state = carry
            places = jax.random.randint(key, (batch,), 0, len(inside))

            def loss(trained):
                moved = eqx.tree_at(layers, network, trained)
                return jnp.mean(errors(moved, train[places]) ** 2)

            value, gradient = jax.value_and_grad(loss)(layers(network))
            update, state = optimizer.update(gradient, state)
            moved = optax.apply_updates(layers(network), update)
            return (eqx.tree_at(layers, network, moved), state), value

        (network, state), values = jax.lax.scan(step, (network, state), keys)
        return network, state, jnp.sqrt(jnp.mean(values))

    train = jnp.asarray(inside)
    state = optimizer.init(layers(network))
    for begin in range(0, steps, _REPORT_EVERY):
        count = min(_REPORT_EVERY, steps - begin)
        keys = jax.random.split(jax.random.fold_in(batch_key, begin), count)
        network, state, error = descend(network, state, keys)
        report(begin + count, float(error))

    error = np.abs(np.asarray(eqx.filter_jit(errors)(network, jnp.asarray(np.flatnonzero(out)))))
    held = samples.of(out)
    at_start = np.asarray(to_go)[out] > 0.97 * float(jnp.max(to_go))
    ranges = {
        name: [float(x) for x in (values.min(), values.max())]
        for name, values in zip(inputs.names, np.asarray(read)[inside].T, strict=True)
    }
    card = {
        "purpose": f"final velocity from {inputs.value}",
        "anchoring": type(glide.anchoring).__name__,
        "inputs": ranges,
        "output": "ln(v / v_f) / X: velocity v, velocity at the target v_f, "
        "angle to go X in rad",
        "hidden": list(hidden),
        "samples": len(samples) - len(held),
        "flights": int(len(np.unique(samples.flights))),
        "held out samples": len(held),
        "held out mean error, m/s": float(error.mean()),
        "held out 95 % error, m/s": float(np.percentile(error, 95)),
        "held out mean error at the start, m/s": float(error[at_start].mean()),
        "steps": steps,
        "training, s": round(time.perf_counter() - began, 1),
    }
    return Trained(NetworkPredictor(network, inputs), card)


_REPORT_EVERY = 500
