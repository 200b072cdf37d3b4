"""Array types, and the fields that make every physical number a leaf."""

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
"""Least and largest value of a field, both allowed, in its unit"""

NOT_NEGATIVE: Range = (0.0, math.inf)

ABOVE_GROUND: Range = (0.0, math.inf)
"""m; where an entry may begin. Where one should end may lie lower"""

QUARTER: Range = (-0.5 * math.pi, 0.5 * math.pi)
"""rad; of latitudes and flight-path angles"""


def _about(unit: str, positive: bool, range: Range | None) -> dict[str, Any]:
    """What a field says of itself; an angle lies within a turn if no range is given."""
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

    - `default`: the value where the caller gives none; required without it.
    - `unit`: SI unit; shown by `jentry show`, stored in result files, and what a unit
      that a user gives is checked against.
    - `positive`: refuse values that are zero or negative (see `check`).
    - `range`: least and largest value, both allowed, likewise; an angle lies within a
      turn if not given.
    - `choice`: it only chooses something, as the seed of noise does: its size means
      nothing, and a flight has no derivative by it.
    """
    given = {} if default is MISSING else {"default": default}
    metadata = {**_about(unit, positive, range), **({"choice": True} if choice else {})}
    return eqx.field(converter=as_float_array, metadata=metadata, **given)


def optional_scalar(*, unit: str = "1", range: Range | None = None) -> Any:
    """A physical number that may be none, and then is no leaf."""

    def convert(value: Any) -> Any:
        return None if value is None else as_float_array(value)

    metadata = _about(unit, False, range)
    return eqx.field(converter=convert, metadata=metadata, default=None)


def output(*, unit: str = "1", default: Any = MISSING) -> Any:
    """A number that a flight gives, of any shape, with its SI unit.

    Its name and its unit are those of tables, results, figures and of `jentry tune`.
    """
    given = {} if default is MISSING else {"default": default}
    return eqx.field(metadata={"unit": unit}, **given)


Getter = TypeVar("Getter", bound=Callable)


def in_unit(unit: str) -> Callable[[Getter], Getter]:
    """The unit of a number that is a property, and so has no field to state it.

    @property
    @in_unit("m")
    def distance(self): ...
    """

    def marked(getter: Getter) -> Getter:
        getter.unit = unit  # pyright: ignore[reportFunctionMemberAccess]
        return getter

    return marked


def units_of(kind: type) -> dict[str, str]:
    """SI units of the numbers of a class by name: of its fields, then its properties."""
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
    """An array of physical numbers: one leaf.

    `positive` and `increasing` refuse other values (see `check`).
    """
    metadata = _about(unit, positive, None) | {"increasing": increasing}
    return eqx.field(converter=as_float_array, metadata=metadata)
