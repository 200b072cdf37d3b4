"""Smooth maps from free numbers to a leaf's values, which keep it where it may be."""

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fields import as_float_array
from ..flight.scenario import check_values


@dataclasses.dataclass(frozen=True)
class Bounds:
    """A tuned leaf stays between two values, each a number or of the leaf's shape."""

    lower: Any
    upper: Any


@dataclasses.dataclass(frozen=True)
class Scale:
    """How much of a tuned leaf counts as much as a factor e of a positive one.

    It takes the place of the leaf's own size, which tells nothing of one that is zero.
    """

    size: Any
    """A number, or of the leaf's shape; in the unit of the leaf"""


Ranges = Mapping[str, Bounds | Scale]
"""By address"""


class AbstractMap(eqx.Module):
    """From free numbers, of any size, to values that are allowed. Zero is the start."""

    start: eqx.AbstractVar[Array]

    @abstractmethod
    def __call__(self, free: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The value."""


_LARGEST = 500.0
"""Of a logarithm: beyond it a positive number would be zero or infinite in the end"""


class Positive(AbstractMap):
    """value = start exp(free): a step of 0.1 changes it by a tenth."""

    start: Array = eqx.field(converter=as_float_array)

    def __call__(self, free):
        return self.start * jnp.exp(jnp.clip(free, -_LARGEST, _LARGEST))


class Unbounded(AbstractMap):
    """value = start + scale free, held within the range of its field, if it has one."""

    start: Array = eqx.field(converter=as_float_array)
    scale: Array = eqx.field(converter=as_float_array)
    least: float = eqx.field(default=-np.inf, static=True)
    largest: float = eqx.field(default=np.inf, static=True)

    def __call__(self, free):
        value = self.start + self.scale * free
        # Not `clip`, which has half the derivative where a number starts at an end.
        value = jnp.where(value < self.least, self.least, value)
        return jnp.where(value > self.largest, self.largest, value)


class Between(AbstractMap):
    """A logistic curve between two bounds, of which the middle is steepest."""

    start: Array = eqx.field(converter=as_float_array)
    lower: Array = eqx.field(converter=as_float_array)
    upper: Array = eqx.field(converter=as_float_array)

    def __call__(self, free):
        width = self.upper - self.lower
        share = (self.start - self.lower) / width
        share = jax.nn.sigmoid(jax.scipy.special.logit(share) + free)
        return jnp.clip(self.lower + width * share, self.lower, self.upper)


class Linear(AbstractMap):
    """value = start + scale free; whoever moves it keeps it between the bounds."""

    start: Array = eqx.field(converter=as_float_array)
    scale: Array = eqx.field(converter=as_float_array)
    lower: Array = eqx.field(converter=as_float_array)
    """Infinite where there is none"""
    upper: Array = eqx.field(converter=as_float_array)

    def __call__(self, free):
        return self.start + self.scale * free


def linear_map_of(
    address: str, leaf: Array, metadata: Mapping[str, Any], given: Bounds | Scale | None
) -> Linear:
    """The linear map of a leaf, for a method that keeps bounds itself.

    The scale is a quarter of the way between the bounds, or that of `map_of`. A number
    that must be positive keeps at least a millionth of its size. Raises `ValueError` for
    a leaf that starts beyond its bounds.
    """
    least, largest = metadata.get("range") or (-np.inf, np.inf)
    lower = 1e-6 * leaf if metadata.get("positive") else jnp.full_like(leaf, least)
    upper = jnp.full_like(leaf, largest)
    if not isinstance(given, Bounds):
        if given is not None and not isinstance(given, Scale):
            raise ValueError(_no_range(address, given))
        return Linear(leaf, _scale(address, leaf, given), lower, upper)
    low, high = _bounds(address, leaf, given)
    for bound in (low, high):
        check_values(f"a bound of {address}", bound, metadata)
    if not np.all((low <= leaf) & (leaf <= high) & (low < high)):
        raise ValueError(_not_between(address, leaf, given))
    return Linear(leaf, 0.25 * (high - low), low, high)


def map_of(
    address: str, leaf: Array, metadata: Mapping[str, Any], given: Bounds | Scale | None
) -> AbstractMap:
    """The map of a leaf that starts where it is; raises `ValueError` if it cannot be.

    A leaf with bounds stays between them, one that must be positive stays so, and any
    other moves by a scale, or by its root mean square.
    """
    if given is not None and not isinstance(given, Bounds | Scale):
        raise ValueError(_no_range(address, given))
    positive = metadata.get("positive", False)
    if isinstance(given, Bounds):
        between = _between(address, leaf, given, positive)
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
                f"{address} is 0, which does not tell how much of it is a lot: give "
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


def _between(address: str, leaf: Array, bounds: Bounds, positive: bool) -> Between:
    low, high = _bounds(address, leaf, bounds)
    if not np.all((low < np.asarray(leaf)) & (np.asarray(leaf) < high)):
        raise ValueError(_not_between(address, leaf, bounds))
    if positive and not np.all(low > 0.0):
        raise ValueError(
            f"the lower bound of {address} is {bounds.lower}: it must be above zero, since "
            "the number must be positive"
        )
    return Between(leaf, low, high)


def _bounds(address: str, leaf: Array, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Both of the shape of the leaf; raises `ValueError` if they are not, or infinite."""
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
        raise ValueError(_not_between(address, leaf, bounds))
    return low, high


def _not_between(address: str, leaf: Array, bounds: Bounds) -> str:
    return (
        f"the bounds of {address} are {bounds.lower} and {bounds.upper}: they must be "
        f"finite and on both sides of its value, which is {np.asarray(leaf)}"
    )


def _no_range(address: str, given: Any) -> str:
    return (
        f"the range of {address} is {given!r}: give Bounds(lower, upper) or Scale(size)"
    )
