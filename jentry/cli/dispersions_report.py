"""Tables of the dispersions of a command."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..addresses import leaves_by_address
from ..campaign.dispersions import (
    Dispersion,
    add,
    addresses_of_dispersion,
    multiply,
    replace,
    unit_of_draw,
)
from ..campaign.distributions import AbstractDistribution, static_fields
from ..flight.scenario import Scenario
from ..missions.mission import Mission
from .options import dispersions_before
from .overrides import Overrides
from .tables import new_console, new_table, print_under


_LISTED = 6
"""Most numbers of a leaf that are all printed"""

_HOW: dict[Any, str] = {
    replace: "in place of",
    add: "added to",
    multiply: "a factor on",
}


def print_dispersions(
    title: str,
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    before: Mapping[str, Dispersion] | None = None,
) -> None:
    """Print name, distribution, unit and leaves of each dispersion, in SI.

    If `before` is given, a column marks the dispersions that differ from it.
    """
    columns = ["dispersion", "drawn", "unit", "", "leaves"]
    table = new_table(*columns, *([] if before is None else ["--config"]))
    for column in table.columns[3:]:
        column.justify = "left"
    for name, dispersion in dispersions.items():
        addresses = addresses_of_dispersion(scenario, name, dispersion)
        own = getattr(dispersion.apply, "__name__", "")
        cells = [
            name,
            _in_words(dispersion.distribution),
            unit_of_draw(scenario, name, addresses, dispersion.apply),
            _HOW.get(dispersion.apply, own),
            ", ".join(addresses),
        ]
        if before is not None:
            known = before.get(name)
            marked = "added" if known is None else "changed"
            cells.append("" if known is dispersion else marked)
        table.add_row(*cells)
    print_under(new_console(), title, table)


def print_what_is_flown(
    mission: Mission,
    scenario: Scenario,
    overrides: Overrides,
    base: str,
    dispersions: Mapping[str, Dispersion],
) -> None:
    """Print the name of the mission's dispersions, or a table if a file changes some."""
    if overrides.dispersions is None:
        new_console().print(f"dispersions: {base}, see jentry show")
        return
    before = dispersions_before(mission, overrides, base)
    title = f"dispersions: {base}, changed by --config"
    if not before:
        title = "dispersions: of --config alone"
    print_dispersions(title, scenario, dispersions, before)


def _in_words(distribution: AbstractDistribution) -> str:
    numbers = {**static_fields(distribution), **leaves_by_address(distribution)}.items()
    words = [f"{name.replace('_', ' ')} {_listed(x)}" for name, x in numbers]
    kind = type(distribution).__name__
    spaced = "".join(f" {c.lower()}" if c.isupper() else c for c in kind).strip()
    return ", ".join([spaced, *words])


def _listed(numbers: Any) -> str:
    """Text of a number or of a table; a long table is shortened to its ends."""
    flat = [f"{x:.6g}" for x in np.ravel(numbers)]
    return " ".join(flat if len(flat) <= _LISTED else [*flat[:2], "...", flat[-1]])
