"""Tables of results, made from the files that the benchmarks write.

A page asks for a table by a block of TOML, see `table`. No number is typed in a page.
"""

import sys
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from described import markdown_table

from jentry.campaign.populations import Population
from jentry.cli.benchmark_record import read_record
from jentry.cli.benchmark_tables import table_of_all, table_of_case
from jentry.missions import find_mission
from jentry.units import km


BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
sys.path.append(str(BENCHMARKS))

import populations  # noqa: E402
import records  # noqa: E402
import sampling  # noqa: E402
import wind  # noqa: E402


Rows = list[list[str]]


def table(specification: str) -> str:
    """The Markdown of a table, with the command that wrote its numbers and the date.

    **Arguments:**

    - `specification`: TOML. `source` names the file: `populations.csv`, `published.csv`,
      `timings.csv`, `navigation.csv`, `neural_law.csv`, `sampling.csv`, `wind.csv`,
      `benchmark.json`, or `tuned` for the files of tuned gains. For the first, `rows` and
      `columns` are lists of tables whose keys are merged for each cell: `title`,
      `choice`, `dispersions`, `heading`, `show` (see `SHOWN`), `published`, `digits`,
      `mission`, or `cells` for several numbers in one cell. For the next two, `table` is
      the name of the table in the file. For `navigation.csv` and `neural_law.csv`, `part`
      is a part of the program;
      tables of a part are put below each other, and so are those of the `ways` to a law.
      For `benchmark.json`, `table` is a case, or `all`.

    **Raises:** `ValueError` for an unknown key or source, `KeyError` for a number that is
    not in the file.
    """
    wish = tomllib.loads(specification)
    source = wish.pop("source", None)
    if source not in SOURCES:
        raise ValueError(f"source is {source!r}: choose from {', '.join(SOURCES)}")
    known, make = SOURCES[source]
    if unknown := wish.keys() - known:
        raise ValueError(f"a table of {source} has the unknown keys {sorted(unknown)}")
    heading, rows, caption = make(**wish)
    return f"{markdown_table(heading, rows)}\n\n<small>{caption}</small>"


def decimal(value: float, digits: int) -> str:
    """A number with so many significant digits, without an exponent; 0 below 5e-7."""
    if abs(value) < _ROUNDING or not np.isfinite(value):
        return f"{value:z.0f}"
    return f"{value:.{_decimals(value, digits)}f}"


_ROUNDING = 5e-7
"""What is smaller, in the unit of a table, is 0 but for rounding"""


def _decimals(value: float, digits: int) -> int:
    # A number that rounds up to a power of ten has one more digit before the point.
    rounded = float(f"{value:.{digits - 1}e}")
    return max(digits - 1 - int(np.floor(np.log10(abs(rounded)))), 0)


def with_deviation(mean: float, deviation: float, digits: int) -> str:
    """A mean with its standard deviation, both to the second digit of the deviation."""
    if deviation < _ROUNDING:
        return f"{decimal(mean, digits)} ± 0"
    places = _decimals(deviation, 2)
    return f"{mean:.{places}f} ± {deviation:.{places}f}"


SHOWN: dict[str, Callable[[Population, float | None, int], str]] = {
    "mean": lambda p, value, n: decimal(p.mean, n),
    "deviation": lambda p, value, n: decimal(p.spread, 2),
    "mean ± deviation": lambda p, value, n: with_deviation(p.mean, p.spread, n),
    "largest": lambda p, value, n: decimal(float(np.max(p.values)), n),
    "smallest": lambda p, value, n: decimal(float(np.min(p.values)), n),
    "published": lambda p, value, n: f"{_stated(value):g}",
    "off by": lambda p, value, n: _off(p, _stated(value)),
    "below": lambda p, value, n: f"{p.below(_stated(value))} of {len(p.values)}",
}
"""What a cell shows of a statistic of many sets: its mean, its standard deviation from set
to set, its extremes; the published value, by how many deviations of a set that lies above
the mean, and how many sets are below it"""


def _stated(value: float | None) -> float:
    if value is None:
        raise ValueError("the row has no published value")
    return value


def _off(p: Population, value: float) -> str:
    return f"{p.deviations(value):.1f}" if p.spread > 1e-4 * abs(value) else ""


