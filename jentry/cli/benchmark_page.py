"""The page of `jentry benchmark`: all tables, and profiles of performance as figures."""

import io
from collections.abc import Sequence
from html import escape

from ..plots.performance_profile import draw_profiles
from .benchmark_record import Record
from .benchmark_tables import (
    HOW_TO_READ,
    Table,
    contested,
    shares_of_cases,
    skipped_lines,
)
from .html_page import html_figures, html_table, page_around


PAGE = "benchmark.html"

_MOST = 12
"""Largest number of laws in the profile over all cases"""


def page_of_benchmark(
    record: Record, tables: Sequence[Table], cost: Sequence[Table]
) -> str:
    """The page as HTML, which needs no other file."""
    versions = ", ".join(f"{n} {x}" for n, x in record["versions"].items())
    sections = [
        "<h1>Benchmark of guidance laws</h1>",
        f'<p class="note">{escape(versions)}, {escape(record["machine"])}; seed '
        f"{record['seed']}, {record['sets']} sets</p>",
        f'<p class="note">{escape(HOW_TO_READ)}</p>',
        *(_section(table) for table in tables),
        html_figures(figures_of(record)),
        *(_section(table) for table in cost),
        _list(skipped_lines(record["skipped"])),
    ]
    return page_around("Benchmark of guidance laws", sections)


def _section(table: Table) -> str:
    rows = [[escape(cell) for cell in row] for row in table.rows]
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes)
    heads = [head.replace("\n", " ") for head in table.heads]
    return f"<h2>{escape(table.title)}</h2>\n{html_table(heads, rows)}{notes}"


def _list(lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "\n".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<h2>Laws that do not fly</h2>\n<ul>\n{items}\n</ul>"


def figures_of(record: Record) -> dict[str, bytes]:
    """Profiles of performance by name: of the cases, and of the flights of each case."""
    factors, cases = record["profile_factors"], contested(record)
    found = {}
    if len(cases) > 1:
        shares = shares_of_cases(record)
        flown = {
            name: sum(law["name"] == name for case in cases for law in case["laws"])
            for name in shares
        }
        most = sorted(shares, key=lambda name: (-flown[name], name))[:_MOST]
        shown = {
            f"{n}, {flown[n]} case{'s' if flown[n] > 1 else ''}": shares[n]
            for n in most
        }
        title = f"{len(cases)} cases, of which a law flies some"
        found["profile of all cases"] = draw_profiles(factors, shown, title, "cases")
    for case in cases:
        laws = {law["name"]: law["profile"] for law in case["laws"]}
        same = not any(law["other_draws"] for law in case["laws"])
        title = f"{case['name']}, {'' if same else 'not '}on the same draws"
        figure = draw_profiles(factors, laws, title, "flights")
        found[f"profile of {case['name']}"] = figure
    return {name: _png(figure) for name, figure in found.items()}


def _png(figure) -> bytes:
    contents = io.BytesIO()
    figure.savefig(contents, format="png", dpi=110)
    return contents.getvalue()
