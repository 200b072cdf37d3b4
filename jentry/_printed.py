"""Names as words, and objects as text, with numbers in the usual units."""

import contextlib
import dataclasses
import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .fields import units_of
from .units import at_edge


def in_words(name: str) -> str:
    """The name of a field or an output as words: `heat_rate` becomes heat rate."""
    return name.replace("_", " ").replace("flight path", "flight-path")


def sentence(described: Any) -> str:
    """The first sentence of the docstring of a function or a class."""
    words = " ".join((inspect.getdoc(described) or "").split("\n\n")[0].split())
    return re.split(r"(?<=\.)\s", words)[0]


def quantity_in_words(value: Any, unit: str) -> str:
    """Text for a number, or for the extremes of several, in its usual unit.

    A value without known numbers, as under `jit`, is shown by its type and shape.
    """
    if not _is_known(value):
        described = hasattr(value, "dtype") and hasattr(value, "shape")
        told = f"{value.dtype}{list(value.shape)}" if described else repr(value)
        return _with_unit(told, unit)
    numbers, shown = at_edge(value, unit)
    if numbers.ndim == 0:
        return _with_unit(f"{float(numbers):z.6g}", shown)
    finite = numbers[np.isfinite(numbers)]
    count = " x ".join(map(str, numbers.shape))
    if not finite.size:
        return _with_unit(f"{count} numbers, none of them finite", shown)
    text = f"{count} numbers, {finite.min():z.6g} to {finite.max():z.6g}"
    text = _with_unit(text, shown)
    lost = numbers.size - finite.size
    return f"{text}, {lost} not finite" if lost else text


def _is_known(value: Any) -> bool:
    """Whether a value is a number, or an array of numbers, that is known."""
    if isinstance(value, Tracer | bool):
        return False
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return jnp.issubdtype(value.dtype, np.number)
    return isinstance(value, int | float)


def as_text(self: Any) -> str:
    """An object as text: one line for each of its numbers, with its unit.

    It is the `__str__` of the objects that are printed most; `repr` shows the structure.
    Fields that are None are left out.
    """
    lines = [(f"{'  ' * depth}{name}", value) for depth, name, value in _lines(self, 1)]
    width = max((len(name) for name, _ in lines), default=0)
    table = [f"{name:{width}}  {value}".rstrip() for name, value in lines]
    return "\n".join([type(self).__name__, *table])


def _lines(tree: Any, depth: int) -> Iterator[tuple[int, str, str]]:
    units = units_of(type(tree)) if dataclasses.is_dataclass(tree) else {}
    units |= getattr(tree, "_units", {})  # units of a mapping, which has no fields
    for name, value in _members(tree, units).items():
        if value is None:
            continue
        if isinstance(value, tuple | list) and any(
            map(dataclasses.is_dataclass, value)
        ):
            value = {str(place): each for place, each in enumerate(value)}
        if dataclasses.is_dataclass(value) or isinstance(value, Mapping):
            inner = list(_lines(value, depth + 1))
            kind = "" if isinstance(value, Mapping) else type(value).__name__
            if inner or kind:
                yield depth, in_words(name), kind
            yield from inner
        elif name in units:
            yield depth, in_words(name), quantity_in_words(value, units[name])
        else:
            yield depth, in_words(name), _plain(value)


def _members(tree: Any, units: Mapping[str, str]) -> dict[str, Any]:
    """The fields of an object, and those of its properties that have a unit."""
    if isinstance(tree, Mapping):
        return {str(name): tree[name] for name in tree}
    found = {
        field.name: getattr(tree, field.name) for field in dataclasses.fields(tree)
    }
    for name in units:
        # The property fails if a field is no number, such as a placeholder of JAX.
        with contextlib.suppress(TypeError, ValueError):
            found[name] = getattr(tree, name)
    return found


def _plain(value: Any) -> str:
    """Text for a member without a unit."""
    if isinstance(value, jax.Array | np.ndarray):
        return quantity_in_words(value, "1")
    return repr(value)


def _with_unit(text: str, unit: str) -> str:
    return text if unit == "1" else f"{text} {unit}"
