"""Parameters of a search: leaves of a pytree, from which a scenario is built."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from .._dependence import Traced
from .._programs import cached
from ..addresses import (
    addresses_of,
    field_metadata,
    leaves_by_address,
    nearest,
    replace_leaves,
    with_leaves,
)
from ..fields import check_values
from ..flight.duplicate_numbers import require_both
from ..flight.scenario import Scenario
from ..flight.scenario_checks import require_effect
from .maps import AbstractMap, Between, Ranges, map_of


Free = dict[str, Array]
"""Free numbers by the addresses of their leaves. All are zero at the start"""

Build = Callable[[Any], Scenario]
"""Function from a pytree of parameters to the scenario"""

_NEXT_TO_A_BOUND = 1e-3
"""Share of the interval between two bounds. A leaf that is closer to a bound changes by
less than about a thousandth of the interval for a free number of one"""


def itself(start: Any) -> Any:
    """Return the scenario unchanged: the build for parameters that are its own leaves."""
    return start


class Parameters(eqx.Module):
    """Leaves that a search varies, with their maps and the scenario built from them."""

    start: PyTree
    """Pytree with the leaves: a scenario, or numbers from which a scenario is built"""
    maps: dict[str, AbstractMap]
    """Maps of the leaves by their addresses in `start`"""
    build: Build
    moved: tuple[str, ...] = eqx.field(static=True)
    """Addresses of the leaves of the scenario that depend on the parameters"""

    @classmethod
    def of(
        cls,
        start: PyTree,
        where: Callable[[Any], Any] | None = None,
        ranges: Ranges | None = None,
        build: Build = itself,
        as_map: Callable[..., AbstractMap] = map_of,
    ) -> "Parameters":
        """Parameters for the leaves that a lens selects, or for all leaves; see `tune`.

        `as_map` returns the map of a leaf, as `map_of` does.

        **Raises:** `ValueError` for leaves that cannot be tuned.
        """
        start = _with_arrays(start)
        leaves, ranges = leaves_by_address(start), dict(ranges or {})
        if "" in leaves:
            raise ValueError(
                "the parameters are one array without a name: give it a name, as in "
                '{"curvature": ...}'
            )
        try:
            # A leaf that the lens selects twice is one parameter.
            addresses = list(dict.fromkeys(addresses_of(start, where or itself)))
        except (AttributeError, KeyError, IndexError, TypeError) as error:
            raise ValueError(f"the lens of what to tune: {error}") from error
        maps: dict[str, AbstractMap] = {}
        for address in addresses:
            if isinstance(start, Scenario):
                require_effect(start, address)
            leaf, metadata = leaves[address], field_metadata(start, address)
            if not jnp.issubdtype(leaf.dtype, jnp.inexact):
                raise ValueError(
                    f"{address} is of type {leaf.dtype}: it has no gradient"
                )
            check_values(address, np.asarray(leaf), metadata)
            maps[address] = as_map(address, leaf, metadata, ranges.pop(address, None))
        if isinstance(start, Scenario) and where is not None and build is itself:
            require_both(start, addresses)
        for address, given in ranges.items():
            raise ValueError(
                f"{address} has a {type(given).__name__} and is not tuned; "
                f"{nearest(address, maps)}"
            )
        return _of_maps(start, maps, build)

    @property
    def addresses(self) -> list[str]:
        return list(self.maps)

    @property
    def count(self) -> int:
        """How many single numbers are varied."""
        return sum(m.start.size for m in self.maps.values())

    @property
    def at_start(self) -> dict[str, Array]:
        """The values of the leaves at the start."""
        return {address: m.start for address, m in self.maps.items()}

    def zeros(self) -> Free:
        """The free numbers of the start."""
        return {address: jnp.zeros_like(m.start) for address, m in self.maps.items()}

    def near_bounds(self) -> list[str]:
        """Warnings for leaves that start so close to a bound that they hardly change."""
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
        """The values of the leaves at a point."""
        return {address: value(free[address]) for address, value in self.maps.items()}

    def scenario(self, free: Free) -> Scenario:
        """The scenario at a point."""
        return self.scenario_of(self.values(free))

    def scenario_of(self, values: dict[str, Any]) -> Scenario:
        """The scenario with these values of the leaves."""
        built = self.build(replace_leaves(self.start, values))
        if not isinstance(built, Scenario):
            raise ValueError(
                f"the scenario is a {type(built).__name__}: give a Scenario, or a function "
                "that builds one, build(parameters) -> Scenario"
            )
        return with_leaves(built)

    def followed_by(self, change: Callable[[Scenario], Scenario]) -> "Parameters":
        """These parameters with a scenario that is changed after it is built."""
        return _of_maps(self.start, self.maps, Changed(self.build, change))

    def about(self, free: Free) -> "Parameters | Tangent":
        """Parameters with the same scenario and the same first derivatives at a point.

        A build may cost as much as many flights. It is therefore differentiated once, and
        not again for each flight.
        """
        if self.build is itself:
            return self
        return _tangent(self, free)


def _of_maps(start: PyTree, maps: dict[str, AbstractMap], build: Build) -> Parameters:
    moved = _moved(Parameters(start, maps, build, ()))
    if not moved:
        raise ValueError(
            "no number of the scenario depends on the parameters: build must use them"
        )
    return Parameters(start, maps, build, moved)


class Changed(eqx.Module):
    """A build that is followed by a change of the scenario."""

    build: Build
    change: Callable[[Scenario], Scenario]

    def __call__(self, parameters: PyTree) -> Scenario:
        return self.change(self.build(parameters))


class Tangent(eqx.Module):
    """Parameters linearized about a point: the scenario is linear in the free numbers."""

    at: Scenario
    """Scenario at the point"""
    free: Free
    slopes: dict[str, Free]
    """Derivatives of each dependent leaf of the scenario with respect to each parameter.
    Their shape is that of the leaf followed by that of the parameter"""

    def scenario(self, free: Free) -> Scenario:
        """The scenario with these free numbers, to first order."""
        leaves = leaves_by_address(self.at)
        moves = {a: x - self.free[a] for a, x in free.items()}

        def moved(address: str) -> Array:
            value = leaves[address]
            for parameter, slope in self.slopes[address].items():
                move = moves[parameter]
                value = value + jnp.tensordot(slope, move, move.ndim)
            return value

        return replace_leaves(self.at, {a: moved(a) for a in self.slopes})


@cached
def _tangent(parameters: Parameters, free: Free) -> Tangent:
    def moved(free: Free) -> dict[str, Array]:
        leaves = leaves_by_address(parameters.scenario(free))
        return {
            a: leaves[a]
            for a in parameters.moved
            if jnp.issubdtype(leaves[a].dtype, jnp.inexact)
        }

    return Tangent(parameters.scenario(free), free, jax.jacfwd(moved)(free))


def scenario_at(parameters: Parameters, values: dict[str, Any]) -> Scenario:
    """The scenario with these values of the leaves. A build is compiled."""
    if parameters.build is itself:
        return parameters.scenario_of(values)
    return _built(parameters, {a: jnp.asarray(x) for a, x in values.items()})


@cached
def _built(parameters: Parameters, values: dict[str, Array]) -> Scenario:
    return parameters.scenario_of(values)


def _moved(parameters: Parameters) -> tuple[str, ...]:
    """Addresses of the leaves of the scenario that depend on the parameters."""

    def leaves(free: Free) -> dict[str, Array]:
        return leaves_by_address(parameters.scenario(free))

    try:
        depends = Traced(leaves, parameters.zeros()).depending()
    except (
        jax.errors.ConcretizationTypeError,
        jax.errors.TracerArrayConversionError,
    ) as e:
        raise ValueError(
            "build needs the values of the parameters, which have none while JAX traces "
            f"it: compute with jax.numpy, without float() or if. JAX says: {e}"
        ) from e
    return tuple(address for address, does in depends.items() if does)


def _with_arrays(start: PyTree) -> PyTree:
    """The start with its numbers as arrays: fields of a scenario, or else all floats."""
    if isinstance(start, Scenario):
        return with_leaves(start)

    def leaf(x: Any) -> Any:
        return jnp.asarray(x, float) if isinstance(x, float | np.floating) else x

    return jax.tree.map(leaf, start)
