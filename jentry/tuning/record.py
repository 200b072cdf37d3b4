"""The course of a tuning run: its points, and the file from which it resumes."""

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .._files import read_sealed, write_sealed
from ..campaign.description import first_difference
from ..parameters.parameters import Free


_KIND = "jentry tuning 2"


_ROUNDINGS = 10.0
"""Changes of a loss by rounding are measured twice, and vary by a few times"""

_AGREES = 0.2
"""Of a gradient. Optimizers take a step that brings some tenths of what was promised.
Without jumps a difference of a step of 2 % agrees within 1e-4 of the third derivative"""

_STANDARD_ERRORS = 2.0
"""With jumps a difference is a matter of luck: of few flights that happen to jump"""

_MATTERS = 1e-3
"""Of the loss, for a step that changes a number by its own size. At a point that is
best already the gradient is small, and so is all that it lacks"""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One evaluated point."""

    loss: float
    """By the exact law, over the draws that are the same for all points"""
    gradient_norm: float
    """With respect to the free numbers, of the law and the draws that are followed"""
    failed: int
    """Flights that are not finite: the loss is without them"""
    gradients_failed: int
    """Finite flights that the gradient is without"""
    flights: int
    """Flown so far, a flight with its gradient counting once"""
    seconds: float
    """Since the start, compiling included"""
    values: dict[str, np.ndarray]
    """Of the tuned leaves, by address"""
    free: Free
    gradient_shares: dict[str, float]
    """Share of the flights that the loss looks at to which the parameter matters"""
    rounding: float = np.nan
    """Of the loss that is followed, as it was measured last"""
    difference: float = np.nan
    """Of the loss that is followed, over its own gradient: a coarse central difference
    beside `gradient_norm`. Measured at the start only, and not of a gradient that is one
    of differences itself"""
    difference_error: float = np.nan
    """Standard error of it"""
    gradient_error: float = np.nan
    """Standard error of a gradient by differences"""

    @property
    def is_rounding(self) -> bool:
        """Whether the gradient promises no change beyond the rounding of the loss, not
        even for a step that changes a number by its own size."""
        return self.gradient_norm <= _ROUNDINGS * self.rounding

    @property
    def contradicted(self) -> bool:
        """Whether the difference says another thing than the gradient does, beyond its
        standard error, and one that matters to the loss."""
        lacking = abs(self.difference - self.gradient_norm)
        least = max(
            _AGREES * max(abs(self.difference), self.gradient_norm),
            _STANDARD_ERRORS * self.difference_error,
            _MATTERS * abs(self.loss),
        )
        return lacking > least

    def better_than(self, other: "Entry") -> bool:
        """Finite; then fewer flights that are not finite, or as many and less loss."""
        if np.isfinite(self.loss) != np.isfinite(other.loss):
            return bool(np.isfinite(self.loss))
        if self.failed != other.failed:
            return self.failed < other.failed
        return self.loss < other.loss


NUMBERS = tuple(f.name for f in dataclasses.fields(Entry) if f.type in (int, float))
"""Fields of an entry that are one number"""

_BY_ADDRESS = "values", "free", "gradient_shares"


@dataclasses.dataclass(frozen=True)
class Record:
    """How the course of a tuning run is kept, and who is told of it."""

    path: Path | str | None = None
    """A file that is kept up to date, and from which the same call resumes; it may ask
    for more steps. None is kept if not given"""
    labels: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Kept in the file and compared: what tells your losses and optimizers apart"""
    report: Callable[[list["Entry"], int], None] | None = None
    """Called after each step with all points and the place of the best"""


