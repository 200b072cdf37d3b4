"""Array types, and fields that make every physical number a leaf."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import MISSING
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .units import TURN


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
