"""Tables of results as the benchmarks save them, and as the pages print them.

A file has a line for each cell: table, date, processor if it is a timing, row, column,
value, decimals, and the published value if there is one. `docs/tables.py` makes the tables
of the pages from it.
"""

import csv
import datetime
import os
import platform
from pathlib import Path
from typing import NamedTuple


FOLDER = Path(__file__).parent
PUBLISHED = FOLDER / "published.csv"
"""Figures of the papers beside those of jentry, by `published.py`"""

TIMINGS = FOLDER / "timings.csv"
"""Timings, by the benchmarks that measure them"""


class Cell(NamedTuple):
    """One number of a table."""

    row: str
    column: str
    value: float
    decimals: int
    """Decimals that are printed; -1 prints three significant digits"""
    published: float | None = None


class Table(NamedTuple):
    """A table with the day on which it was measured, YYYY-MM-DD."""

    date: str
    processor: str
    cells: list[Cell]


def load(path: Path) -> dict[str, Table]:
    """Read all tables of a file, by name; none where there is no file."""
    tables: dict[str, Table] = {}
    if path.exists():
        with open(path, newline="") as file:
            for name, date, processor, row, column, *numbers in csv.reader(file):
                table = tables.setdefault(name, Table(date, processor, []))
                value, decimals, published = numbers
                beside = float(published) if published else None
                table.cells.append(
                    Cell(row, column, float(value), int(decimals), beside)
                )
    return tables


def save(path: Path, name: str, cells: list[Cell]) -> None:
    """Put a table into a file, with the date of today, in place of an earlier one."""
    tables = load(path)
    where = processor() if path == TIMINGS else ""
    tables[name] = Table(datetime.date.today().isoformat(), where, cells)
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for name, table in tables.items():
            for cell in table.cells:
                beside = "" if cell.published is None else repr(cell.published)
                value = f"{cell.value:.9g}"
                writer.writerow(
                    [name, *table[:2], *cell[:2], value, cell.decimals, beside]
                )


def processor() -> str:
    """Processor of this machine, and how many of its cores this process may use."""
    name = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo") as file:
            found = [x.split(":")[1] for x in file if x.startswith("model name")]
        name = found[0].strip() if found else name
    return f"{name}, {len(os.sched_getaffinity(0))} cores"
