"""A policy gradient for a neural law: it learns from flights, without derivatives of them.

J. Schulman and others, "Proximal Policy Optimization Algorithms", 2017, equations (7) and
(9), the latter without its bonus for entropy. The advantages are those of J.
Schulman and others, "High-Dimensional Continuous Control Using Generalized Advantage
Estimation", 2016, equation (16), without a discount.

The law flies with normal noise on the output of its network, so that the flights show which
departures from it pay. The reward comes at the end of a flight. A second recurrent network,
the critic, reads the same inputs, and estimates the reward that is to come.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Float

from jentry.campaign import Dispersion, Uniform
from jentry.campaign.batch import over_runs
from jentry.campaign.campaign import drawn_inputs, fly_run
from jentry.fields import NOT_NEGATIVE, Scalar, scalar
from jentry.flight.scenario import Scenario
from jentry.flight.termination import has_end
from jentry.guidance import AbstractSampledLaw, FixedCycle, NeuralLaw
from jentry.guidance.neural_law import INPUTS, NeuralDecision
from jentry.learning.flight_residuals import distances, neural_law_of
from jentry.onboard import Measurement, RecurrentNetwork
from jentry.onboard.sampling import normal_sample
from jentry.tuning.batch_gradients import Simulation


class Settings(NamedTuple):
    """Numbers of the method."""

    updates: int = 1200
    flights: int = 256
    """Flights of an update, all with the same weights; a multiple of `batch`"""
    epochs: int = 4
    """Passes of an update through its flights"""
    batch: int = 64
    """Flights of a step of Adam"""
    rate: float = 3e-3
    """Rate of Adam at the start; it falls to zero over all updates"""
    largest_gradient: float = 0.5
    """Norm to which a larger gradient is cut"""
    clip: float = 0.2
    """Change of the ratio of two densities beyond which an action has no slope"""
    trace: float = 0.99
    """Decay of the trace of the advantages, lambda"""
    first_deviation: float = 0.5
    """Deviation of the noise on the output at the start. It is learnt"""
    critic_weight: float = 0.5


class ExploringDecision(eqx.Module):
    """Decision of a law that explores, with what an update needs of it."""

    own: NeuralDecision
    inputs: Float[Array, " inputs"]
    mean: Scalar
    """Output of the network"""
    action: Scalar
    """The output with noise, from which the bank follows"""


class ExploringLaw(AbstractSampledLaw[Any, ExploringDecision]):
    """A neural law, with no law beside, with normal noise on the output of its network."""

    law: NeuralLaw
    cycle: FixedCycle
    """That of the law"""
    deviation: Scalar = scalar(range=NOT_NEGATIVE)
    """Standard deviation of the noise of a cycle; the cycles are independent"""
    noise_seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1 that selects the noise of this flight"""

    def init(self, measurement: Measurement) -> tuple[Any, ExploringDecision]:
        memory, own = self.law.init(measurement)
        zero = 0.0 * measurement.drag
        return memory, ExploringDecision(own, jnp.zeros(len(INPUTS)) + zero, zero, zero)

    def update(
        self, time: Scalar, measurement: Measurement, memory: Any, held: Any
    ) -> tuple[Any, ExploringDecision]:
        inputs = self.law.reads(measurement, held.own.bank)
        (mean,), after = self.law.network(inputs, held.own.memory)
        action = mean + self.deviation * normal_sample(self.noise_seed, time)(0)
        bank = self.law.turned(held.own.bank, action)
        own = dataclasses.replace(held.own, bank=bank, memory=after)
        return memory, ExploringDecision(own, inputs, mean, action)

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Any, held: Any
    ) -> tuple[Any, Any]:
        return self.law(time, measurement, memory, held.own)


def with_noise(dispersions: Mapping[str, Dispersion]) -> dict[str, Dispersion]:
    """A table of dispersions for an `ExploringLaw`: each flight has its own noise."""
    return {**dispersions, "action noise": Dispersion(_noise_seed, Uniform(0, 1))}


def _noise_seed(scenario: Any) -> Any:
    return scenario.guidance.noise_seed


class Flights(NamedTuple):
    """What an update learns from. Arrays have the shape (flights, cycles, ...)."""

    inputs: Any
    actions: Any
    densities: Any
    """Logarithm of the probability density of each action"""
    flying: Any
    """Whether a flight had not ended at a cycle; nowhere true for one without an end"""
    rewards: Any
    """Shape (flights,)"""


