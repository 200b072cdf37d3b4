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
        return jnp.clip(self.start + self.scale * free, self.least, self.largest)


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


def map_of(
    address: str, leaf: Array, metadata: Mapping[str, Any], given: Bounds | Scale | None
) -> AbstractMap:
    """The map of a leaf that starts where it is; raises `ValueError` if it cannot be.

    A leaf with bounds stays between them, one that must be positive stays so, and any
    other moves by a scale, or by its root mean square.
    """
    if given is not None and not isinstance(given, Bounds | Scale):
        raise ValueError(
            f"the range of {address} is {given!r}: give Bounds(lower, upper) or "
            "Scale(size)"
        )
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
                f'ranges={{"{address}": Scale(...)}}, in its unit, or Bounds(...)'
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


def _between(address: str, start: Array, bounds: Bounds, positive: bool) -> Between:
    lower, upper = bounds.lower, bounds.upper
    try:
        low, high = (
            np.broadcast_to(np.asarray(x, float), start.shape) for x in (lower, upper)
        )
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the bounds of {address} are {lower} and {upper}: give each as "
            f"a number or of the shape {start.shape}"
        ) from error
    within = np.all((low < np.asarray(start)) & (np.asarray(start) < high))
    if not within or not np.all(np.isfinite([low, high])):
        raise ValueError(
            f"the bounds of {address} are {lower} and {upper}: they must be finite and "
            f"on both sides of its value, which is {np.asarray(start)}"
        )
    if positive and not np.all(low > 0.0):
        raise ValueError(
            f"the lower bound of {address} is {lower}: it must be above zero, since the "
            "number must be positive"
        )
    return Between(start, low, high)
