"""Array types, fields that make every physical number a leaf, and their allowed values."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .units import TURN, degree


if TYPE_CHECKING:
    Scalar = Array | float
    Vector = Array
    Flag = Array | bool
    Count = Array | int
else:
    Scalar = Float[Array, ""]
    Vector = Float[Array, " n"]
    Flag = Bool[Array, ""]
    Count = Int[Array, ""]


def as_float_array(value: Any) -> Array:
    """Strong float array: float64 after `jentry.setup()`, float32 without it."""
    return jnp.asarray(value, dtype=float)


Range = tuple[float, float]
"""Least and largest allowed value of a field, in its unit"""

NOT_NEGATIVE: Range = (0.0, math.inf)

ABOVE_GROUND: Range = (0.0, math.inf)
"""Range of the altitude at the start of an entry, m; its end may be lower"""

QUARTER: Range = (-0.5 * math.pi, 0.5 * math.pi)
"""Range of latitudes and flight-path angles, rad"""


def _about(unit: str, positive: bool, range: Range | None) -> dict[str, Any]:
    """Metadata of a field; an angle is within a turn if no range is given."""
    if range is None and unit == "rad":
        range = (-TURN, TURN)
    return {"unit": unit, "positive": positive, "range": range}


def scalar(
    default: Any = MISSING,
    *,
    unit: str = "1",
    positive: bool = False,
    range: Range | None = None,
    choice: bool = False,
) -> Any:
    """A physical number: a leaf with a unit that can be dispersed, tuned and swept.

    **Arguments:**

    - `default`: default value; without it the field is required.
    - `unit`: SI unit. `jentry show` shows it, result files store it, and units that a user
      gives must agree with it.
    - `positive`: refuse values that are zero or negative (see `check`).
    - `range`: least and largest allowed value (see `check`); by default an angle is within
      a turn.
    - `choice`: the number only selects something, such as the seed of noise: its size has
      no meaning, and a flight has no derivative with respect to it.
    """
    given = {} if default is MISSING else {"default": default}
    metadata = {**_about(unit, positive, range), **({"choice": True} if choice else {})}
    return eqx.field(converter=as_float_array, metadata=metadata, **given)


def optional_scalar(*, unit: str = "1", range: Range | None = None) -> Any:
    """A physical number that may be None, in which case it is no leaf."""

    def convert(value: Any) -> Any:
        return None if value is None else as_float_array(value)

    metadata = _about(unit, False, range)
    return eqx.field(converter=convert, metadata=metadata, default=None)


def output(*, unit: str = "1", default: Any = MISSING) -> Any:
    """An output of a flight: a number or an array, with its SI unit.

    Tables, results, figures and `jentry tune` use its name and its unit.
    """
    given = {} if default is MISSING else {"default": default}
    return eqx.field(metadata={"unit": unit}, **given)


Getter = TypeVar("Getter", bound=Callable)


def in_unit(unit: str) -> Callable[[Getter], Getter]:
    """Decorator that states the unit of a number that is a property, not a field.

    @property
    @in_unit("m")
    def distance(self): ...
    """

    def marked(getter: Getter) -> Getter:
        getter.unit = unit  # pyright: ignore[reportFunctionMemberAccess]
        return getter

    return marked


def units_of(kind: type) -> dict[str, str]:
    """SI units of the numbers of a class by name: first its fields, then its properties."""
    found = {
        field.name: field.metadata["unit"]
        for field in dataclasses.fields(kind)
        if "unit" in field.metadata
    }
    for name, member in vars(kind).items():
        if isinstance(member, property):
            unit = getattr(member.fget, "unit", None)
            found |= {} if unit is None else {name: unit}
    return found


def table(*, unit: str = "1", positive: bool = False, increasing: bool = False) -> Any:
    """An array of physical numbers, which is one leaf.

    With `positive` or `increasing`, other values are refused (see `check`).
    """
    metadata = _about(unit, positive, None) | {"increasing": increasing}
    return eqx.field(converter=as_float_array, metadata=metadata)


def check_values(
    address: str, values: np.ndarray, metadata: Mapping, *, had_unit: bool = False
) -> None:
    """Refuse values of the leaf at an address that cannot be flown; see `check`.

    `had_unit` says that the values came with their unit: then the message does not ask
    whether degrees were meant.

    Raises `ValueError` for a value that is not finite, or that its field does not allow.
    """
    flat = np.ravel(values)
    refused = flat[~np.isfinite(flat)]
    if refused.size:
        raise ValueError(f"{address} is {refused[0]}: it must be a finite number")
    least, largest = metadata.get("range") or (-np.inf, np.inf)
    # A value at a bound passes in float32 as well.
    slack = 1e-6 * max(
        (abs(x) for x in (least, largest) if np.isfinite(x)), default=0.0
    )
    refused = flat[(flat < least - slack) | (flat > largest + slack)]
    if metadata.get("positive"):
        refused = np.append(refused, flat[flat <= 0.0])
    if refused.size:
        unit = metadata.get("unit", "1")
        words = "" if unit == "1" else f" {unit}"
        if unit == "rad":
            words = f" rad, {refused[0] / degree:g} deg"
        forgotten = ""
        in_degrees = least <= refused[0] * degree <= largest
        if unit == "rad" and in_degrees and not had_unit:
            forgotten = f"; did you mean {refused[0]:g}deg?"
        raise ValueError(
            f"{address} is {refused[0]:g}{words}: it must be {allowed(metadata)}"
            f"{forgotten}"
        )
    if metadata.get("increasing") and not np.all(np.diff(flat) > 0.0):
        raise ValueError(f"{address} must increase from each value to the next")


def is_scalar(metadata: Mapping) -> bool:
    """Whether a field with this metadata was made by `scalar`, not by `table`."""
    return "range" in metadata and "increasing" not in metadata


def allowed(metadata: Mapping) -> str:
    """Text for the allowed values of a field; empty if any value is allowed."""
    if metadata.get("positive"):
        return "greater than zero"
    least, largest = metadata.get("range") or (-np.inf, np.inf)
    unit = metadata.get("unit", "1")
    if unit == "rad":
        least, largest, unit = least / degree, largest / degree, "deg"
    unit = "" if unit == "1" else f" {unit}"
    if np.isinf(least) and np.isinf(largest):
        return ""
    if np.isinf(largest):
        return "zero or more" if least == 0.0 else f"{least:g}{unit} or more"
    if np.isinf(least):
        return f"{largest:g}{unit} or less"
    return f"between {least:g} and {largest:g}{unit}"
