"""Tables on the terminal: columns and titles."""

import sys
from collections.abc import Iterable, Sequence

import numpy as np
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table


_LEAST_WIDTH = 130
"""Least width of output that is not a terminal; a wider table keeps its width there"""


def new_console() -> Console:
    # Names may contain brackets or colons: do not take them for markup.
    width = None if sys.stdout.isatty() else _LEAST_WIDTH
    return Console(width=width, highlight=False, markup=False, emoji=False)


def new_table(*columns: str) -> Table:
    table = Table()
    table.add_column(columns[0], no_wrap=True)
    for column in columns[1:]:
        # A number that is too long for its column continues in the next line.
        table.add_column(column, justify="right", overflow="fold")
    return table


def print_under(console: Console, title: str, table: Table) -> None:
    """Print a table under its title, which may be wider. In a file nothing is folded."""
    console.print(title, style="bold", markup=False)
    if not console.is_terminal:
        endless = console.options.update(max_width=10**6)
        needed = Measurement.get(console, endless, table).maximum
        console.width = max(console.width, needed)
    console.print(table)


def print_in_pieces(
    console: Console,
    title: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    repeated: int = 1,
) -> None:
    """Print a table under its title; on a narrow terminal, as several tables.

    Each table has the first `repeated` columns and some of the others.
    """
    rows = list(rows)
    widths = [
        3 + max(map(len, (*head.split("\n"), *(row[i] for row in rows))))
        for i, head in enumerate(heads)
    ]
    first = list(range(repeated))
    space = console.width - 1 - sum(widths[:repeated])
    pieces: list[list[int]] = [[]]
    for column in range(repeated, len(heads)):
        used = sum(widths[i] for i in pieces[-1])
        if console.is_terminal and pieces[-1] and used + widths[column] > space:
            pieces.append([])
        pieces[-1].append(column)
    for piece in pieces:
        table = new_table(*(heads[i] for i in first + piece))
        for row in rows:
            table.add_row(*(row[i] for i in first + piece))
        print_under(console, title, table)
        title = "further columns"


ROUNDING = 1e-9
"""Smallest magnitude that is printed, in the unit of a table: smaller numbers are rounding
errors, such as the crossrange of a planar flight, and are printed as 0"""


def in_digits(number: float, sign: str = "") -> str:
    """Text of a number: four decimals, fewer digits if it is small; - for NaN."""
    if np.isnan(number):
        return "-"
    if abs(number) < ROUNDING:
        number = 0.0
    if 0.0 < abs(number) < 5e-5:
        return f"{number:{sign}.1e}"
    few = 0.0 < abs(number) < 0.01
    return f"{number:{sign}#.3g}" if few else f"{number:{sign}z.4f}"
