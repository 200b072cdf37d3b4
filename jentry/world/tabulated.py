"""Tables: their edges, and excursions of a flight beyond them."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu

from ..addresses import address_of
from ..fields import Flag, Scalar


UNITS = {"altitudes": "m", "mach_numbers": "1", "angles_of_attack": "rad"}
"""SI units of the independent variables of tables"""

_ROUNDING = 1e-9
"""Share of the range of a table by which rounding may place a value beyond its edge"""

Edges = Mapping[str, tuple[Scalar, Scalar]]
"""First and last value of each independent variable of a table, by name"""


class AbstractTabulated(eqx.Module):
    """A model of air or aerodynamics with data only between the edges of a table.

    Beyond an edge the model extrapolates by some rule, without data. Each flight reports
    the share of its time there as a caveat, and the largest distance from the edge
    (`Flight.beyond_tables`). With `refuse_beyond` the flight ends at the edge instead, with
    `Outcome.BEYOND_TABLE`. Your own model inherits from this class in addition to the class
    of the model, and defines `edges`.
    """

    refuse_beyond: bool = eqx.field(default=False, static=True, kw_only=True)
    """Whether a flight ends at an edge instead of continuing beyond it"""

    @abstractmethod
    def edges(self) -> Edges:
        """First and last value of each independent variable of the table, by name.

        The names are `altitudes` (m), `mach_numbers` and `angles_of_attack` (rad).
        """


def tables_in(**models: Any) -> dict[str, AbstractTabulated]:
    """The tables of models, such as those of a planet, by address."""

    def is_table(node: Any) -> bool:
        return isinstance(node, AbstractTabulated)

    nodes, _ = jtu.tree_flatten_with_path(models, is_leaf=is_table)
    return {address_of(path): node for path, node in nodes if is_table(node)}


class Excursion(eqx.Module):
    """Time of a flight beyond an edge of a table, and its largest distance from it."""

    time: Scalar
    """Time beyond the edge, s"""
    distance: Scalar
    """Largest distance from the edge, in the unit of the independent variable"""


def beyond_edges(
    tables: Mapping[str, AbstractTabulated], **values: Scalar
) -> tuple[dict[str, Scalar], Flag]:
    """Distances of values beyond the edges of tables, and whether a table refuses them.

    The distances are by the name of their caveat, and zero within a table.
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
    """Name of the caveat that is the share of time of a flight beyond a table.

    The name does not depend on whether the table is the `undisturbed` part of another
    atmosphere or stands alone, as it does after `without_zero_perturbations`.
    """
    steps = [step for step in address.split(".") if step != "undisturbed"]
    return f"time_beyond_{quantity}_of_{'_'.join(steps)}"


def distance_of(caveat: str) -> str:
    """Name of the largest distance beyond a table, from the name of its caveat."""
    return f"distance_{caveat.removeprefix('time_')}"


def unit_of_caveat(name: str) -> str:
    """Unit of the largest distance beyond a table, from the name of its caveat."""
    for quantity, unit in UNITS.items():
        if name.startswith(f"time_beyond_{quantity}_of_"):
            return unit
    raise ValueError(f"{name} is not the time beyond a table")