def of_populations(
    rows: list[dict[str, Any]],
    columns: list[dict[str, Any]],
    mission: str = "",
    corner: str = "",
    digits: int = 3,
) -> tuple[list[str], Rows, str]:
    saved = populations.statistics()
    seen = []

    def number(keys: Mapping[str, Any]) -> str:
        row = tuple(keys[k] for k in ("mission", "choice", "dispersions", "heading"))
        seen.append((row[0], saved[row].date))
        value = keys.get("published")
        if isinstance(value, str):
            value = {v.name: v.value for v in find_mission(row[0]).published}[value]
        return SHOWN[keys["show"]](Population(saved[row].sets), value, keys["digits"])

    def cell(row: dict[str, Any], column: dict[str, Any]) -> str:
        keys = {"mission": mission, "digits": digits, **row, **column}
        if twice := (row.keys() & column.keys()) - {"title"}:
            raise ValueError(f"a row and a column both have the keys {sorted(twice)}")
        if unknown := keys.keys() - _KEYS:
            raise ValueError(f"unknown keys {sorted(unknown)} of a row or a column")
        return ", ".join(number({**keys, **one}) for one in keys.get("cells", [{}]))

    body = [[row["title"], *(cell(row, column) for column in columns)] for row in rows]
    commands = " and ".join(
        f"`python benchmarks/populations.py {name}`" for name in dict(seen)
    )
    dates = sorted({date for _, date in seen})
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    return [corner, *(c["title"] for c in columns)], body, f"{commands}, {when}."


_KEYS = {
    "title",
    "mission",
    "choice",
    "dispersions",
    "heading",
    "show",
    "published",
    "digits",
    "cells",
}


def _of_records(path: Path, name: str, command: str) -> tuple[list[str], Rows, str]:
    found = records.load(path)[name]
    columns = list(dict.fromkeys(cell.column for cell in found.cells))
    rows: dict[str, dict[str, str]] = {}
    for cell in found.cells:
        text = (
            decimal(cell.value, 3)
            if cell.decimals < 0
            else f"{cell.value:z.{cell.decimals}f}"
        )
        if cell.published is not None:
            text += f" ({cell.published:.6g})"
        rows.setdefault(cell.row, {})[cell.column] = text
    body = [[row, *(cells.get(c, "") for c in columns)] for row, cells in rows.items()]
    where = f" on {found.processor}" if found.processor else ""
    return ["", *columns], body, f"`{command}`, {found.date}{where}."


def of_published(table: str) -> tuple[list[str], Rows, str]:
    heading, rows, caption = _of_records(
        records.PUBLISHED, table, f'python benchmarks/published.py "{table}"'
    )
    cells = records.load(records.PUBLISHED)[table].cells
    if any(cell.published is not None for cell in cells):
        caption = f"In brackets: the paper. {caption}"
    return heading, rows, caption


def of_timings(table: str) -> tuple[list[str], Rows, str]:
    program = TIMED[table]
    return _of_records(records.TIMINGS, table, f"python benchmarks/{program}")


TIMED = {
    "monte-carlo": "monte_carlo.py",
    "gradient": "gradient.py",
    "first-answer": "first_answer.py",
    "cluster": "cluster.py",
}
"""The programs that write the tables of timings"""


def of_navigation(part: str) -> tuple[list[str], Rows, str]:
    path = BENCHMARKS / "navigation.csv"
    names = [name for name in records.load(path) if name.startswith(f"{part}, ")]
    if not names:
        raise KeyError(f"{path.name} has no table of the part {part!r}")
    # The seeds of one tuning below each other, whenever they were saved.
    alike = [name.partition(", seed ")[0] for name in names]
    names.sort(key=lambda name: (alike.index(name.partition(", seed ")[0]), name))
    command = f"python benchmarks/navigation.py {part}"
    headings, rows, captions = zip(
        *(_of_records(path, name, command) for name in names), strict=True
    )
    if any(heading != headings[0] for heading in headings):
        raise ValueError(f"the tables {names} have different columns")
    return headings[0], sum(rows, []), " ".join(dict.fromkeys(captions))


_WAYS = "through", "imitation", "evolution", "policy"
"""Parts of the program that come to the weights of the law, in the order of the page"""


def of_neural_law(part: str) -> tuple[list[str], Rows, str]:
    path = BENCHMARKS / "neural_law.csv"
    if part != "ways":
        return _of_records(path, part, f"python benchmarks/neural_law.py {part}")
    tables = records.load(path)
    rows, dates, headings = [], set(), {}
    for way in _WAYS:
        seeds = [table for name, table in tables.items() if name.startswith(f"{way}, ")]
        dates |= {table.date for table in seeds}
        found = [{cell[:2]: cell.value for cell in table.cells} for table in seeds]
        headings = dict.fromkeys(column for _, column in found[0])
        for row in dict.fromkeys(row for row, _ in found[0]):
            values = [[seed[row, column] for seed in found] for column in headings]
            rows.append([f"{way}, {len(seeds)} seeds", row, *map(_of_seeds, values)])
    caption = (
        "Median of the seeds, and in brackets their smallest and largest value. "
        "`python benchmarks/neural_law.py WAY --seeds SEED...`, "
        f"{max(dates)}."
    )
    return ["", "", *headings], rows, caption