@dataclasses.dataclass(frozen=True)
class CourseFile:
    """The file of a tuning run, and what the run is."""

    path: Path
    description: dict[str, Any]
    """In plain values"""

    def write(
        self, entries: list[Entry], following: Free, state: PyTree, converged: bool
    ) -> None:
        """Store all that resumption needs, at once or not at all."""
        arrays = {"description": np.array(json.dumps(self.description))}
        for name in NUMBERS:
            arrays[name] = np.array([getattr(entry, name) for entry in entries])
        for name in _BY_ADDRESS:
            for address in getattr(entries[0], name):
                column = [getattr(entry, name)[address] for entry in entries]
                arrays[f"{name}/{address}"] = np.array(column)
        arrays |= {f"following/{a}": np.asarray(x) for a, x in following.items()}
        arrays["converged"] = np.array(converged)
        for number, leaf in enumerate(_leaves(state)):
            arrays[f"state/{number}"] = leaf
        write_sealed(self.path, arrays, _KIND)

    def read(self) -> tuple[list[Entry], Free, list[np.ndarray], bool]:
        """Points, next point, leaves of the stepper's state, and whether it converged.

        **Raises:** `ValueError` for a file that is no record or of another tuning run,
        and says where they differ.
        """
        try:
            arrays = read_sealed(self.path, _KIND)
            known = json.loads(str(arrays["description"]))
        except (ValueError, KeyError) as error:
            raise ValueError(
                f"{self.path} is no record of a tuning run: {error}; remove it, and "
                "tuning begins again"
            ) from None
        wanted = json.loads(json.dumps(self.description))
        difference = first_difference(known, wanted)
        if difference:
            raise ValueError(
                f"{self.path} holds another tuning run: {difference}; choose another "
                "place, or remove it"
            )

        def part(name: str) -> dict[str, np.ndarray]:
            prefix = f"{name}/"
            names = [n for n in arrays if n.startswith(prefix)]
            return {n.removeprefix(prefix): arrays[n] for n in names}

        columns = {name: part(name) for name in _BY_ADDRESS}
        entries = []
        for i in range(len(arrays["loss"])):
            numbers = {name: arrays[name][i].item() for name in NUMBERS}
            at = {n: {a: x[i] for a, x in columns[n].items()} for n in _BY_ADDRESS}
            entry = Entry(
                **numbers,
                values={a: np.asarray(x) for a, x in at["values"].items()},
                free={a: jnp.asarray(x) for a, x in at["free"].items()},
                gradient_shares={a: float(x) for a, x in at["gradient_shares"].items()},
            )
            entries.append(entry)
        following = {a: jnp.asarray(x) for a, x in part("following").items()}
        leaves = part("state")
        state = [leaves[str(i)] for i in range(len(leaves))]
        return entries, following, state, bool(arrays["converged"])


def _leaves(state: PyTree) -> list[np.ndarray]:
    return [np.asarray(_plain(x)) for x in jax.tree.leaves(_numbers_of(state))]


def _numbers_of(state: PyTree) -> PyTree:
    return eqx.filter(state, eqx.is_array)


def _plain(leaf: Any) -> Any:
    """Random keys as the numbers that they are made of."""
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def restored(like: PyTree, stored: list[np.ndarray]) -> PyTree:
    """The state of a stepper from its stored leaves, in the structure of a fresh one.

    Raises `ValueError` if they do not fit.
    """
    numbers, others = eqx.partition(like, eqx.is_array)
    fresh, structure = jax.tree.flatten(numbers)
    if [np.shape(_plain(x)) for x in fresh] != [x.shape for x in stored]:
        raise ValueError(
            "the record was written with another optimizer: it cannot be resumed with "
            "this one"
        )
    leaves = [
        jax.random.wrap_key_data(jnp.asarray(x)) if _is_key(like) else jnp.asarray(x)
        for like, x in zip(fresh, stored, strict=True)
    ]
    return eqx.combine(jax.tree.unflatten(structure, leaves), others)


def told(thing: Any) -> Any:
    """In plain values, what can be told of a loss, a map or an optimizer."""
    if isinstance(thing, functools.partial):
        return [told(thing.func), told(thing.args), told(thing.keywords)]
    if hasattr(thing, "described") and not isinstance(thing, type):
        return {"type": type(thing).__qualname__, **thing.described()}
    if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        fields = {
            f.name: told(getattr(thing, f.name)) for f in dataclasses.fields(thing)
        }
        return {"type": type(thing).__qualname__, **fields}
    if isinstance(thing, Mapping):
        return {str(name): told(value) for name, value in thing.items()}
    if isinstance(thing, jax.Array | np.ndarray):
        return np.asarray(thing).tolist()
    if thing is None or isinstance(thing, str | bool | int | float):
        return thing
    if isinstance(thing, tuple | list) and not hasattr(thing, "_fields"):
        return [told(item) for item in thing]
    if callable(thing):
        module = getattr(thing, "__module__", "")
        return f"{module}.{getattr(thing, '__qualname__', type(thing).__qualname__)}"
    return type(thing).__qualname__
