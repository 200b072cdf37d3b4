"""A small recurrent network: a cell with a memory, and layers that read it; and its file.

Weights are stored with their model card: the inputs and their ranges in training, the
sizes, and how to train the network again.
"""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._files import write_sealed
from ..addresses import leaves_by_address, replace_leaves
from ..fields import Flag, table
from .network import card_ranges, read_with_card


_FORMAT = "jentry recurrent network 1"

_FIRST_OUTPUT = 0.1
"""Factor on the random weights of the last layer, so that the first outputs are small"""

_LEAST_DEVIATION = 1e-3
"""Least deviation by which an input is divided: all inputs are of order one"""

_CONSTANT = 1e-9
"""Deviation below which an input is constant in the samples: nothing tells how it will
vary, and it is not scaled"""


class RecurrentNetwork(eqx.Module):
    """A gated recurrent unit, and layers that read its memory and the inputs.

    The inputs are shifted and scaled to a mean of 0 and a deviation of 1 on the samples
    with which the network began; an input that hardly varies is scaled less, and one that
    is constant not at all. Hidden layers have tanh, the last layer is linear. A cell
    without memory, None, leaves a network that maps inputs to outputs.

    The cell is that of K. Cho and others, "Learning Phrase Representations using RNN
    Encoder-Decoder for Statistical Machine Translation", 2014, as `equinox.nn.GRUCell`.
    """

    cell: eqx.nn.GRUCell | None
    layers: tuple[eqx.nn.Linear, ...]
    """Hidden layers, and the layer of the outputs"""
    names: tuple[str, ...] = eqx.field(static=True)
    """Names of the inputs, shape (n,)"""
    input_mean: Float[Array, "..."] = table()
    """Means of the inputs on the first samples, shape (n,)"""
    input_scale: Float[Array, "..."] = table()
    """One over their deviations, shape (n,)"""
    input_ranges: Float[Array, "..."] = table()
    """Smallest and largest values for which the network is known, shape (n, 2)"""

    def __check_init__(self):
        count = len(self.names)
        for name, shape in (
            ("input_mean", (count,)),
            ("input_scale", (count,)),
            ("input_ranges", (count, 2)),
        ):
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"{name} has shape {getattr(self, name).shape}: expected {shape}, for "
                    f"the inputs {', '.join(self.names)}"
                )
        reads = count if self.cell is None else self.cell.input_size
        if reads != count:
            raise ValueError(f"the cell reads {reads} inputs, and {count} have names")
        sizes = [count + self.memory_size]
        sizes += [_size(layer.out_features) for layer in self.layers]
        found = [_size(layer.in_features) for layer in self.layers]
        if not self.layers or found != sizes[:-1]:
            raise ValueError(
                f"the layers read {found} numbers: with these inputs and this memory they "
                f"must read {sizes[:-1]}"
            )

    @classmethod
    def untrained(
        cls,
        inputs: dict[str, np.ndarray],
        memory: int,
        hidden: tuple[int, ...],
        outputs: int,
        key: Key[Array, ""],
    ) -> "RecurrentNetwork":
        """Network with random weights, normalised by samples of its inputs by name.

        **Arguments:**

        - `inputs`: samples of each input, of shape (m,).
        - `memory`: size of the memory; 0 for none.
        - `hidden`: sizes of the hidden layers.
        """
        if memory < 0 or min(hidden, default=1) < 1:
            raise ValueError(
                f"the memory has {memory} numbers and the hidden layers {hidden}: the "
                "first must not be negative, and the others positive"
            )
        cell_key, *keys = jax.random.split(key, len(hidden) + 2)
        count = len(inputs)
        sizes = (count + memory, *hidden, outputs)
        layers = [
            eqx.nn.Linear(before, after, dtype=float, key=k)
            for before, after, k in zip(sizes, sizes[1:], keys, strict=False)
        ]
        last = jax.tree.map(lambda x: _FIRST_OUTPUT * x, layers[-1])
        samples = np.stack([np.asarray(x, float) for x in inputs.values()], axis=1)
        deviation = samples.std(axis=0)
        floor = np.where(deviation < _CONSTANT, 1.0, _LEAST_DEVIATION)
        deviation = np.maximum(deviation, floor)
        return cls(
            eqx.nn.GRUCell(count, memory, dtype=float, key=cell_key)
            if memory
            else None,
            (*layers[:-1], last),
            tuple(inputs),
            jnp.asarray(samples.mean(axis=0)),
            jnp.asarray(1.0 / deviation),
            jnp.asarray(ranges_of(samples)),
        )

    @property
    def memory_size(self) -> int:
        return 0 if self.cell is None else _size(self.cell.hidden_size)

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return _size(self.layers[-1].out_features)

    @property
    def trained(self) -> tuple[Any, Any]:
        """What training changes: weights and biases, without the normalisation."""
        return self.cell, self.layers

    def start(self) -> Float[Array, " memory"]:
        """Memory before the first inputs."""
        return jnp.zeros(self.memory_size)

    def __call__(
        self, inputs: Float[Array, " n"], memory: Float[Array, " memory"]
    ) -> tuple[Float[Array, " outputs"], Float[Array, " memory"]]:
        """Outputs, and the memory after these inputs."""
        x = (inputs - self.input_mean) * self.input_scale
        if self.cell is not None:
            memory = self.cell(x, memory)
            x = jnp.concatenate([x, memory])
        for layer in self.layers[:-1]:
            x = jnp.tanh(layer(x))
        return self.layers[-1](x), memory

    def knows(self, inputs: Float[Array, " n"]) -> Flag:
        """Whether every input is within its range; NaN is not.

        Each input is checked alone: a combination of inputs within their ranges may still
        be one that never occurred in training.
        """
        lower, upper = self.input_ranges[:, 0], self.input_ranges[:, 1]
        return jnp.all((inputs >= lower) & (inputs <= upper))


