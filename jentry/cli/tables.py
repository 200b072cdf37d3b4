"""Tables on the terminal: columns and titles."""

import sys

import numpy as np
from rich.console import Console
from rich.table import Table


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


def in_digits(number: float, sign: str = "") -> str:
    """To four decimals, or fewer digits of a small number; - for no number."""
    if np.isnan(number):
        return "-"
    if 0.0 < abs(number) < 5e-5:
        return f"{number:{sign}.1e}"
    few = 0.0 < abs(number) < 0.01
    return f"{number:{sign}#.3g}" if few else f"{number:{sign}z.4f}"
