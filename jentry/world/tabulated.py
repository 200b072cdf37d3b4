"""Tables: where each one ends, and how far beyond it a flight goes."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu

from ..addresses import address_of
from ..fields import Flag, Scalar


UNITS = {"altitudes": "m", "mach_numbers": "1", "angles_of_attack": "rad"}
"""SI units of the quantities over which there are tables"""

_ROUNDING = 1e-9
"""Share of a table by which a value may be beyond its edge that is meant to be at it"""

Edges = Mapping[str, tuple[Scalar, Scalar]]
"""First and last value in a table, by the quantity"""


class AbstractTabulated(eqx.Module):
    """A model of air or aerodynamics that is known between the edges of a table alone.

    Beyond an edge it goes on by a rule of its own, which is no measurement: each flight
    counts the share of its time there as a caveat, and how far it went
    (`Flight.beyond_tables`). With `refuse_beyond` it ends there instead:
    `Outcome.BEYOND_TABLE`. A model of one's own inherits this class beside its own one and
    states both.
    """

    refuse_beyond: bool = eqx.field(default=False, static=True, kw_only=True)
    """End a flight at an edge, in place of going on beyond it"""

    @abstractmethod
    def edges(self) -> Edges:
        """First and last value of each quantity of the table.

        The quantities are `altitudes` (m), `mach_numbers` and `angles_of_attack` (rad).
        """


def tables_in(**models: Any) -> dict[str, AbstractTabulated]:
    """The tables within models, such as a planet, by address."""

    def is_table(node: Any) -> bool:
        return isinstance(node, AbstractTabulated)

    nodes, _ = jtu.tree_flatten_with_path(models, is_leaf=is_table)
    return {address_of(path): node for path, node in nodes if is_table(node)}


class Excursion(eqx.Module):
    """How long and how far a flight was beyond an edge of a table."""

    time: Scalar
    """s"""
    distance: Scalar
    """Largest distance from the edge, in the unit of the quantity"""


def beyond_edges(
    tables: Mapping[str, AbstractTabulated], **values: Scalar
) -> tuple[dict[str, Scalar], Flag]:
    """How far values of the quantities are beyond the edges of tables, zero within.

    By the name of the caveat that says so. Second, whether a table refuses the values.
    """
    found: dict[str, Scalar] = {}
    refused: Flag = jnp.asarray(False)
    for address, table in tables.items():
        for quantity, (first, last) in table.edges().items():
            value = values[quantity]
            beyond = jnp.maximum(first - value, value - last)
            beyond = jnp.where(beyond > _ROUNDING * (last - first), beyond, 0.0)
            found[caveat_of(address, quantity)] = beyond
            if table.refuse_beyond:
                refused = refused | (beyond > 0.0)
    return found, refused


def caveat_of(address: str, quantity: str) -> str:
    """Name of the share of time that a flight is beyond a table.

    It is the same whether the table stands in other air, `undisturbed`, or by itself, as
    where that air has no departures (`without_zero_departures`).
    """
    steps = [step for step in address.split(".") if step != "undisturbed"]
    return f"time_beyond_{quantity}_of_{'_'.join(steps)}"


def distance_of(caveat: str) -> str:
    """Name of the largest distance that belongs to a share of time beyond a table."""
    return f"distance_{caveat.removeprefix('time_')}"


def unit_of_caveat(name: str) -> str:
    """Unit of the distance that belongs to a share of time beyond a table."""
    for quantity, unit in UNITS.items():
        if name.startswith(f"time_beyond_{quantity}_of_"):
            return unit
    raise ValueError(f"{name} is not the time beyond a table")
