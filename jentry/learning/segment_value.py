"""The value of a training through segments of flights: a network, and how it learns."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Float, Key

from ..fields import Count
from .descent import robust
from .weight_steps import State


@dataclasses.dataclass(frozen=True)
class Segments:
    """Cuts each flight of a training into segments, through which it is differentiated.

    The flights are those of a training without segments. So are their residuals. Only the
    derivatives by the weights differ: they are the sum over the segments. In each the
    vehicle starts where the flight was, without a derivative, and the law flies to the end
    of the segment, where a value stands for the residuals with which the flight ends. In
    the last segment these residuals themselves are differentiated.

    The value is a network. It reads all that a flight carries from cycle to cycle: state,
    attitude, navigation, the memory and the decision of the law, peaks and time; and the
    dispersed numbers of the flight, which no law knows. It learns from second flights of
    the same law, with noise in the decisions of some first segments, and from the residuals
    with which these ended; it is not bootstrapped. The derivatives of a training through
    segments are as wrong as the derivatives of this network.

    Reference: J. Xu and others, "Accelerated Policy Learning with Parallel Differentiable
    Simulation", ICLR 2022. There the value is the expected sum of rewards, it learns from
    values at later times, and the flights that are differentiated have the noise.
    """

    cycles: int
    """Number of guidance cycles of a segment"""
    hidden: tuple[int, ...] = (64, 64)
    """Sizes of the hidden layers of the value"""
    steps: int = 100
    """Number of steps of Adam with which the value learns, after each step of the training.
    Before the first step of the training it takes ten times as many"""
    samples: int = 1024
    """Number of samples in each of these steps"""
    rate: float = 1e-3
    """Learning rate of the value"""
    noise: float = 0.3
    """Standard deviation of the noise in each decision of flights from which the value
    learns: on the bank, rad, on the memory of the network, and on the angle of attack, as a
    share of half of its range. Without noise the value would know only states to which the
    law flies, and no derivative away from them"""

    def __post_init__(self):
        for name in ("cycles", "steps", "samples"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1):
                raise ValueError(
                    f"{name} is {value}: it must be a whole number, at least 1"
                )
        if min(self.hidden, default=1) < 1:
            raise ValueError(f"hidden is {self.hidden}: each size must be at least 1")
        for name in ("rate", "noise"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise ValueError(f"{name} is {value}: it must be positive and finite")


class Value(eqx.Module):
    """Network from all that a flight carries to the residuals with which it ends."""

    layers: tuple[tuple[Array, Array], ...]
    """Weights (outputs, inputs) and biases (outputs,) of each layer, with tanh between"""
    mean: Float[Array, "segments inputs"]
    scale: Float[Array, "segments inputs"]
    """Mean and one over the deviation of each input at the end of each segment, on the
    flights that normalise"""
    middle: Float[Array, " residuals"]
    spread: Float[Array, " residuals"]
    """Mean and deviation of each residual on these flights"""

    @classmethod
    def untrained(
        cls, samples: "Samples", hidden: tuple[int, ...], key: Key[Array, ""]
    ) -> "Value":
        """The mean of the residuals of some flights, without a derivative."""
        count, inputs = samples.inputs.shape[1:]
        sizes = (inputs + count, *hidden, samples.residuals.shape[1])
        keys = jax.random.split(key, len(hidden) + 1)
        layers = [
            (
                jax.random.normal(k, (after, before), dtype=float) / np.sqrt(before),
                jnp.zeros(after),
            )
            for k, before, after in zip(keys, sizes, sizes[1:], strict=False)
        ]
        layers[-1] = jax.tree.map(jnp.zeros_like, layers[-1])
        return cls(tuple(layers), *_inputs_of(samples), *_ends_of(samples))

    def __call__(
        self, inputs: Float[Array, " inputs"], segment: Count
    ) -> Float[Array, " residuals"]:
        """Residuals that are expected from what a flight carries at the end of a segment.

        `segment` is the number of segments so far. An input that hardly varies there has no
        influence.
        """
        x = (inputs - self.mean[segment]) * self.scale[segment]
        x = jnp.concatenate([x, 1.0 * (jnp.arange(len(self.mean)) == segment)])
        for weights, biases in self.layers[:-1]:
            x = jnp.tanh(weights @ x + biases)
        weights, biases = self.layers[-1]
        return self.middle + self.spread * (weights @ x + biases)

    @property
    def reached(self) -> int:
        """Largest number of segments with samples that normalise."""
        (places,) = np.nonzero(np.any(np.asarray(self.scale) > 0.0, axis=1))
        return int(places.max(initial=0))

    def about(self, samples: "Samples") -> "Value":
        """The value with the normalisation of other flights.

        The last layer is changed so that the function of normalised inputs remains.

        Reference: H. van Hasselt and others, "Learning values across many orders of
        magnitude", 2016: equations (9) and (10).
        """
        mean, scale = _inputs_of(samples)
        middle, spread = _ends_of(samples)
        weights, biases = self.layers[-1]
        last = (
            weights * (self.spread / spread)[:, None],
            (self.spread * biases + self.middle - middle) / spread,
        )
        return Value((*self.layers[:-1], last), mean, scale, middle, spread)


_CONSTANT = 1e-9
"""Deviation of an input, as a share of its size, below which it is constant"""

_LEAST_SPREAD = 1e-3
"""Least deviation by which a residual is divided: residuals are of order one"""


def _inputs_of(samples: "Samples") -> tuple[Array, Array]:
    """Mean and one over the deviation of each input at the end of each segment."""
    there = samples.there[..., None]
    count = np.maximum(np.sum(there, axis=0), 1)
    mean = np.sum(samples.inputs, axis=0, where=there) / count
    square = np.sum((samples.inputs - mean) ** 2, axis=0, where=there) / count
    deviation = np.sqrt(square)
    size = np.max(np.abs(samples.inputs), axis=0, where=there, initial=1.0)
    varies = deviation > _CONSTANT * size
    scale = varies / np.where(varies, deviation, 1.0)
    return jnp.asarray(mean), jnp.asarray(scale)


def _ends_of(samples: "Samples") -> tuple[Array, Array]:
    """Mean and deviation of each residual of the flights with a sample."""
    ended = samples.residuals[np.any(samples.there, axis=1)]
    spread = np.maximum(ended.std(axis=0), _LEAST_SPREAD)
    return jnp.asarray(ended.mean(axis=0)), jnp.asarray(spread)


class Samples(NamedTuple):
    """What the value learns from: the ends of the segments of some flights."""

    inputs: np.ndarray
    """Shape (flights, segments, inputs)"""
    there: np.ndarray
    """Whether a flight has come to the end of a segment, shape (flights, segments)"""
    residuals: np.ndarray
    """Residuals at the end of each flight, shape (flights, residuals)"""

    @property
    def reached(self) -> int:
        """Largest number of segments that a flight has completed."""
        (places,) = np.nonzero(np.any(self.there, axis=0))
        return int(places.max(initial=0))


class Learner(NamedTuple):
    """A value, and what its learning needs to go on."""

    value: Value
    adam: Any
    """State of Adam"""

    @classmethod
    def begun(
        cls, segments: Segments, samples: Samples, key: Key[Array, ""]
    ) -> "Learner":
        """A value that has learnt the first samples.

        **Raises:** `ValueError` if no flight has come to the end of a segment.
        """
        if not np.any(samples.there):
            raise ValueError(
                f"cycles is {segments.cycles}: none of {len(samples.there)} flights has an "
                "end and more than so many guidance cycles; take shorter segments, or none"
            )
        first, more = jax.random.split(key)
        value = Value.untrained(samples, segments.hidden, first)
        learner = cls(value, _ADAM.init(value.layers))
        for part in jax.random.split(more, _FIRST):
            learner = learner.taught(segments, samples, part)
        return learner

    def taught(
        self, segments: Segments, samples: Samples, key: Key[Array, ""]
    ) -> "Learner":
        """The value after some steps on samples; unchanged if there are none."""
        if not np.any(samples.there):
            return self
        value = self.value.about(samples)
        return Learner(*_taught(segments, value, self.adam, samples, key))

    def as_arrays(self) -> State:
        """All numbers, as arrays that a file can hold."""
        leaves = jax.tree.leaves(self)
        return {f"{i:03}": np.asarray(leaf) for i, leaf in enumerate(leaves)}

    @classmethod
    def of_arrays(cls, segments: Segments, arrays: State) -> "Learner":
        """The learner whose numbers are stored."""
        numbers = [jnp.asarray(arrays[name]) for name in sorted(arrays)]
        count = 2 * (1 + len(segments.hidden))
        layers = tuple(zip(numbers[:count:2], numbers[1:count:2], strict=True))
        value = Value(layers, *numbers[count : count + 4])
        adam = jax.tree.structure(_ADAM.init(layers))
        return cls(value, jax.tree.unflatten(adam, numbers[count + 4 :]))


_ADAM = optax.scale_by_adam()

_FIRST = 10
"""Factor on the number of steps before the first step of a training"""


@eqx.filter_jit
def _taught(
    segments: Segments, value: Value, adam: Any, samples: Samples, key: Key[Array, ""]
) -> tuple[Value, Any]:
    """The value and the state of Adam after the steps that follow a training step."""
    read = jnp.reshape(samples.inputs, (-1, samples.inputs.shape[-1]))
    there = jnp.ravel(jnp.asarray(samples.there))
    count = samples.there.shape[1]
    ends = jnp.repeat(jnp.asarray(samples.residuals), count, axis=0)
    off = jnp.sqrt(jnp.sum(ends * ends, axis=1))
    usual = jnp.maximum(jnp.nanmedian(jnp.where(there, off, jnp.nan)), _LEAST_SPREAD)

    def loss(layers: Any, chosen: Array) -> Array:
        there = jax.vmap(dataclasses.replace(value, layers=layers))
        guess = there(read[chosen], chosen % count)
        return robust((guess - ends[chosen]) / usual)

    def step(carry: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], None]:
        layers, adam = carry
        chosen = jax.random.choice(
            key, len(there), (segments.samples,), p=there / jnp.sum(there)
        )
        update, adam = _ADAM.update(jax.grad(loss)(layers, chosen), adam)
        move = lambda x, by: x - segments.rate * by
        return (jax.tree.map(move, layers, update), adam), None

    keys = jax.random.split(key, segments.steps)
    (layers, adam), _ = lax.scan(step, (value.layers, adam), keys)
    return dataclasses.replace(value, layers=layers), adam