class Weights(NamedTuple):
    """What is learnt: weights of the two networks, and the noise."""

    actor: Any
    critic: Any
    log_deviation: Any


def reward(off: np.ndarray) -> np.ndarray:
    """Minus the logarithm of the distance, km, rounded off within 100 m.

    Half of a distance is worth the same far off as near, so the reward needs no scale.
    """
    return -0.5 * np.log(off**2 + 0.1**2)


def log_density(actions: Any, means: Any, log_deviation: Any) -> Any:
    """Logarithm of the normal probability density."""
    off = (actions - means) * jnp.exp(-log_deviation)
    return -0.5 * off**2 - log_deviation - 0.5 * math.log(2.0 * math.pi)


def clipped_objective(ratios: Any, advantages: Any, clip: float) -> Any:
    """Objective of each action, without a slope where its ratio has gone far enough."""
    clipped = jnp.clip(ratios, 1.0 - clip, 1.0 + clip)
    return jnp.minimum(ratios * advantages, clipped * advantages)


def advantages_of(values: Any, flying: Any, rewards: Any, trace: float) -> Any:
    """Advantages of actions over the values before them, shape (flights, cycles)."""
    ahead = lambda x: jnp.pad(x[:, 1:], ((0, 0), (0, 1)))
    goes_on = ahead(flying)
    errors = jnp.where(goes_on, ahead(values), rewards[:, None]) - values
    errors = jnp.where(flying, errors, 0.0)

    def back(after, error):
        advantage = error + trace * after
        return advantage, advantage

    start = jnp.zeros(len(values))
    return lax.scan(back, start, errors.T, reverse=True)[1].T


def along(network: RecurrentNetwork, trained: Any, inputs: Array) -> Array:
    """Outputs of a network along flights, (flights, cycles), with some weights."""
    network = eqx.tree_at(lambda n: n.trained, network, trained)

    def cycle(memory, read):
        (output,), memory = network(read, memory)
        return memory, output

    return jax.vmap(lambda x: lax.scan(cycle, network.start(), x)[1])(inputs)


