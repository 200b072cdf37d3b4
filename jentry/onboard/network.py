"""A small network from several numbers of a flight to one number, and its file format.

Weights are stored with their model card: the inputs and their ranges in training, the
output and its error, and how to train the network again.
"""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._files import read_sealed, write_sealed
from ..fields import Flag, Scalar, table


_FORMAT = "jentry network 2"

_CONSTANT = 1e-6
"""An input that deviates by less than this share of its size is constant: its variation may
be rounding, from which nothing can be learnt."""

_ROUNDING = 1e-9
"""Share of a bound by which an input may exceed it."""


class Network(eqx.Module):
    """Fully connected layers with tanh between them; normalisation is included.

    Inputs and output are physical numbers, the inputs in units in which they are of order
    1. The network shifts and scales them to a mean of 0 and a deviation of 1, and scales
    the output back. An input that was constant in training has a scale of 0: it has no
    influence, and its range is one value.
    """

    weights: tuple[Float[Array, "..."], ...]
    """Weights of each layer, (outputs, inputs)"""
    biases: tuple[Float[Array, "..."], ...]
    """Biases of each layer, (outputs,)"""
    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the inputs, with their units, shape (n,)"""
    input_mean: Float[Array, "..."] = table()
    """Means of the inputs in training, shape (n,)"""
    input_scale: Float[Array, "..."] = table()
    """One over the deviations, shape (n,); zero for an input constant in training"""
    input_ranges: Float[Array, "..."] = table()
    """Smallest and largest values in training, shape (n, 2)"""
    output_mean: Float[Array, "..."] = table()
    """Mean of the output in training, shape ()"""
    output_deviation: Float[Array, "..."] = table()
    """Deviation of the output in training, shape ()"""

    def __check_init__(self):
        sizes = [len(self.names), *(len(biases) for biases in self.biases)]
        layers = list(zip(sizes[1:], sizes, strict=False))
        found = [weights.shape for weights in self.weights]
        if not layers or found != layers or sizes[-1] != 1:
            raise ValueError(
                f"weights of shapes {found} do not lead from {len(self.names)} inputs to "
                f"one output: with these biases they would be {layers}"
            )
        count = (len(self.names),)
        for name, shape in (
            ("input_mean", count),
            ("input_scale", count),
            ("input_ranges", (*count, 2)),
            ("output_mean", ()),
            ("output_deviation", ()),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}: expected {shape}"
                )

    @classmethod
    def untrained(
        cls,
        names: tuple[str, ...],
        inputs: np.ndarray,
        outputs: np.ndarray,
        hidden: tuple[int, ...],
        key: Key[Array, ""],
    ) -> "Network":
        """Network with random weights, normalised by samples: shapes (m, n) and (m,)."""
        sizes = (inputs.shape[1], *hidden, 1)
        keys = jax.random.split(key, len(sizes) - 1)
        weights = tuple(
            jax.random.normal(k, (after, before), dtype=float) / np.sqrt(before)
            for k, before, after in zip(keys, sizes, sizes[1:], strict=False)
        )
        spread = inputs.std(axis=0)
        size = np.maximum(np.abs(inputs).max(axis=0), 1.0)
        varies = spread > _CONSTANT * size
        ranges = np.stack([inputs.min(axis=0), inputs.max(axis=0)], axis=1)
        return cls(
            weights=weights,
            biases=tuple(jnp.zeros(after) for after in sizes[1:]),
            input_mean=jnp.asarray(inputs.mean(axis=0)),
            input_scale=jnp.asarray(varies / np.where(varies, spread, 1.0)),
            input_ranges=jnp.asarray(ranges),
            output_mean=jnp.asarray(outputs.mean()),
            output_deviation=jnp.asarray(outputs.std()),
            names=names,
        )

    def __call__(self, inputs: Float[Array, " n"]) -> Scalar:
        x = (inputs - self.input_mean) * self.input_scale
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = jnp.tanh(weights @ x + biases)
        (y,) = self.weights[-1] @ x + self.biases[-1]
        return self.output_mean + self.output_deviation * y

    def outside(self, inputs: Float[Array, " n"]) -> Array:
        """Which inputs are outside their ranges in training, shape (n,).

        Each input is checked alone: a combination of inputs within their ranges may still
        be one that never occurred in training. NaN is outside.
        """
        lower, upper = self.input_ranges[:, 0], self.input_ranges[:, 1]
        slack = _ROUNDING * jnp.maximum(jnp.maximum(-lower, upper), 1.0)
        return ~((inputs >= lower - slack) & (inputs <= upper + slack))

    def knows(self, inputs: Float[Array, " n"]) -> Flag:
        """Whether every input is within its range in training."""
        return ~jnp.any(self.outside(inputs))


_SINGLE = "input_mean", "input_scale", "output_mean", "output_deviation"
"""Arrays that a file has once; weights and biases it has once per layer. The names and
ranges of the inputs are on the card."""


def save_network(path: Path | str, network: Network, card: dict[str, Any]) -> None:
    """Store a network with its model card, atomically.

    The names and ranges of the inputs and the sizes of the hidden layers are added to the
    card from the network.
    """
    ranges = np.asarray(network.input_ranges).tolist()
    card = card | {
        "inputs": dict(zip(network.names, ranges, strict=True)),
        "hidden": [len(biases) for biases in network.biases[:-1]],
    }
    arrays = {name: np.asarray(getattr(network, name)) for name in _SINGLE}
    for number, (weights, biases) in enumerate(
        zip(network.weights, network.biases, strict=True)
    ):
        arrays[f"weights{number}"] = np.asarray(weights)
        arrays[f"biases{number}"] = np.asarray(biases)
    arrays["card"] = np.array(json.dumps(card))
    write_sealed(path, arrays, _FORMAT)


def load_network(
    path: Path | str, purpose: str | None = None
) -> tuple[Network, dict[str, Any]]:
    """A stored network and its model card.

    **Arguments:**

    - `purpose`: purpose that the card must state.

    **Raises:** `ValueError` for a file that is not a network, is damaged, contradicts
    itself or has another purpose; `FileNotFoundError` if there is no file. Nothing in a
    file is executed.
    """
    train = "jentry train MISSION --out FOLDER"
    arrays, card = read_with_card(path, _FORMAT, purpose, train)
    try:
        layers = sum(name.startswith("weights") for name in arrays)
        numbers = {n: _numbers(n, array) for n, array in arrays.items()}
        weights, biases = (
            tuple(numbers.pop(f"{kind}{n}") for n in range(layers))
            for kind in ("weights", "biases")
        )
        single = {name: numbers.pop(name) for name in _SINGLE}
        if numbers:
            raise ValueError(f"a network has no {', '.join(numbers)}")
    except (ValueError, KeyError) as error:
        raise ValueError(
            f"{path} is no stored network: {error}; train it again with `jentry train`, "
            "or restore the file"
        ) from None
    try:
        ranges = card_ranges(card["inputs"])
        network = Network(
            weights,
            biases,
            tuple(card["inputs"]),
            input_ranges=jnp.asarray(ranges),
            **single,
        )
        _check_values(network)
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{path} contradicts itself: {error}; train it again"
        ) from None
    return network, card


def read_with_card(
    path: Path | str, kind: str, purpose: str | None, train: str
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays of a stored network, and its model card with ranges of inputs.

    **Arguments:**

    - `kind`: kind of the file and its version.
    - `purpose`: purpose that the card must state; None for any.
    - `train`: command that trains such a network.

    **Raises:** `ValueError` for a file that is not a network, is damaged or has another
    purpose; `FileNotFoundError` if there is no file. Nothing in a file is executed.
    """
    if not Path(path).exists():
        raise FileNotFoundError(f"no network at {path}: train one with `{train}`")
    try:
        arrays = read_sealed(path, kind)
        card = json.loads(str(arrays.pop("card")))
    except (ValueError, KeyError) as error:
        raise ValueError(
            f"{path} is no stored network: {error}; train it again with `{train}`, or "
            "restore the file"
        ) from None
    if not isinstance(card, dict) or not isinstance(card.get("inputs"), dict):
        raise ValueError(f"{path} has no ranges of inputs on its card: train it again")
    if purpose is not None and card.get("purpose") != purpose:
        raise ValueError(
            f"{path} is a network for {card.get('purpose')!r}: expected {purpose!r}"
        )
    return arrays, card


