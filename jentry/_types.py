"""Array types, and the fields that make every physical number a leaf."""

from dataclasses import MISSING
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


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


def scalar(default: Any = MISSING, *, unit: str = "1", positive: bool = False) -> Any:
    """A physical number: a leaf with a unit that can be dispersed, tuned and swept.

    **Arguments:**

    - `default`: the value where the caller gives none; required without it.
    - `unit`: SI unit, shown by `jentry show` and stored in result files.
    - `positive`: refuse values that are zero or negative (see `check`).
    """
    metadata = {"unit": unit, "positive": positive}
    given = {} if default is MISSING else {"default": default}
    return eqx.field(converter=as_float_array, metadata=metadata, **given)


def optional_scalar(*, unit: str = "1") -> Any:
    """A physical number that may be none, and then is no leaf."""

    def convert(value: Any) -> Any:
        return None if value is None else as_float_array(value)

    metadata = {"unit": unit, "positive": False}
    return eqx.field(converter=convert, metadata=metadata, default=None)


def table(*, unit: str = "1") -> Any:
    """An array of physical numbers: one leaf."""
    return eqx.field(converter=as_float_array, metadata={"unit": unit})
