"""Tables on the terminal: units at the edge, columns, titles."""

import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from ..addresses import unit_of
from ..units import degree, km


_EDGE_UNITS = {"m": (km, "km"), "rad": (degree, "deg"), "Pa": (1e3, "kPa")}
_EDGE_UNITS |= {"W/m2": (1e4, "W/cm2")}


def new_console() -> Console:
    # A name with brackets or colons is not markup.
    width = None if sys.stdout.isatty() else 130
    return Console(width=width, highlight=False, markup=False, emoji=False)


def new_table(*columns: str) -> Table:
    table = Table()
    table.add_column(columns[0], no_wrap=True)
    for column in columns[1:]:
        table.add_column(column, justify="right")
    return table


def print_under(console: Console, title: str, table: Table) -> None:
    """A table under its title, which may be wider."""
    console.print(title, style="bold", markup=False)
    console.print(table)


_SHORT = 10.0
"""m; lengths that are all below it are shown in metres"""


def at_edge(values, unit: str):
    """Values in the unit that they are shown in, and that unit."""
    if unit == "m" and np.all(np.abs(values) < _SHORT):
        return np.asarray(values), unit
    factor, edge_unit = _EDGE_UNITS.get(unit, (1.0, unit))
    return np.asarray(values) / factor, edge_unit


_OTHER_UNITS = {
    "downrange": "m",
    "crossrange": "m",
    "altitude": "m",
    "velocity": "m/s",
    "flight_path_angle": "rad",
    "heading": "rad",
}


def unit_of_output(described, name: str) -> str:
    """Unit of an output of a flight; `described` has it in its fields, if it is given."""
    unit = "1" if described is None else unit_of(described, name)
    return _OTHER_UNITS.get(name, unit) if unit == "1" else unit
