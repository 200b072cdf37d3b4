"""Training of a network that predicts the velocity at the target, on flights of its own.

The data are flown by the simulator: from the entry, and again from places along those
flights with another curve, so that the network also knows what a re-planned flight meets.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Float, Key

from .._types import Scalar
from ..campaign.dispersions import Dispersion
from ..campaign.monte_carlo import Campaign, monte_carlo
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome
from ..guidance.anchoring import Shape, parameters_of
from ..guidance.bezier import Decision
from ..guidance.velocity_prediction import (
    FlownModel,
    Inputs,
    NetworkPredictor,
    Situation,
    features,
)
from ..motion.state import EntryState
from ..onboard.network import Network
from .velocity_planning import K1, K2, bezier_law


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
    between: tuple[float, float],
    solver: AbstractSolver = FixedStep(),
) -> Samples:
    """Fly the law without velocity control, dispersed, and sample the flights.

    **Arguments:**

    - `dispersions`: of what the network is to know, wider than it will meet; those of
      lift and drag as factors of the vehicle.
    - `flights`: from the entry.
    - `again`: from places along those, with the third control point moved at random.
    - `between`: velocities at the target (m/s) of the flights that count.
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
    both = jax.tree.map(lambda *parts: np.concatenate(parts), samples, more)
    final = both.final_velocity
    return both.of((final > between[0]) & (final < between[1]))


def _samples(scenario: Scenario, campaign: Campaign, before: int) -> Samples:
    """Of all flights that reached the target, at all times before."""
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None
    flight, place = _usable(scenario, campaign)
    states, decisions = jax.tree.map(
        lambda x: jnp.asarray(x[flight, place]), (history.states, history.decisions)
    )

    def situation(state: EntryState, decision: Decision) -> Situation:
        return law.situation(state, decision)

    situations = eqx.filter_jit(jax.vmap(situation))(states, decisions)
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
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None
    keys = jax.random.split(key, 2)
    flight, place = _usable(scenario, campaign)
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
    inputs |= {f"initial_state.{name}": v for name, v in vars(states).items()}
    inputs |= {K1: np.asarray(parameters.k1), K2: np.asarray(parameters.k2)}
    return {address: np.asarray(values) for address, values in inputs.items()}


