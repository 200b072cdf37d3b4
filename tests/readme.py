"""The README as the tests read it: its tables, and its numbers at their last digit."""

import re
from pathlib import Path

import pytest


README = Path(__file__).parents[1].joinpath("README.md").read_text()


def rows(heading, after=""):
    """Cells of the table whose first line has a text, behind another text."""
    lines = README.splitlines()
    start = next(i for i, line in enumerate(lines) if after in line)
    places = range(start, len(lines))
    begin = next(i for i in places if heading in lines[i])
    found = []
    for line in lines[begin + 2 :]:
        if not line.startswith("|"):
            return found
        found.append([cell.strip() for cell in line.strip("|").split("|")])
    return found


def assert_prints(cell, *values):
    """The numbers of a cell are these values, each to its last digit."""
    numbers = re.findall(r"-?\d[\d ]*(?:\.\d+)?", cell)
    assert len(numbers) == len(values), cell
    for number, value in zip(numbers, values, strict=True):
        half = 0.5 * 10.0 ** -len(number.partition(".")[2])
        assert float(number) == pytest.approx(value, abs=half * (1 + 1e-6)), cell


def assert_says(text, *values):
    """A passage of the README, line breaks aside, and its numbers."""
    assert text in " ".join(README.split()), text
    assert_prints(text, *values)


def file_of_the_readme():
    """The mission of a user's own."""
    section = README[README.index("## A mission of your own") :]
    return section[
        section.index("```python\n") + 10 : section.index("```\n\n    jentry")
    ]
