"""What is tuned: leaves of a scenario, and the smooth maps that keep them in bounds."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..addresses import addresses_of, field_metadata, leaves_by_address, nearest
from ..fields import as_float_array
from ..flight.scenario import Scenario, check_values, require_effect


Free = dict[str, Array]
"""Free numbers by the addresses of their leaves: all of them zero at the start"""

Bounds = Mapping[str, tuple[Any, Any]]
"""Lower and upper bound by address"""

Scales = Mapping[str, Any]
"""By address, what a free number of one adds to a leaf"""

_NEXT_TO_A_BOUND = 1e-3
"""Of the interval between the bounds: there a leaf moves by less than a thousandth of it
for a free number of one"""


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


class Parameters(eqx.Module):
    """The tuned leaves by their addresses, each with its map."""

    maps: dict[str, AbstractMap]

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        where: Callable[[Any], Any],
        bounds: Bounds | None,
        scales: Scales | None = None,
    ) -> "Parameters":
        """Of the leaves that a lens reaches; raises `ValueError` if that cannot be tuned.

        Leaves with bounds stay between them, leaves that must be positive stay so, and
        all others are free: they move by a scale, or by their root mean square.
        """
        leaves = leaves_by_address(scenario)
        bounds, scales = dict(bounds or {}), dict(scales or {})
        maps: dict[str, AbstractMap] = {}
        try:
            # A leaf that the lens reaches twice is one parameter.
            reached = list(dict.fromkeys(addresses_of(scenario, where)))
        except (AttributeError, KeyError, IndexError, TypeError) as error:
            raise ValueError(f"the lens of what to tune: {error}") from error
        for address in reached:
            require_effect(scenario, address)
            leaf, metadata = leaves[address], field_metadata(scenario, address)
            if not jnp.issubdtype(leaf.dtype, jnp.inexact):
                raise ValueError(
                    f"{address} is of type {leaf.dtype}: it has no gradient"
                )
            check_values(address, np.asarray(leaf), metadata)
            positive = metadata.get("positive", False)
            if address in scales and (address in bounds or positive):
                has = "has bounds" if address in bounds else "must be positive"
                raise ValueError(
                    f"{address} {has}, from which its scale follows: leave the scale out"
                )
            if address in bounds:
                between = _between(address, leaf, bounds.pop(address), positive)
                for bound in (between.lower, between.upper):
                    check_values(f"a bound of {address}", np.asarray(bound), metadata)
                maps[address] = between
            elif positive:
                maps[address] = Positive(leaf)
            else:
                scale = scales.pop(address, None)
                least, largest = metadata.get("range") or (-np.inf, np.inf)
                scale = _scale(address, leaf, scale)
                maps[address] = Unbounded(leaf, scale, least, largest)
        for what, others in (("bounds", bounds), ("a scale", scales)):
            for address in others:
                raise ValueError(
                    f"{address} has {what} and is not tuned; {nearest(address, maps)}"
                )
        return cls(maps)

    @property
    def addresses(self) -> list[str]:
        return list(self.maps)

    @property
    def count(self) -> int:
        """Of single numbers"""
        return sum(free.size for free in self.start().values())

    def start(self) -> Free:
        """The free numbers of the scenario as it was given."""
        return {address: jnp.zeros_like(m.start) for address, m in self.maps.items()}

    def near_bounds(self) -> list[str]:
        """A sentence for each leaf that starts so near to a bound that it hardly moves."""
        found = []
        for address, value in self.maps.items():
            if isinstance(value, Between):
                share = (value.start - value.lower) / (value.upper - value.lower)
                nearest_share = float(jnp.min(jnp.minimum(share, 1.0 - share)))
                if nearest_share < _NEXT_TO_A_BOUND:
                    found.append(
                        f"{address} starts within {100.0 * nearest_share:.2g} % of one of "
                        "its bounds, where it hardly moves: set the bound farther off, "
                        "or start farther inside"
                    )
        return found

    def values(self, free: Free) -> dict[str, Array]:
        """The values of the leaves."""
        return {address: value(free[address]) for address, value in self.maps.items()}


def _scale(address: str, start: Array, given: Any) -> Array:
    if given is None:
        scale = jnp.sqrt(jnp.mean(start**2))
        if not scale > 0.0:
            raise ValueError(
                f"{address} is 0, which does not tell how much of it is a lot: give "
                f'scales={{"{address}": ...}}, in its unit, or bounds'
            )
        return jnp.broadcast_to(scale, start.shape)
    try:
        scale = np.broadcast_to(np.asarray(given, float), start.shape)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the scale of {address} is {given}: give a number, or an array of the shape "
            f"{start.shape}"
        ) from error
    if not np.all((scale > 0.0) & np.isfinite(scale)):
        raise ValueError(
            f"the scale of {address} is {given}: it must be finite and above zero"
        )
    return jnp.asarray(scale)


def _between(
    address: str, start: Array, bounds: tuple[Any, Any], positive: bool
) -> Between:
    try:
        lower, upper = bounds
        low, high = (np.broadcast_to(np.asarray(x, float), start.shape) for x in bounds)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the bounds of {address} are {bounds}: give a lower and an upper one, each "
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
