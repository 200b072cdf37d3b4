"""Training of a network that predicts the velocity at the target, on flights of its own.

The data are flown by the simulator: from the entry, and again from places along those
flights with another curve, so that the network also knows what a re-planned flight meets.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

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
    vehicles: np.ndarray
    """Number of the vehicle that flies: the same where one flies again"""
    at_entry: np.ndarray
    """Whether it is where the vehicle entered"""
    left_out: dict[str, int] = eqx.field(static=True)
    """Flown samples that are not among these, by the reason"""

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
    again: int = 0,
    between: tuple[float, float] | None = None,
    on_curve: bool = True,
    solver: AbstractSolver = FixedStep(),
) -> Samples:
    """Fly the law without velocity control, dispersed, and sample the flights.

    **Arguments:**

    - `dispersions`: of what the network is to know, wider than it will meet; those of
      lift and drag as factors of the vehicle.
    - `flights`: from the entry.
    - `again`: from places along those, with the third control point moved at random.
    - `between`: velocities at the target (m/s) of the flights that count; all if not
      given.
    - `on_curve`: leave out the flights that did not keep to the curve. At a limit of the
      angle of attack they leave it, and their end is another function of where they
      began: their velocity is then far from that of the curve, from which holding the
      command through the guidance cycles takes it by 12 m/s at most.
    - `solver`: as for `fly`.
    """
    first_key, second_key = jax.random.split(key)
    first = monte_carlo(
        scenario, dispersions, first_key, flights, solver=solver, history=INTERVAL
    )
    flown = _flown(scenario, first, on_curve)
    samples = _samples(scenario, first, flown, np.arange(flights), 0)
    left_out = flown.left_out
    if again:
        keys = jax.random.split(second_key)
        chosen = jax.random.choice(keys[0], len(samples), (again,))
        chosen = np.asarray(chosen)
        inputs = _moved_inputs(scenario, first, flown, samples, chosen, keys[1])
        second = monte_carlo(scenario, inputs=inputs, solver=solver, history=INTERVAL)
        flown = _flown(scenario, second, on_curve)
        more = _samples(scenario, second, flown, samples.vehicles[chosen], flights)
        samples = jax.tree.map(lambda *parts: np.concatenate(parts), samples, more)
        left_out = {
            reason: n + flown.left_out[reason] for reason, n in left_out.items()
        }
    if between is not None:
        final = samples.final_velocity
        inside = (final > between[0]) & (final < between[1])
        reason = f"end outside of {between[0]:g} to {between[1]:g} m/s"
        left_out = left_out | {reason: int(np.sum(~inside))}
        samples = samples.of(inside)
    return dataclasses.replace(samples, left_out=left_out)


class _Flown(NamedTuple):
    """Where in the history of a campaign there is something to learn from."""

    flight: np.ndarray
    place: np.ndarray
    left_out: dict[str, int]


def _flown(scenario: Scenario, campaign: Campaign, on_curve: bool) -> _Flown:
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None

    def expected(state: EntryState, decision: Decision) -> Scalar:
        return FlownModel().predict(law.glide, law.situation(state, decision))

    there = np.isfinite(np.asarray(history.time))
    kept = np.asarray(campaign.flights.outcome) == Outcome.REACHED
    left_out = {"do not reach the target": int(there[~kept].sum())}
    if on_curve:
        first = jax.tree.map(
            lambda x: jnp.asarray(x[:, 0]), (history.states, history.decisions)
        )
        predicted = np.asarray(eqx.filter_jit(jax.vmap(expected))(*first))
        final = np.asarray(campaign.flights.state.velocity)
        off = kept & ~(np.abs(predicted - final) < _OFF_CURVE)
        reason = "leave the curve at a limit of the angle of attack"
        left_out[reason] = int(there[off].sum())
        kept = kept & ~off
    return _Flown(*np.nonzero(there & kept[:, None]), left_out)


def _samples(
    scenario: Scenario,
    campaign: Campaign,
    flown: _Flown,
    vehicles: np.ndarray,
    before: int,
) -> Samples:
    """At all times of the flights that count, which are numbered from `before` on."""
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None
    flight, place, _ = flown
    states, decisions = jax.tree.map(
        lambda x: jnp.asarray(x[flight, place]), (history.states, history.decisions)
    )

    def situation(state: EntryState, decision: Decision) -> Situation:
        return law.situation(state, decision)

    situations = eqx.filter_jit(jax.vmap(situation))(states, decisions)
    return Samples(
        situations=jax.tree.map(np.asarray, situations),
        final_velocity=np.asarray(campaign.flights.state.velocity)[flight],
        flights=before + flight,
        vehicles=vehicles[flight],
        at_entry=(place == 0) & (before + flight == vehicles[flight]),
        left_out={},
    )


def _moved_inputs(
    scenario: Scenario,
    campaign: Campaign,
    flown: _Flown,
    samples: Samples,
    chosen: np.ndarray,
    key: Key[Array, ""],
) -> dict[str, np.ndarray]:
    """Starts at some samples, with another third control point, by address."""
    law = bezier_law(scenario)
    history = campaign.flights.history
    assert history is not None
    situations = jax.tree.map(jnp.asarray, samples.of(chosen).situations)
    share = jax.random.uniform(
        key, (len(chosen),), minval=-1.0, maxval=1.0, dtype=float
    )

    def moved(situation: Situation, share: Array):
        lower, upper = law.anchoring.bounds(situation.point, situation.target)
        second = situation.shape.second + 0.2 * share * (upper - lower)
        shape = Shape(situation.shape.first, jnp.clip(second, lower, upper))
        return parameters_of(law.anchoring, shape, situation.point, situation.target)

    parameters = eqx.filter_jit(jax.vmap(moved))(situations, share)
    flight, place = flown.flight[chosen], flown.place[chosen]
    states = jax.tree.map(lambda x: np.asarray(x)[flight, place], history.states)
    inputs = {a: np.asarray(v)[flight] for a, v in campaign.inputs.items()}
    inputs |= {f"initial_state.{name}": v for name, v in vars(states).items()}
    inputs |= {K1: np.asarray(parameters.k1), K2: np.asarray(parameters.k2)}
    return {address: np.asarray(values) for address, values in inputs.items()}


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
    glide = bezier_law(scenario).glide
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
    layers = network.weights, network.biases
    layers, value = _adam(loss, layers, train, batch_key, warm_up)
    told(f"Adam, {warm_up} steps", value)
    part = jax.random.permutation(fitted_key, train)[:fitted]
    for done, moved, value in _lbfgs(lambda p: loss(p, part), layers, iterations):
        told(f"L-BFGS, {done} iterations", value)
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
