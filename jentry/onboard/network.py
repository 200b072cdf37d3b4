"""A small network from numbers of a flight to one number, and the file that it is kept in.

Weights travel with their model card: what goes in and within which ranges the network was
trained, what comes out and with what error, and how to train it again.
"""

import hashlib
import json
import zipfile
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._files import write_arrays
from .._types import Scalar, table


_FORMAT = "jentry network 1"

_UNREADABLE = ValueError, KeyError, OSError, EOFError, TypeError, zipfile.BadZipFile
"""What numpy may raise of a file that it has not written"""


class Network(eqx.Module):
    """Fully connected layers with tanh between them; normalisation is inside.

    Takes and gives physical numbers: the inputs are shifted and scaled to a mean of 0 and
    a deviation of 1, and the output back.
    """

    weights: tuple[Float[Array, "..."], ...]
    """Of each layer, (outputs, inputs)"""
    biases: tuple[Float[Array, "..."], ...]
    """Of each layer, (outputs,)"""
    input_mean: Float[Array, "..."] = table()
    """(n,)"""
    input_deviation: Float[Array, "..."] = table()
    """(n,)"""
    output_mean: Float[Array, "..."] = table()
    """()"""
    output_deviation: Float[Array, "..."] = table()
    """()"""

    @classmethod
    def untrained(
        cls,
        inputs: np.ndarray,
        outputs: np.ndarray,
        hidden: tuple[int, ...],
        key: Key[Array, ""],
    ) -> "Network":
        """With random weights, and the normalisation of samples: (m, n) and (m,).

        Inputs that are the same in all samples are shifted only.
        """
        sizes = (inputs.shape[1], *hidden, 1)
        keys = jax.random.split(key, len(sizes) - 1)
        weights = tuple(
            jax.random.normal(k, (after, before), dtype=float) / np.sqrt(before)
            for k, before, after in zip(keys, sizes, sizes[1:], strict=False)
        )
        spread = inputs.std(axis=0)
        return cls(
            weights=weights,
            biases=tuple(jnp.zeros(after) for after in sizes[1:]),
            input_mean=jnp.asarray(inputs.mean(axis=0)),
            input_deviation=jnp.asarray(np.where(spread > 0.0, spread, 1.0)),
            output_mean=jnp.asarray(outputs.mean()),
            output_deviation=jnp.asarray(outputs.std()),
        )

    def __call__(self, inputs: Float[Array, " n"]) -> Scalar:
        x = (inputs - self.input_mean) / self.input_deviation
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = jnp.tanh(weights @ x + biases)
        (y,) = self.weights[-1] @ x + self.biases[-1]
        return self.output_mean + self.output_deviation * y


def save_network(path: Path | str, network: Network, card: dict[str, Any]) -> None:
    """Store a network with its model card, at once or not at all."""
    path = Path(path)
    arrays = {
        f"leaf{number}": np.asarray(leaf)
        for number, leaf in enumerate(jax.tree.leaves(network))
    }
    arrays["layers"] = np.array(len(network.weights))
    arrays["card"] = np.array(json.dumps(card))
    arrays["digest"] = np.array(_digest(arrays))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_arrays(path, arrays)


def load_network(
    path: Path | str, purpose: str | None = None
) -> tuple[Network, dict[str, Any]]:
    """A stored network and its model card.

    **Arguments:**

    - `purpose`: that the card must name.

    **Raises:** `ValueError` for a file that is no network, is damaged, or has another
    purpose; `FileNotFoundError` where there is none. Nothing in a file is executed.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(
            f"no network at {path}: train one with `jentry train MISSION --out FOLDER`"
        )
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        digest = str(arrays.pop("digest"))
        layers = int(arrays["layers"])
        card = json.loads(str(arrays["card"]))
        leaves = [arrays[f"leaf{number}"] for number in range(2 * layers + 4)]
    except _UNREADABLE as error:
        raise ValueError(f"{path} is no stored network: {error}") from None
    if digest != _digest(arrays):
        raise ValueError(
            f"{path} is damaged: its numbers are not those of its digest; train it again "
            "with `jentry train`, or restore the file"
        )
    if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
        raise ValueError(f"{path} holds weights that are not finite: train it again")
    if purpose is not None and card.get("purpose") != purpose:
        raise ValueError(
            f"{path} is a network for {card.get('purpose')!r}: expected {purpose!r}"
        )
    numbers = [jnp.asarray(leaf, dtype=float) for leaf in leaves]
    network = Network(
        tuple(numbers[:layers]),
        tuple(numbers[layers : 2 * layers]),
        *numbers[2 * layers :],
    )
    return network, card


def _digest(arrays: dict[str, np.ndarray]) -> str:
    hashed = hashlib.sha256(_FORMAT.encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        hashed.update(f"{name} {array.dtype.str} {array.shape}".encode())
        hashed.update(array.tobytes())
    return hashed.hexdigest()
