"""The pages as the tests read them, and the figures that the benchmarks have saved."""

import importlib.util
import re
from pathlib import Path

import pytest


ROOT = Path(__file__).parents[1]
README = ROOT.joinpath("README.md").read_text()
PAGES = " ".join(
    text
    for page in [ROOT / "README.md", *sorted(ROOT.joinpath("docs").rglob("*.md"))]
    for text in page.read_text().split()
)
"""The README and all pages of the documentation, line breaks aside"""


def assert_prints(cell, *values):
    """The numbers of a text are these values, each to its last digit."""
    numbers = re.findall(r"-?\d[\d ]*(?:\.\d+)?", cell)
    assert len(numbers) == len(values), cell
    for number, value in zip(numbers, values, strict=True):
        half = 0.5 * 10.0 ** -len(number.partition(".")[2])
        assert float(number) == pytest.approx(value, abs=half * (1 + 1e-6)), cell


def assert_says(text, *values):
    """A passage of a page, line breaks aside, and its numbers."""
    assert text in PAGES, text
    assert_prints(text, *values)


def benchmark(name):
    """A program of the folder of benchmarks, as a module."""
    path = ROOT / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def published(table):
    """The cells of a table of `published.csv`, by row and column."""
    records = benchmark("records")
    return {
        (cell.row, cell.column): cell
        for cell in records.load(records.PUBLISHED)[table].cells
    }


def assert_same(cell, value):
    """A number is that of a cell, to the last digit that a page prints of it."""
    half = 0.5 * 10.0**-cell.decimals
    assert float(value) == pytest.approx(cell.value, abs=half * (1 + 1e-6)), cell
