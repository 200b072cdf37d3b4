"""Tables of numbers from text files, with errors that name file and line."""

import csv
import math
import os
from collections.abc import Sequence

import numpy as np


def read_columns(
    path: str | os.PathLike,
    required: Sequence[str],
    optional: Sequence[str] | None = (),
    *,
    rows: int = 2,
    increasing: str | None = None,
    positive: Sequence[str] = (),
) -> tuple[dict[str, np.ndarray], list[int]]:
    """Columns of a file of comma-separated numbers under one line of names.

    Blank lines and lines that start with `#` are skipped.

    **Arguments:**

    - `required`, `optional`: names of columns, in any order; others are refused, unless
      `optional` is None.
    - `rows`: least number of rows.
    - `increasing`: name of a column in which each number must exceed the one before.
    - `positive`: names of columns in which every number must exceed zero.

    **Returns:**

    The columns of the file by name, and the line number of each row.

    Raises `ValueError` that names the file, the line and what was expected there.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            found = [
                (number, [cell.strip() for cell in cells])
                for number, cells in _numbered(file)
            ]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: {error}; expected text in UTF-8") from None
    if not found:
        raise ValueError(
            f"{path}: empty; expected a line with the names "
            f"{','.join(required) or 'of the columns'} and rows of numbers below it"
        )
    (header_line, names), *body = found
    _check_names(f"{path}, line {header_line}", names, required, optional)
    if len(body) < rows:
        raise ValueError(
            f"{path}, line {header_line}: {len(body)} rows of numbers below the names; "
            f"expected {rows} or more"
        )
    table = np.array(
        [_numbers(f"{path}, line {line}", cells, names) for line, cells in body]
    )
    columns = dict(zip(names, table.T, strict=True))
    lines = [line for line, _ in body]
    for name in positive:
        for line, value in zip(lines, columns.get(name, ()), strict=False):
            if value <= 0.0:
                raise ValueError(
                    f"{path}, line {line}: {name} is {value:g}; expected a number "
                    "above zero"
                )
    if increasing is not None:
        column = columns[increasing]
        for line, before, value in zip(lines[1:], column, column[1:], strict=False):
            if value <= before:
                raise ValueError(
                    f"{path}, line {line}: {increasing} is {value:g} after {before:g}; "
                    "expected increasing values"
                )
    return columns, lines


def _numbered(file):
    """Rows with their line numbers, without blank lines and comments."""
    for number, line in enumerate(file, start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, next(csv.reader([line]))


def _check_names(place, names, required, optional):
    for name in required:
        if name not in names:
            raise ValueError(
                f"{place}: no column {name!r}; expected {','.join(required)} and found "
                f"{','.join(names)}"
            )
    known = names if optional is None else (*required, *optional)
    for name in names:
        if name not in known:
            raise ValueError(
                f"{place}: unknown column {name!r}; expected some of {','.join(known)}"
            )
        if names.count(name) > 1:
            raise ValueError(f"{place}: column {name!r} appears more than once")


def _numbers(place, cells, names):
    if len(cells) != len(names):
        raise ValueError(
            f"{place}: {len(cells)} values; expected {len(names)}: {','.join(names)}"
        )
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(
                f"{place}: {name} is {cell!r}; expected a finite number"
            ) from None
        values.append(value)
    return values