def _of_seeds(values: list[float]) -> str:
    middle, least, most = np.median(values), min(values), max(values)
    return f"{decimal(middle, 3)} ({decimal(least, 3)} to {decimal(most, 3)})"


def of_sampling() -> tuple[list[str], Rows, str]:
    dates, rows = sampling.saved_on(), sampling.saved()
    body = [
        [mission, *cells]
        for mission in dates
        for cells in sampling.table_of(mission, rows)
    ]
    heading = [
        "mission",
        "output",
        "of 256 runs",
        "plain",
        "variance, plain over Latin hypercube",
        "over Sobol",
    ]
    return heading, body, f"`python benchmarks/sampling.py`, {max(dates.values())}."


def of_wind() -> tuple[list[str], Rows, str]:
    body = []
    for name, values in wind.saved().items():
        found = dict(zip(wind.COLUMNS, wind.table_of(values), strict=True))
        miss = (found["miss, median, km"], found["99th percentile"], found["maximum"])
        down = found["downrange error, median, km"]
        body.append([name, ", ".join(f"{x:.2f}" for x in miss), f"{down:.3f}"])
    heading = [
        "wind, as the law has it",
        "miss, km: median, 99 %, largest",
        "downrange error, median, km",
    ]
    return heading, body, f"`python benchmarks/wind.py`, {wind.saved_on()}."


def of_tuned() -> tuple[list[str], Rows, str]:
    body = []
    for mission in ("mars-drag-tracking", "mars-range-tracking"):
        text = (BENCHMARKS / f"tuned-{mission}.toml").read_text(encoding="utf-8")
        for found in tomllib.loads(text)["tuned"]["judgement"]["comparisons"]:
            quantity, statistic = found["quantity"], found["statistic"]
            if (quantity, statistic) not in _TUNED[mission]:
                continue
            low, high = (f"{x / km:+z.4f}" for x in found["interval"])
            body.append(
                [
                    f"`{mission}`",
                    f"{quantity} error, {_STATISTICS[statistic]}",
                    *(f"{found[when] / km:.4f}" for when in ("before", "after")),
                    f"{low} to {high}",
                ]
            )
    heading = ["mission", "km", "gains of the paper", "tuned", "change, 95 %"]
    caption = (
        "`jentry tune MISSION`, judged on 5000 draws that the tuning has not used; "
        "`benchmarks/tuned-*.toml`."
    )
    return heading, body, caption


_STATISTICS = {"std": "standard deviation", "95 % of |.|": "95 % of the magnitude"}
_TUNED = {
    "mars-drag-tracking": {
        (quantity, statistic)
        for quantity in ("downrange", "altitude")
        for statistic in _STATISTICS
        if (quantity, statistic) != ("altitude", "95 % of |.|")
    },
    "mars-range-tracking": {
        ("downrange", "std"),
        ("downrange", "95 % of |.|"),
        ("altitude", "std"),
        ("crossrange", "std"),
    },
}


def of_benchmark(table: str) -> tuple[list[str], Rows, str]:
    """The laws of a case of `jentry benchmark --short`, or of `all` cases."""
    record = read_record(BENCHMARKS / "benchmark.json")
    made = {case["name"]: case for case in record["cases"] if case["laws"]}
    if table == "all":
        found = table_of_all(record)
        if found is None:
            raise ValueError("benchmark.json has no case with two laws or more")
    elif table in made:
        found = table_of_case(made[table], record["sets"], {})
    else:
        raise ValueError(f"table is {table!r}: choose from all, {', '.join(made)}")
    heads = [head.replace("\n", " ") for head in found.heads]
    versions = ", ".join(f"{n} {x}" for n, x in record["versions"].items())
    caption = f"{'; '.join([found.title, *found.notes])}. {versions}"
    return heads, found.rows, caption


SOURCES: dict[str, tuple[set[str], Callable[..., tuple[list[str], Rows, str]]]] = {
    "populations.csv": (
        {"rows", "columns", "mission", "corner", "digits"},
        of_populations,
    ),
    "published.csv": ({"table"}, of_published),
    "timings.csv": ({"table"}, of_timings),
    "navigation.csv": ({"part"}, of_navigation),
    "neural_law.csv": ({"part"}, of_neural_law),
    "sampling.csv": (set(), of_sampling),
    "wind.csv": (set(), of_wind),
    "tuned": (set(), of_tuned),
    "benchmark.json": ({"table"}, of_benchmark),
}
"""By file: the keys of a specification, and what makes the table"""
