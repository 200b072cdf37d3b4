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
    dispersed numbers of the flight, which no law knows. It learns the residuals with which
    the flights of the training ended, and is not bootstrapped. The derivatives of a
    training through segments are as wrong as the derivatives of this network.

    Reference: J. Xu and others, "Accelerated Policy Learning with Parallel Differentiable
    Simulation", ICLR 2022. There the value is the expected sum of rewards, and learns from
    values at later times.
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
    """Standard deviation of the noise in the decisions of flights from which the value
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
    """Network from all that a flight carries to the residuals with which it ends.

    An input that was constant on the first flights has a scale of 0: it has no influence.
    """

    layers: tuple[tuple[Array, Array], ...]
    """Weights (outputs, inputs) and biases (outputs,) of each layer, with tanh between"""
    mean: Float[Array, " inputs"]
    scale: Float[Array, " inputs"]
    """One over the deviation of each input on the first flights"""
    middle: Float[Array, " residuals"]
    spread: Float[Array, " residuals"]
    """Mean and deviation of each residual on the last flights"""

    @classmethod
    def untrained(
        cls,
        samples: Float[np.ndarray, "samples inputs"],
        residuals: Float[np.ndarray, "flights residuals"],
        hidden: tuple[int, ...],
        key: Key[Array, ""],
    ) -> "Value":
        """The mean of the residuals of some flights, without a derivative.

        `samples` are inputs of the value on these flights, which normalise them.
        """
        deviation = samples.std(axis=0)
        size = np.maximum(np.abs(samples).max(axis=0), 1.0)
        varies = deviation > _CONSTANT * size
        sizes = (samples.shape[1], *hidden, residuals.shape[1])
        keys = jax.random.split(key, len(hidden) + 1)
        layers = [
            (
                jax.random.normal(k, (after, before), dtype=float) / np.sqrt(before),
                jnp.zeros(after),
            )
            for k, before, after in zip(keys, sizes, sizes[1:], strict=False)
        ]
        layers[-1] = jax.tree.map(jnp.zeros_like, layers[-1])
        middle, spread = _normal(residuals)
        return cls(
            tuple(layers),
            jnp.asarray(samples.mean(axis=0)),
            jnp.asarray(varies / np.where(varies, deviation, 1.0)),
            middle,
            spread,
        )

    def __call__(self, inputs: Float[Array, " inputs"]) -> Float[Array, " residuals"]:
        x = (inputs - self.mean) * self.scale
        for weights, biases in self.layers[:-1]:
            x = jnp.tanh(weights @ x + biases)
        weights, biases = self.layers[-1]
        return self.middle + self.spread * (weights @ x + biases)

    def about(self, residuals: Float[np.ndarray, "flights residuals"]) -> "Value":
        """The same function, whose last layer is normalised by other residuals.

        Reference: H. van Hasselt and others, "Learning values across many orders of
        magnitude", 2016: equations (9) and (10).
        """
        middle, spread = _normal(residuals)
        weights, biases = self.layers[-1]
        last = (
            weights * (self.spread / spread)[:, None],
            (self.spread * biases + self.middle - middle) / spread,
        )
        return dataclasses.replace(
            self,
            layers=(*self.layers[:-1], last),
            middle=middle,
            spread=spread,
        )


_CONSTANT = 1e-9
"""Deviation of an input, as a share of its size, below which it is constant"""

_LEAST_SPREAD = 1e-3
"""Least deviation by which a residual is divided: residuals are of order one"""


def _normal(
    residuals: Float[np.ndarray, "flights residuals"],
) -> tuple[Array, Array]:
    """Mean and deviation of each residual."""
    spread = np.maximum(residuals.std(axis=0), _LEAST_SPREAD)
    return jnp.asarray(residuals.mean(axis=0)), jnp.asarray(spread)


class Samples(NamedTuple):
    """What the value learns from: the ends of the segments of some flights."""

    inputs: np.ndarray
    """Shape (flights, segments, inputs)"""
    there: np.ndarray
    """Whether a flight has come to the end of a segment, shape (flights, segments)"""
    residuals: np.ndarray
    """Residuals at the end of each flight, shape (flights, residuals)"""

    @property
    def ended(self) -> np.ndarray:
        """Residuals of the flights that the value learns from."""
        return self.residuals[np.any(self.there, axis=1)]


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
        known = samples.inputs[samples.there]
        if not len(known):
            raise ValueError(
                f"cycles is {segments.cycles}: none of {len(samples.there)} flights has an "
                "end and more than so many guidance cycles; take shorter segments, or none"
            )
        first, more = jax.random.split(key)
        value = Value.untrained(known, samples.ended, segments.hidden, first)
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
        value = self.value.about(samples.ended)
        return Learner(*_taught(segments, value, self.adam, samples, key))

    def as_arrays(self) -> State:
        """All numbers, as arrays that a file can hold."""
        leaves = jax.tree.leaves(self)
        return {f"{i:03}": np.asarray(leaf) for i, leaf in enumerate(leaves)}

    @classmethod
    def of_arrays(cls, segments: Segments, arrays: State) -> "Learner":
        """The learner whose numbers are stored."""
        layers = tuple((0.0, 0.0) for _ in (*segments.hidden, 0))
        like = cls(Value(layers, *4 * [0.0]), _ADAM.init(layers))  # type: ignore[arg-type]
        leaves = [jnp.asarray(arrays[name]) for name in sorted(arrays)]
        return jax.tree.unflatten(jax.tree.structure(like), leaves)


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
        guess = jax.vmap(dataclasses.replace(value, layers=layers))(read[chosen])
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
