"""Training of a network that predicts the velocity at the target, on flown samples."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Key

from ..flight.scenario import Scenario
from ..guidance.bezier.prediction import Inputs, NetworkPredictor, Situation, features
from ..onboard.network import Network
from ..planning.bezier_curve import bezier_law
from .velocity_samples import Samples


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
    share of the vehicles, with all their samples, is held out and tells the error.

    **Arguments:**

    - `hidden`: neurons of the hidden layers.
    - `warm_up`: steps of Adam, on 2048 samples each.
    - `iterations`: of L-BFGS, on `fitted` samples. This is what the last digits take:
      Adam alone stays ten times as far off.
    - `held_out`: share of the vehicles.
    - `report`: is told how it goes.
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

    def loss(layers: Layers, chosen: Array) -> Array:
        error = errors(_with_layers(network, layers), chosen)
        return jnp.mean(jnp.sqrt(1.0 + error * error) - 1.0)

    def told(step: str, value: Array) -> None:
        report(f"{step}: loss {float(value):.4f}")

    train = jnp.asarray(inside)
    part = jax.random.permutation(fitted_key, train)[:fitted]
    layers = network.weights, network.biases
    for name, optimizer, batch, steps in (
        (
            "Adam",
            optax.adam(optax.cosine_decay_schedule(1e-2, warm_up)),
            lambda key: train[jax.random.randint(key, (2048,), 0, len(train))],
            warm_up,
        ),
        ("L-BFGS", optax.lbfgs(memory_size=30), lambda key: part, iterations),
    ):
        keys = jax.random.split(batch_key, steps)
        for done, moved, value in _descended(optimizer, loss, batch, layers, keys):
            told(f"{name}, {done} steps", value)
            layers = moved
    network = _with_layers(network, layers)

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


VELOCITIES = "velocity at the target, m/s"
"""Of a model card: smallest and largest in training"""

Layers = tuple[tuple[Array, ...], tuple[Array, ...]]
"""Weights and biases of a network: what is trained of it"""


def _with_layers(network: Network, layers: Layers) -> Network:
    return eqx.tree_at(lambda n: (n.weights, n.biases), network, layers)


def _descended(
    optimizer: optax.GradientTransformation,
    loss: Callable[[Layers, Array], Array],
    batch: Callable[[Key[Array, ""]], Array],
    layers: Layers,
    keys: Key[Array, " steps"],
) -> Iterator[tuple[int, Layers, Array]]:
    """Steps done, layers, and mean loss over the last hundred of them, now and then.

    Each step is on the samples that `batch` makes of its key.
    """

    optimizer = optax.with_extra_args_support(optimizer)

    @jax.jit
    def run(layers, state, keys):
        def step(carry, key):
            layers, state = carry
            chosen = batch(key)
            here = lambda layers: loss(layers, chosen)
            value, gradient = _value_and_gradient(here, layers, state)
            update, state = optimizer.update(
                gradient, state, layers, value=value, grad=gradient, value_fn=here
            )
            return (optax.apply_updates(layers, update), state), value

        (layers, state), values = lax.scan(step, (layers, state), keys)
        return layers, state, jnp.mean(values[-100:])

    state: Any = optimizer.init(layers)
    for begin in range(0, len(keys), _REPORT_EVERY):
        some = keys[begin : begin + _REPORT_EVERY]
        layers, state, value = run(layers, state, some)
        yield begin + len(some), layers, value


def _value_and_gradient(loss, layers: Layers, state: Any) -> tuple[Array, Any]:
    """As the line search has left them in the state, if the optimizer has one."""
    if optax.tree.get(state, "value") is None:
        return jax.value_and_grad(loss)(layers)
    value, gradient = optax.value_and_grad_from_state(loss)(layers, state=state)
    return jnp.asarray(value), gradient


_REPORT_EVERY = 500