def _usable(scenario: Scenario, campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Flight and place in the history of all that a network can learn from.

    Those of flights that kept to the curve. At a limit of the angle of attack they leave
    it, and their end is another function of where they began; the velocity is then far
    from that of the curve, from which holding the command through the guidance cycles
    takes it by 12 m/s at most.
    """
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None

    def on_curve(state: EntryState, decision: Decision) -> Scalar:
        return FlownModel().predict(law.glide, law.situation(state, decision))

    first = jax.tree.map(
        lambda x: jnp.asarray(x[:, 0]), (history.states, history.decisions)
    )
    predicted = np.asarray(eqx.filter_jit(jax.vmap(on_curve))(*first))
    reached = np.asarray(campaign.flights.outcome) == Outcome.REACHED
    final = np.asarray(campaign.flights.state.velocity)
    kept = reached & (np.abs(predicted - final) < _OFF_CURVE)
    usable = np.isfinite(np.asarray(history.time)) & kept[:, None]
    flight, place = np.nonzero(usable)
    return flight, place


_OFF_CURVE = 20.0
"""m/s"""


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
    warm_up: int = 3000,
    iterations: int = 5000,
    fitted: int = 20000,
    held_out: float = 0.1,
    report: Callable[[str], None] = lambda line: None,
) -> Trained:
    """Fit a network to samples: Adam to begin with, then L-BFGS on a part of them.

    The loss is the mean of sqrt(1 + e^2) - 1 for an error of e m/s: quadratic below 1 m/s
    and linear above, so that the few flights near a limit do not rule the others. One
    share of the flights, with all their samples, is held out and tells the error.

    **Arguments:**

    - `hidden`: neurons of the hidden layers.
    - `warm_up`: steps of Adam, on 2048 samples each.
    - `iterations`: of L-BFGS, on `fitted` samples. This is what the last digits take:
      Adam alone stays ten times as far off.
    - `held_out`: share of the flights.
    - `report`: is told how it goes.
    """
    began = time.perf_counter()
    glide = bezier_law(scenario).glide
    network_key, split_key, batch_key, fitted_key = jax.random.split(key, 4)
    flights = int(np.max(samples.flights)) + 1
    out = np.asarray(jax.random.uniform(split_key, (flights,))) < held_out
    out = out[samples.flights]
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
        np.asarray(read)[inside], outputs[inside], hidden, network_key
    )

    given = read, to_go, velocity, final

    def errors(network: Network, chosen: Array) -> Array:
        read, to_go, velocity, final = (jnp.asarray(x)[chosen] for x in given)
        return velocity * jnp.exp(-to_go * jax.vmap(network)(read)) - final

    def loss(layers: Layers, chosen: Array) -> Array:
        error = errors(_with_layers(network, layers), chosen)
        return jnp.mean(jnp.sqrt(1.0 + error * error) - 1.0)

    def told(step: str, value: Array) -> None:
        report(f"{step}: loss {float(value):.4f}")

    train = jnp.asarray(inside)
    layers = network.weights, network.biases
    layers, value = _adam(loss, layers, train, batch_key, warm_up)
    told(f"Adam, {warm_up} steps", value)
    part = jax.random.permutation(fitted_key, train)[:fitted]
    for done, moved, value in _lbfgs(lambda p: loss(p, part), layers, iterations):
        told(f"L-BFGS, {done} iterations", value)
        layers = moved
    network = _with_layers(network, layers)

    aside = jnp.asarray(np.flatnonzero(out))
    error = np.abs(np.asarray(eqx.filter_jit(errors)(network, aside)))
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
        "steps of Adam, iterations of L-BFGS": [warm_up, iterations],
        "training, s": round(time.perf_counter() - began, 1),
    }
    return Trained(NetworkPredictor(network, inputs), card)


Layers = tuple[tuple[Array, ...], tuple[Array, ...]]
"""Weights and biases of a network: what is trained of it"""


def _with_layers(network: Network, layers: Layers) -> Network:
    return eqx.tree_at(lambda n: (n.weights, n.biases), network, layers)


def _adam(
    loss: Callable[[Layers, Array], Array],
    layers: Layers,
    samples: Array,
    key: Key[Array, ""],
    steps: int,
) -> tuple[Layers, Array]:
    """After so many steps on random batches, and the mean loss over the last hundred."""
    optimizer = optax.adam(optax.cosine_decay_schedule(1e-2, steps))

    @jax.jit
    def run(layers, keys):
        def step(carry, key):
            layers, state = carry
            batch = samples[jax.random.randint(key, (2048,), 0, len(samples))]
            value, gradient = jax.value_and_grad(loss)(layers, batch)
            update, state = optimizer.update(gradient, state)
            return (optax.apply_updates(layers, update), state), value

        (layers, _), values = lax.scan(step, (layers, optimizer.init(layers)), keys)
        return layers, jnp.mean(values[-100:])

    return run(layers, jax.random.split(key, steps))


def _lbfgs(
    loss: Callable[[Layers], Array], layers: Layers, iterations: int
) -> Iterator[tuple[int, Layers, Array]]:
    """Iterations done, layers and loss, now and then."""
    optimizer = optax.lbfgs(memory_size=30)
    value_and_gradient = optax.value_and_grad_from_state(loss)

    @partial(jax.jit, static_argnums=2)
    def run(layers, state, count):
        def step(carry, _):
            layers, state = carry
            value, gradient = value_and_gradient(layers, state=state)
            update, state = optimizer.update(
                gradient, state, layers, value=value, grad=gradient, value_fn=loss
            )
            return (optax.apply_updates(layers, update), state), value

        (layers, state), values = lax.scan(step, (layers, state), None, length=count)
        return layers, state, jnp.asarray(values)[-1]

    state: Any = optimizer.init(layers)
    for begin in range(0, iterations, _REPORT_EVERY):
        count = min(_REPORT_EVERY, iterations - begin)
        layers, state, value = run(layers, state, count)
        yield begin + count, layers, value


_REPORT_EVERY = 500