def _numbers(name: str, array: np.ndarray) -> Array:
    if array.dtype != np.float64 or array.ndim > 2:
        raise ValueError(f"{name} is an array of {array.dtype} and shape {array.shape}")
    return jnp.asarray(array, dtype=float)


def card_ranges(ranges: dict[str, Any]) -> np.ndarray:
    """Ranges by name as an array, shape (n, 2).

    **Raises:** `ValueError` for an invalid range.
    """
    for name, given in ranges.items():
        try:
            lower, upper = np.asarray(given, dtype=float)
        except (ValueError, TypeError):
            lower = upper = np.nan
        if not (np.isfinite(lower) and np.isfinite(upper) and lower <= upper):
            raise ValueError(
                f"the range of {name!r} on its card is {given}: expected two finite "
                "numbers, the smaller first"
            )
    return np.array([ranges[name] for name in ranges], dtype=float).reshape(-1, 2)


def _check_values(network: Network) -> None:
    """Refuse numbers that a trained network cannot have."""
    for name in ("weights", "biases", *_SINGLE):
        if not all(
            np.all(np.isfinite(x)) for x in jax.tree.leaves(getattr(network, name))
        ):
            raise ValueError(f"its {name} are not finite")
    if np.any(np.asarray(network.input_scale) < 0.0):
        raise ValueError(f"a scale of its inputs is negative: {network.input_scale}")
    beyond = np.asarray(network.outside(network.input_mean))
    if np.any(beyond):
        name = network.names[int(np.argmax(beyond))]
        raise ValueError(f"the mean of {name!r} is outside its range on the card")
