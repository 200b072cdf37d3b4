"""The points of a tuning run, and the file from which a tuning run resumes."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from ..campaign.resumed_file import (
    part_of,
    read_with_description,
    write_with_description,
)
from ..parameters.parameters import Free


_KIND = "jentry tuning 2"


_ROUNDINGS = 10.0
"""Factor on the effect of rounding on a loss, since two measurements of it differ by a
factor of a few"""

_AGREES = 0.2
"""Share of a gradient by which a difference may deviate from it. Optimizers accept a step
that achieves some tenths of the predicted decrease. Without jumps a difference over a step
of 2 % agrees within 1e-4 of the third derivative"""

_STANDARD_ERRORS = 2.0
"""Number of standard errors by which a difference may deviate from a gradient. With jumps a
difference depends on the few flights that happen to jump"""

_MATTERS = 1e-3
"""Share of the loss by which a difference may deviate from a gradient, for a step that
changes a number by its own size. Near an optimum the gradient is small, and so is its
error"""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One evaluated point."""

    loss: float
    """Loss of the exact law, over draws that are the same for all points"""
    gradient_norm: float
    """Norm of the gradient of the followed loss with respect to the free numbers; see
    `Evaluation.followed`"""
    failed: int
    """Number of flights that are not finite. The loss leaves them out"""
    gradients_failed: int
    """Number of finite flights that the gradient leaves out"""
    flights: int
    """Number of flights so far. A flight with its gradient counts once"""
    seconds: float
    """Time since the start, s, including compilation"""
    values: dict[str, np.ndarray]
    """Values of the tuned leaves, by address"""
    free: Free
    gradient_shares: dict[str, float]
    """Share of the flights in the loss on which each parameter has an effect, by address"""
    rounding: float = np.nan
    """Effect of rounding on the followed loss, from the last measurement"""
    difference: float = np.nan
    """Coarse central difference of the followed loss along its gradient, to be compared
    with `gradient_norm`. It is computed at the start only, and not for a gradient by
    differences"""
    difference_error: float = np.nan
    """Standard error of `difference`"""
    gradient_error: float = np.nan
    """Standard error of a gradient by differences"""

    @property
    def is_rounding(self) -> bool:
        """Whether the gradient predicts no change of the loss beyond rounding.

        The prediction is for a step that changes a number by its own size.
        """
        return self.gradient_norm <= _ROUNDINGS * self.rounding

    @property
    def contradicted(self) -> bool:
        """Whether the difference contradicts the gradient.

        The deviation must exceed the standard error, and must matter to the loss.
        """
        lacking = abs(self.difference - self.gradient_norm)
        least = max(
            _AGREES * max(abs(self.difference), self.gradient_norm),
            _STANDARD_ERRORS * self.difference_error,
            _MATTERS * abs(self.loss),
        )
        return lacking > least

    def better_than(self, other: "Entry") -> bool:
        """Whether this point is better than another.

        A point with a finite loss is better than one without. Of two such points the one
        with fewer failed flights is better, and with equal numbers the one with the smaller
        loss.
        """
        if np.isfinite(self.loss) != np.isfinite(other.loss):
            return bool(np.isfinite(self.loss))
        if self.failed != other.failed:
            return self.failed < other.failed
        return self.loss < other.loss


NUMBERS = tuple(f.name for f in dataclasses.fields(Entry) if f.type in (int, float))
"""Names of the fields of an entry that hold one number"""

_BY_ADDRESS = "values", "free", "gradient_shares"


@dataclasses.dataclass(frozen=True)
class Record:
    """Where the points of a tuning run are stored, and how its progress is reported."""

    path: Path | str | None = None
    """File that is written after each step. The same call resumes from it, with more steps
    if requested. None for no file"""
    labels: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Labels that distinguish your losses and optimizers. They are stored in the file, and
    compared when a run resumes"""
    report: Callable[[list["Entry"], int], None] | None = None
    """Function that is called after each step with all points and the place of the best"""


@dataclasses.dataclass(frozen=True)
class CourseFile:
    """The file of a tuning run, and the description of the run."""

    path: Path
    description: dict[str, Any]
    """Description in plain values, which can be written as JSON"""

    def write(
        self, entries: list[Entry], following: Free, state: PyTree, converged: bool
    ) -> None:
        """Write all that is needed to resume. The file is replaced as a whole."""
        arrays = {
            name: np.array([getattr(entry, name) for entry in entries])
            for name in NUMBERS
        }
        for name in _BY_ADDRESS:
            for address in getattr(entries[0], name):
                column = [getattr(entry, name)[address] for entry in entries]
                arrays[f"{name}/{address}"] = np.array(column)
        arrays |= {f"following/{a}": np.asarray(x) for a, x in following.items()}
        arrays["converged"] = np.array(converged)
        for number, leaf in enumerate(_leaves(state)):
            arrays[f"state/{number}"] = leaf
        write_with_description(self.path, arrays, self.description, _KIND)

    def read(self) -> tuple[list[Entry], Free, list[np.ndarray], bool]:
        """Points, next point, leaves of the stepper's state, and whether it converged.

        **Raises:** `ValueError` for a file that is no record, or that belongs to another
        tuning run. The message names the first difference.
        """
        arrays = read_with_description(self.path, self.description, _KIND, "tuning run")
        columns = {name: part_of(arrays, name) for name in _BY_ADDRESS}
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
        following = {a: jnp.asarray(x) for a, x in part_of(arrays, "following").items()}
        leaves = part_of(arrays, "state")
        state = [leaves[str(i)] for i in range(len(leaves))]
        return entries, following, state, bool(arrays["converged"])


def _leaves(state: PyTree) -> list[np.ndarray]:
    return [np.asarray(_plain(x)) for x in jax.tree.leaves(_numbers_of(state))]


def _numbers_of(state: PyTree) -> PyTree:
    return eqx.filter(state, eqx.is_array)


def _plain(leaf: Any) -> Any:
    """A random key as its numbers; any other leaf unchanged."""
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _is_key(leaf: Any) -> bool:
    return jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def restored(like: PyTree, stored: list[np.ndarray]) -> PyTree:
    """The state of a stepper from its stored leaves, with the structure of a new state.

    **Raises:** `ValueError` if the leaves do not fit.
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
    """Description of a loss, a map or an optimizer in plain values, as far as possible."""
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
