"""Smooth maps from free numbers to the values of a leaf, within its allowed range."""

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._printed import quantity_in_words
from ..fields import as_float_array, check_values


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Bounds of a tuned leaf: two values, each a number or of the shape of the leaf."""

    lower: Any
    upper: Any


@dataclasses.dataclass(frozen=True)
class Scale:
    """Scale of a tuned leaf: the change that corresponds to a free number of one.

    It replaces the size of the leaf itself, which is no scale for a leaf that is zero. For
    a positive leaf a free number of one corresponds to a factor e.
    """

    size: Any
    """A number, or an array of the shape of the leaf, in the unit of the leaf"""


Ranges = Mapping[str, Bounds | Scale]
"""Bounds and scales by address"""


class AbstractMap(eqx.Module):
    """Map from free numbers of any size to allowed values. Zero maps to the start."""

    start: eqx.AbstractVar[Array]

    @abstractmethod
    def __call__(self, free: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The value."""


_LARGEST = 500.0
"""Limit of a logarithm, so that a positive number becomes neither zero nor infinite"""


class Positive(AbstractMap):
    """value = start exp(free): a step of 0.1 changes the value by about a tenth."""

    start: Array = eqx.field(converter=as_float_array)

    def __call__(self, free):
        return self.start * jnp.exp(jnp.clip(free, -_LARGEST, _LARGEST))


class Unbounded(AbstractMap):
    """value = start + scale free, clipped to the range of its field, if there is one."""

    start: Array = eqx.field(converter=as_float_array)
    scale: Array = eqx.field(converter=as_float_array)
    least: float = eqx.field(default=-np.inf, static=True)
    largest: float = eqx.field(default=np.inf, static=True)

    def __call__(self, free):
        value = self.start + self.scale * free
        # Not `clip`: at an end of the range it has half the derivative.
        value = jnp.where(value < self.least, self.least, value)
        return jnp.where(value > self.largest, self.largest, value)


class Between(AbstractMap):
    """A logistic curve between two bounds. It is steepest in the middle."""

    start: Array = eqx.field(converter=as_float_array)
    lower: Array = eqx.field(converter=as_float_array)
    upper: Array = eqx.field(converter=as_float_array)

    def __call__(self, free):
        width = self.upper - self.lower
        share = (self.start - self.lower) / width
        share = jax.nn.sigmoid(jax.scipy.special.logit(share) + free)
        return jnp.clip(self.lower + width * share, self.lower, self.upper)


class Linear(AbstractMap):
    """value = start + scale free. The method that changes it must enforce the bounds."""

    start: Array = eqx.field(converter=as_float_array)
    scale: Array = eqx.field(converter=as_float_array)
    lower: Array = eqx.field(converter=as_float_array)
    """Lower bound, minus infinity if there is none; likewise for `upper`"""
    upper: Array = eqx.field(converter=as_float_array)

    def __call__(self, free):
        return self.start + self.scale * free


def linear_map_of(
    address: str, leaf: Array, metadata: Mapping[str, Any], given: Bounds | Scale | None
) -> Linear:
    """The linear map of a leaf, for a method that enforces bounds itself.

    The scale is a quarter of the distance between the bounds, or else that of `map_of`. The
    lower bound of a number that must be positive is a millionth of its value.

    **Raises:** `ValueError` for a leaf that starts outside its bounds.
    """
    least, largest = metadata.get("range") or (-np.inf, np.inf)
    lower = 1e-6 * leaf if metadata.get("positive") else jnp.full_like(leaf, least)
    upper = jnp.full_like(leaf, largest)
    if not isinstance(given, Bounds):
        if given is not None and not isinstance(given, Scale):
            raise ValueError(_no_range(address, given))
        return Linear(leaf, _scale(address, leaf, given), lower, upper)
    unit = metadata.get("unit", "1")
    low, high = _bounds(address, leaf, given, unit)
    for bound in (low, high):
        check_values(f"a bound of {address}", bound, metadata)
    if not np.all((low <= leaf) & (leaf <= high) & (low < high)):
        raise ValueError(_not_between(address, leaf, given, unit))
    return Linear(leaf, 0.25 * (high - low), low, high)