def explored(
    start: Scenario,
    law: NeuralLaw,
    log_deviation: Any,
    simulation: Simulation,
    draw: Any,
) -> tuple[Flights, np.ndarray]:
    """Flights of a law with noise, and their distances, km; infinite without an end.

    `draw` is a function from the scenario with noise to the inputs of its runs.
    """
    noisy = ExploringLaw(law=law, cycle=law.cycle, deviation=jnp.exp(log_deviation))
    scenario = eqx.tree_at(lambda s: s.guidance, start, noisy)
    shared = scenario, simulation, law.cycle.period
    held, time, residuals, finite = over_runs(
        _explored, shared, draw(scenario), large=True
    )
    off = np.where(finite, distances(residuals), np.inf)
    flying = np.isfinite(time) & finite[:, None]
    # Rounded up, so that few numbers of cycles occur: each is compiled.
    cycles = 32 * -(-int(flying.sum(axis=1).max()) // 32)
    flying = flying[:, :cycles]
    inputs, means, actions = (
        np.where(flying.reshape(flying.shape + (1,) * (x.ndim - 2)), x[:, :cycles], 0.0)
        for x in (held.inputs, held.mean, held.action)
    )
    densities = np.asarray(log_density(actions, means, log_deviation))
    rewards = np.where(finite, reward(np.where(finite, off, 0.0)), 0.0)
    return Flights(inputs, actions, densities, flying, rewards), off


def _explored(shared: tuple[Any, ...], inputs: dict[str, Array]) -> Any:
    scenario, simulation, period = shared
    flight, dispersed = fly_run(scenario, inputs, simulation.solver, period)
    assert flight.history is not None
    residuals = jax.tree.leaves(simulation.outputs(dispersed, flight))
    residuals = jnp.stack([jnp.asarray(x, float) for x in residuals])
    finite = has_end(flight.outcome) & jnp.all(jnp.isfinite(residuals))
    return flight.history.decisions, flight.history.time, residuals, finite


class Learner:
    """Weights that learn from flights. Both networks begin with those of the law."""

    def __init__(self, network: RecurrentNetwork, own: Settings):
        self._network, self._own = network, own
        deviation = jnp.asarray(math.log(own.first_deviation))
        self.weights: Any = Weights(network.trained, network.trained, deviation)
        steps = own.updates * own.epochs * (own.flights // own.batch)
        self._optimizer = optax.chain(
            optax.clip_by_global_norm(own.largest_gradient),
            optax.adam(optax.linear_schedule(own.rate, 0.0, steps), eps=1e-5),
        )
        self._state: Any = self._optimizer.init(self.weights)
        self._values = jax.jit(lambda w, x: along(network, w.critic, x))
        self._pass = jax.jit(self._passed)

    @property
    def network(self) -> RecurrentNetwork:
        """The network of the law, with its present weights."""
        return eqx.tree_at(lambda n: n.trained, self._network, self.weights.actor)

    def ratios(self, weights: Weights, flights: Flights) -> Array:
        """Densities of the actions with some weights, over those with which they flew."""
        means = along(self._network, weights.actor, flights.inputs)
        density = log_density(flights.actions, means, weights.log_deviation)
        return jnp.exp(jnp.where(flights.flying, density - flights.densities, 0.0))

    def _loss(self, weights, flights, advantages, targets):
        count = jnp.sum(flights.flying)
        mean = lambda x: jnp.sum(jnp.where(flights.flying, x, 0.0)) / count
        ratios, clip = self.ratios(weights, flights), self._own.clip
        off = mean((self._values(weights, flights.inputs) - targets) ** 2)
        gain = mean(clipped_objective(ratios, advantages, clip))
        shown = {"clipped": mean(jnp.abs(ratios - 1.0) > clip), "critic off": off**0.5}
        return self._own.critic_weight * off - gain, shown

    def _passed(self, weights, state, data, order):
        def step(carry, chosen):
            weights, state = carry
            some = jax.tree.map(lambda x: x[chosen], data)
            slope, shown = jax.grad(self._loss, has_aux=True)(weights, *some)
            update, state = self._optimizer.update(slope, state, weights)
            return (optax.apply_updates(weights, update), state), shown

        (weights, state), shown = lax.scan(step, (weights, state), order)
        return weights, state, jax.tree.map(jnp.mean, shown)

    def learn(self, flights: Flights, rng: np.random.Generator) -> dict[str, float]:
        """Update the weights by flights with the present ones.

        Returns the share of actions whose ratio is clipped, and the error of the critic.
        """
        flights = Flights(*map(jnp.asarray, flights))
        values = self._values(self.weights, flights.inputs)
        found = advantages_of(values, flights.flying, flights.rewards, self._own.trace)
        # The same shapes in all updates: each would be compiled.
        mean, deviation = (f(found, where=flights.flying) for f in (jnp.mean, jnp.std))
        data, shown = (flights, (found - mean) / deviation, values + found), {}
        for _ in range(self._own.epochs):
            order = jnp.asarray(
                rng.permutation(len(found)).reshape(-1, self._own.batch)
            )
            self.weights, self._state, shown = self._pass(
                self.weights, self._state, data, order
            )
        return {name: float(x) for name, x in shown.items()}


def course_of(
    start: Scenario,
    dispersions: Mapping[str, Dispersion],
    simulation: Simulation,
    seed: int,
    judged: Callable[[Scenario], list[float]],
    settings: Settings = Settings(),
    judge_every: int = 20,
) -> list[tuple[int, list[float]]]:
    """Learn from fresh flights; returns numbers of flights, and judgements there."""
    law, count = neural_law_of(start), settings.flights
    learner, rng = Learner(law.network, settings), np.random.default_rng(seed)
    table, key = with_noise(dispersions), jax.random.key(2000 + seed)
    course = []
    for update in range(settings.updates):
        law = eqx.tree_at(lambda x: x.network, law, learner.network)
        runs = update * count + np.arange(count)
        draw = lambda noisy, runs=runs: drawn_inputs(noisy, table, key, runs)
        noise = learner.weights.log_deviation
        flights, off = explored(start, law, noise, simulation, draw)
        shown = learner.learn(flights, rng)
        if (update + 1) % judge_every and update + 1 < settings.updates:
            continue
        there = eqx.tree_at(lambda s: s.guidance.network, start, learner.network)
        course.append(((update + 1) * count, judged(there)))
        shown |= {"median with noise": float(np.median(off)), "noise": math.exp(noise)}
        told = ", ".join(f"{name} {x:.3g}" for name, x in shown.items())
        print(f"policy, seed {seed}: {course[-1]}, {told}", flush=True)
    return course