def ranges_of(samples: np.ndarray) -> np.ndarray:
    """Smallest and largest of samples of shape (m, n), as an array of shape (n, 2)."""
    return np.stack([samples.min(axis=0), samples.max(axis=0)], axis=1)


def _size(size: int | str) -> int:
    assert isinstance(size, int)  # equinox also knows the word "scalar"
    return size


def save_recurrent_network(
    path: Path | str, network: RecurrentNetwork, card: dict[str, Any]
) -> None:
    """Store a network with its model card, atomically.

    The names and ranges of the inputs and the sizes are added to the card.
    """
    ranges = np.asarray(network.input_ranges).tolist()
    card = card | {
        "inputs": dict(zip(network.names, ranges, strict=True)),
        "memory": network.memory_size,
        "hidden": [_size(layer.out_features) for layer in network.layers[:-1]],
        "outputs": network.outputs,
    }
    arrays = {a: np.asarray(x) for a, x in leaves_by_address(network).items()}
    write_sealed(path, arrays | {"card": np.array(json.dumps(card))}, _FORMAT)


def load_recurrent_network(
    path: Path | str, purpose: str | None = None
) -> tuple[RecurrentNetwork, dict[str, Any]]:
    """A stored network and its model card.

    **Arguments:**

    - `purpose`: purpose that the card must state.

    **Raises:** `ValueError` for a file that is not such a network, is damaged, contradicts
    itself or has another purpose; `FileNotFoundError` if there is no file. Nothing in a
    file is executed.
    """
    train = "jentry train MISSION --law neural"
    arrays, card = read_with_card(path, _FORMAT, purpose, train)
    try:
        ranges = card_ranges(card["inputs"])
        count = len(ranges)
        shape = RecurrentNetwork.untrained(
            dict.fromkeys(card["inputs"], np.zeros(1)),
            card["memory"],
            tuple(card["hidden"]),
            card["outputs"],
            jax.random.key(0),
        )
        expected = {a: np.shape(x) for a, x in leaves_by_address(shape).items()}
        found = {a: x.shape for a, x in arrays.items()}
        if found != expected:
            raise ValueError(
                f"its arrays have the shapes {found}: by its card they are {expected}"
            )
        for address, array in arrays.items():
            if array.dtype != np.float64 or not np.all(np.isfinite(array)):
                raise ValueError(f"{address} is not of finite numbers of 64 bits")
        if not np.array_equal(arrays["input_ranges"], ranges.reshape(count, 2)):
            raise ValueError("its ranges are not those of its card")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{path} contradicts itself: {error}; train it again with `{train}`"
        ) from None
    values = {address: jnp.asarray(array) for address, array in arrays.items()}
    return replace_leaves(shape, values), card
