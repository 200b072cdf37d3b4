"""Tables of `jentry benchmark`: accuracy and ranks of each case, all cases, and cost."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._printed import in_words
from ..statistics.benchmark import (
    BANK_RATE,
    BROKEN,
    FAILURES,
    NOMINAL,
    PERCENTILES,
    RANKED,
    REVERSALS,
    percentile_name,
)
from ..units import degree, edge_unit
from .benchmark_record import Record, number_of
from .tables import in_digits


LOST = "lost"


class Table(NamedTuple):
    """A table with its title and the notes below it."""

    title: str
    heads: list[str]
    rows: list[list[str]]
    notes: list[str]


def table_of_case(case: Record, sets: int, others: Mapping[str, Record]) -> Table:
    """Accuracy, failures, limits, control effort and rank of the laws of a case.

    **Arguments:**

    - `others`: stored benchmarks by name, whose rows are put below.
    """
    measure, size = case["measure"], case["runs_in_a_set"]
    rows = [(law["name"], law) for law in case["laws"]]
    notes = []
    for name, record in others.items():
        there = next((x for x in record["cases"] if x["name"] == case["name"]), None)
        if there is None:
            notes.append(f"{name} has no flights of this case")
            continue
        version = record["versions"]["jentry"]
        notes.append(f"{name}: jentry {version}, {record['machine']}")
        here = {law["name"]: law["draws"] for law in case["laws"]}
        for law in there["laws"]:
            rows.append((f"{law['name']} ({name})", law))
            if here.get(law["name"], law["draws"]) != law["draws"]:
                notes.append(f"{law['name']} of {name} flew other draws")
    names = [NOMINAL, *(percentile_name(measure, p) for p in PERCENTILES)]
    values = [
        number_of(law["statistics"][n]["value"]) for _, law in rows for n in names
    ]
    unit = rows[0][1]["statistics"][NOMINAL]["unit"]
    shown, scale = edge_unit(unit, [x for x in values if math.isfinite(x)])
    heads = [
        "law",
        "failures\n%",
        f"nominal\n{shown}",
        *(f"{p:.10g} %\n{shown}" for p in PERCENTILES),
        "beyond a\nlimit, %",
        "bank rate\ndeg/s",
        "bank\nreversals",
        "rank\n[interval]",
    ]
    cells = []
    for name, law in rows:
        found = law["statistics"]
        cells.append(
            [
                name,
                _percent(found[FAILURES]),
                _told(found[NOMINAL], scale),
                *(
                    _told(found[percentile_name(measure, p)], scale)
                    for p in PERCENTILES
                ),
                _percent(found[BROKEN]) if BROKEN in found else "no limits",
                _told(found[BANK_RATE], degree),
                _told(found[REVERSALS], 1.0),
                _rank(law["rank"]) if len(case["laws"]) > 1 else "-",
            ]
        )
    for law in case["laws"]:
        if law["other_draws"]:
            notes.append(
                f"{law['name']} has other draws than {case['laws'][0]['name']}: "
                f"{law['other_draws']}"
            )
    where = "".join(f", {name}" for name in (case["case"], *case["worlds"]) if name)
    tables = dict.fromkeys(law["dispersions"] for law in case["laws"])
    mission = "" if case["mission"] == case["name"] else f"{case['mission']}{where}; "
    title = (
        f"{case['name']}: {mission}dispersions {', '.join(tables)}; "
        f"{sets} sets of {size} flights; {in_words(measure)}"
    )
    return Table(title, heads, cells, notes)


HOW_TO_READ = (
    "Percentiles are of the magnitude of the error of all flights. A flight that does not "
    f"reach the end of guided flight is larger than any number: {LOST!r} stands where it "
    "is the percentile. After ±: standard deviation from set to set, where a set has "
    "enough flights. Nominal is the flight without dispersions. Bank rate (mean magnitude) "
    "and bank reversals are of the first flights, at the interval of their histories. "
    f"Ranks are by the percentile {RANKED:g} %, with intervals of 95 % by bootstrap; equal "
    "laws share their mean rank."
)


def _told(statistic: Record, scale: float) -> str:
    if statistic["needs_runs"] is not None:
        return f"needs {statistic['needs_runs']} flights"
    value, spread = (number_of(statistic[x]) for x in ("value", "deviation_of_sets"))
    if math.isinf(value):
        return LOST
    if math.isnan(value):
        return "-"
    text = in_digits(value / scale)
    return text if math.isnan(spread) else f"{text} ± {in_digits(spread / scale)}"


def _percent(statistic: Record) -> str:
    value, spread = (
        100.0 * number_of(statistic[x]) for x in ("value", "deviation_of_sets")
    )
    return f"{value:.2f}" if math.isnan(spread) else f"{value:.2f} ± {spread:.2f}"


def _rank(interval: Record) -> str:
    value, lower, upper = (
        "-" if interval[x] is None else f"{interval[x]:.10g}"
        for x in ("value", "lower", "upper")
    )
    return value if lower == "-" else f"{value} [{lower}, {upper}]"


def contested(record: Record) -> list[Record]:
    """Cases in which two laws or more fly, so that one can be better."""
    return [case for case in record["cases"] if len(case["laws"]) > 1]


def shares_of_cases(record: Record) -> dict[str, list[float]]:
    """Share of the contested cases in which each law is within factors of the best law.

    The error is the percentile `RANKED`, and at least the resolution of the case. A law is
    within no factor in a case in which it does not fly.
    """
    factors, cases = np.array(record["profile_factors"]), contested(record)
    within: dict[str, np.ndarray] = {}
    for case in cases:
        errors = {
            law["name"]: max(error_of_rank(case, law), case["resolution"])
            for law in case["laws"]
        }
        best = min(errors.values(), default=math.inf)
        for name, error in errors.items():
            found = (
                error <= best * factors * (1.0 + 1e-12)
                if math.isfinite(error)
                else np.zeros(factors.shape)
            )
            within[name] = within.get(name, np.zeros(factors.shape)) + found
    return {
        name: [float(x) / len(cases) for x in within[name]] for name in sorted(within)
    }


def error_of_rank(case: Record, law: Record) -> float:
    """Percentile by which the laws are ranked; infinite if the flights are too few."""
    plain = law["statistics"][percentile_name(case["measure"], RANKED)]
    return math.inf if plain["value"] is None else number_of(plain["value"])


def table_of_all(record: Record) -> Table | None:
    """One row for each law: its cases, and in how many of them it is good.

    Cases with one law do not count. None if there is no other case.
    """
    shares, cases = shares_of_cases(record), contested(record)
    if not cases:
        return None
    factors = record["profile_factors"]
    at = {
        factor: int(np.argmin(np.abs(np.array(factors) - factor))) for factor in (1, 10)
    }
    rows = []
    for name, values in shares.items():
        laws = [x for case in cases for x in case["laws"] if x["name"] == name]
        ranks = [number_of(law["rank"]["value"]) for law in laws]
        rows.append(
            [
                name,
                str(len(laws)),
                *(f"{values[i] * len(cases):.0f}" for i in at.values()),
                in_digits(float(np.mean(ranks))),
            ]
        )
    heads = [
        "law",
        "cases in\nwhich it flies",
        "best or equal",
        "within 10 times\nthe best",
        "mean rank",
    ]
    number = "1 case" if len(cases) == 1 else f"{len(cases)} cases"
    title = f"Over {number}, by the percentile {RANKED:g} % of the error"
    left_out = [case["name"] for case in record["cases"] if case not in cases]
    notes = [f"without cases in which one law flies: {', '.join(left_out)}"]
    return Table(title, heads, rows, notes if left_out else [])


def table_of_cost(case: str, costs: Mapping[str, Mapping[str, Any]]) -> Table:
    """Flights a second of the laws of a case, and their cost in units of the cheapest."""
    fastest = max(cost["flights_per_second"] for cost in costs.values())
    rows = [
        [
            law,
            f"{cost['flights_per_second']:.3g}",
            f"{fastest / cost['flights_per_second']:.3g}",
            cost["machine"],
        ]
        for law, cost in costs.items()
    ]
    heads = ["law", "flights\na second", "cost, of that\nof the cheapest", "machine"]
    notes = []
    if len({cost["machine"] for cost in costs.values()}) > 1:
        notes = ["measured on different machines, which cannot be compared"]
    return Table(f"{case}: cost, measured on this machine", heads, rows, notes)


def skipped_lines(skipped: Sequence[Record]) -> list[str]:
    """One sentence for each law that does not fly in a case."""
    return [
        f"{each['law']} does not fly in {each['case']}: {each['why']}"
        for each in skipped
    ]