def map_of(
    address: str, leaf: Array, metadata: Mapping[str, Any], given: Bounds | Scale | None
) -> AbstractMap:
    """The map of a leaf, which starts at its present value.

    A leaf with bounds stays between them. A leaf that must be positive stays positive. The
    scale of any other leaf is its `Scale`, or its root mean square.

    **Raises:** `ValueError` if the range does not fit the leaf.
    """
    if given is not None and not isinstance(given, Bounds | Scale):
        raise ValueError(_no_range(address, given))
    positive = metadata.get("positive", False)
    if isinstance(given, Bounds):
        between = _between(address, leaf, given, metadata)
        for bound in (between.lower, between.upper):
            check_values(f"a bound of {address}", np.asarray(bound), metadata)
        return between
    if positive and given is not None:
        raise ValueError(
            f"{address} must be positive, from which its scale follows: leave the scale "
            "out"
        )
    if positive:
        return Positive(leaf)
    least, largest = metadata.get("range") or (-np.inf, np.inf)
    return Unbounded(leaf, _scale(address, leaf, given), least, largest)


def _scale(address: str, start: Array, given: Scale | None) -> Array:
    if given is None:
        scale = jnp.sqrt(jnp.mean(start**2))
        if not scale > 0.0:
            raise ValueError(
                f"{address} is 0, from which no scale follows: give "
                f'ranges={{"{address}": Scale(...)}}, in its unit, or Bounds(...); to a '
                "command --scale or --bounds"
            )
        return jnp.broadcast_to(scale, start.shape)
    try:
        scale = np.broadcast_to(np.asarray(given.size, float), start.shape)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the scale of {address} is {given.size}: give a number, or an array of the "
            f"shape {start.shape}"
        ) from error
    if not np.all((scale > 0.0) & np.isfinite(scale)):
        raise ValueError(
            f"the scale of {address} is {given.size}: it must be finite and above zero"
        )
    return jnp.asarray(scale)


def _between(
    address: str, leaf: Array, bounds: Bounds, metadata: Mapping[str, Any]
) -> Between:
    unit = metadata.get("unit", "1")
    low, high = _bounds(address, leaf, bounds, unit)
    if not np.all((low < np.asarray(leaf)) & (np.asarray(leaf) < high)):
        raise ValueError(_not_between(address, leaf, bounds, unit))
    if metadata.get("positive", False) and not np.all(low > 0.0):
        raise ValueError(
            f"the lower bound of {address} is {bounds.lower}: it must be above zero, since "
            "the number must be positive"
        )
    return Between(leaf, low, high)


def _bounds(
    address: str, leaf: Array, bounds: Bounds, unit: str
) -> tuple[np.ndarray, np.ndarray]:
    """Both bounds in the shape of the leaf.

    **Raises:** `ValueError` if a bound does not have this shape or is not finite.
    """
    lower, upper = bounds.lower, bounds.upper
    try:
        low, high = (
            np.broadcast_to(np.asarray(x, float), leaf.shape) for x in (lower, upper)
        )
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the bounds of {address} are {lower} and {upper}: give each as "
            f"a number or of the shape {leaf.shape}"
        ) from error
    if not np.all(np.isfinite([low, high])):
        raise ValueError(_not_between(address, leaf, bounds, unit))
    return low, high


def _not_between(address: str, leaf: Array, bounds: Bounds, unit: str) -> str:
    lower, upper, value = (
        quantity_in_words(np.asarray(x, float), unit)
        for x in (bounds.lower, bounds.upper, leaf)
    )
    return (
        f"the bounds of {address} are {lower} and {upper}: they must be finite and on both "
        f"sides of its value, which is {value}"
    )


def _no_range(address: str, given: Any) -> str:
    return (
        f"the range of {address} is {given!r}: give Bounds(lower, upper) or Scale(size)"
    )
