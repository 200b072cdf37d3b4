"""What a tuning run has done so far: its history, and the file it resumes from."""

import dataclasses
import json
import os
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree

from ..campaign.description import first_difference
from .parameters import Free


_UNREADABLE = ValueError, KeyError, OSError, EOFError, TypeError, zipfile.BadZipFile
"""What numpy may raise of a file that it has not written"""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One evaluated point."""

    loss: float
    """By the exact law"""
    gradient_norm: float
    """With respect to the free numbers"""
    not_finite: int
    """Flights left out"""
    flights: int
    """Flown so far, a flight with its gradient counting once"""
    seconds: float
    """Since the start, compiling included"""
    values: dict[str, np.ndarray]
    """Of the tuned leaves, by address"""
    free: Free
    reached: dict[str, float]
    """Share of the flights that the loss looks at to which the parameter matters"""

    def better_than(self, other: "Entry") -> bool:
        """Fewer flights that are not finite, or as many and less loss."""
        if self.not_finite != other.not_finite:
            return self.not_finite < other.not_finite
        return self.loss < other.loss


def write_record(
    path: Path,
    description: dict[str, Any],
    history: list[Entry],
    following: Free,
    state: PyTree,
) -> None:
    """Store all that resumption needs, at once or not at all."""
    arrays = {"description": np.array(json.dumps(description))}
    for name in ("loss", "gradient_norm", "not_finite", "flights", "seconds"):
        arrays[name] = np.array([getattr(entry, name) for entry in history])
    for name in ("values", "free", "reached"):
        for address in getattr(history[0], name):
            column = [getattr(entry, name)[address] for entry in history]
            arrays[f"{name}/{address}"] = np.array(column)
    arrays |= {f"following/{a}": np.asarray(x) for a, x in following.items()}
    leaves = jax.tree.leaves(eqx.filter(state, eqx.is_array))
    arrays |= {f"state/{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        try:
            np.savez(file, allow_pickle=False, **arrays)
            file.close()
            os.replace(file.name, path)
        except BaseException:
            os.unlink(file.name)
            raise


def read_record(
    path: Path, description: dict[str, Any]
) -> tuple[list[Entry], Free, list[np.ndarray]]:
    """History, next point and leaves of the state of the stepper.

    **Raises:** `ValueError` for a file that is no record or of another tuning run, and
    says where they differ.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        known = json.loads(str(arrays["description"]))
    except _UNREADABLE as error:
        raise ValueError(f"{path} is no record of a tuning run: {error}") from None
    difference = first_difference(known, json.loads(json.dumps(description)))
    if difference:
        raise ValueError(
            f"{path} holds another tuning run: {difference}; choose another place, or "
            "remove it"
        )

    def part(name: str) -> dict[str, np.ndarray]:
        prefix = f"{name}/"
        return {
            k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)
        }

    groups = {name: part(name) for name in ("values", "free", "reached")}
    history = [
        Entry(
            loss=float(arrays["loss"][i]),
            gradient_norm=float(arrays["gradient_norm"][i]),
            not_finite=int(arrays["not_finite"][i]),
            flights=int(arrays["flights"][i]),
            seconds=float(arrays["seconds"][i]),
            values={a: np.asarray(x[i]) for a, x in groups["values"].items()},
            free={a: jax.numpy.asarray(x[i]) for a, x in groups["free"].items()},
            reached={a: float(x[i]) for a, x in groups["reached"].items()},
        )
        for i in range(len(arrays["loss"]))
    ]
    following = {a: jax.numpy.asarray(x) for a, x in part("following").items()}
    state = part("state")
    return history, following, [state[str(i)] for i in range(len(state))]


def restored(like: PyTree, leaves: list[np.ndarray], path: Path) -> PyTree:
    """The state of a stepper from its stored leaves, in the structure of a fresh one."""
    numbers, others = eqx.partition(like, eqx.is_array)
    fresh, structure = jax.tree.flatten(numbers)
    if [x.shape for x in fresh] != [x.shape for x in leaves]:
        raise ValueError(
            f"{path} was written with another optimizer: it cannot be resumed with this"
        )
    numbers = jax.tree.unflatten(structure, [jax.numpy.asarray(x) for x in leaves])
    return eqx.combine(numbers, others)
