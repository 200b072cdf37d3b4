"""The tables of the pages: what a specification asks for, out of the saved files."""

import csv
import json
import re
import sys

import numpy as np
import pytest
from pages import ROOT, assert_says, benchmark


sys.path.insert(0, str(ROOT / "docs"))

import filling  # noqa: E402
import tables  # noqa: E402


def cells(markdown):
    """Cells of a table in Markdown, heading first."""
    lines = markdown.partition("\n\n")[0].splitlines()
    return [[c.strip() for c in line.strip("|").split("|")] for line in lines]


def sets_of(*row):
    """Values of the sets, read from the file by nothing of ours."""
    with open(ROOT / "benchmarks" / "populations.csv", newline="") as file:
        (found,) = (line for line in csv.reader(file) if tuple(line[:4]) == row)
    return np.array(found[6:], float)


SPECIFICATION = """
source = "populations.csv"
mission = "mars-drag-tracking"
corner = "law"
rows = [
  {title = "ours", choice = "table-3", dispersions = "lift-to-drag-held"},
]
columns = [
  {title = "mean", heading = "NAME", show = "mean ± deviation"},
  {title = "extremes", cells = [
    {heading = "NAME", show = "smallest"}, {heading = "NAME", show = "largest"}]},
  {title = "paper", heading = "NAME", show = "published", published = "NAME"},
  {title = "off", heading = "NAME", show = "off by", published = "NAME"},
  {title = "below", heading = "NAME", show = "below", published = "NAME"},
]
""".replace("NAME", "downrange error, standard deviation")


def test_a_table_of_populations():
    made = tables.table(SPECIFICATION)
    heading, rule, row = cells(made)
    assert heading == ["law", "mean", "extremes", "paper", "off", "below"]
    assert set(rule) == {"---"}
    name = "downrange error, standard deviation"
    sets = sets_of("mars-drag-tracking", "table-3", "lift-to-drag-held", name)
    mean, deviation = np.mean(sets), np.std(sets, ddof=1)
    assert len(sets) == 16
    assert row == [
        "ours",
        f"{mean:.2f} ± {deviation:.2f}",
        f"{min(sets):.2f}, {max(sets):.2f}",
        "6.7809",  # Table 3 of the paper
        f"{(6.7809 - mean) / deviation:.1f}",
        f"{np.sum(sets < 6.7809)} of 16",
    ]
    assert "`python benchmarks/populations.py mars-drag-tracking`, 2026-" in made


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("populations.csv", "nothing.csv", "source is 'nothing.csv': choose from"),
        ("corner =", "korner =", r"unknown keys \['korner'\]"),
        ('{title = "ours",', '{title = "ours", show = "mean",', "both have the keys"),
        ('show = "largest"', 'shows = "largest"', "unknown keys|show"),
        ('choice = "table-3"', 'choice = "table-4"', "table-4"),
        ('show = "published", published = "NAME"', 'show = "published"', "published"),
    ],
)
def test_a_specification_that_cannot_be_met_is_refused(old, new, said):
    name = "downrange error, standard deviation"
    wrong = SPECIFICATION.replace(old.replace("NAME", name), new)
    assert wrong != SPECIFICATION
    with pytest.raises((KeyError, ValueError), match=said):
        tables.table(wrong)


def test_a_part_of_the_navigation_is_one_table():
    with open(ROOT / "benchmarks" / "navigation.csv", newline="") as file:
        lines = [x for x in csv.reader(file) if x[0].startswith("miss, ")]
    made = tables.table('source = "navigation.csv"\npart = "miss"')
    heading, _, *rows = cells(made)
    assert len(rows) == 4 and len(lines) == 4 * (len(heading) - 1)
    assert [row[0] for row in rows] == list(dict.fromkeys(x[3] for x in lines))
    for line in lines:
        (row,) = (row for row in rows if row[0] == line[3])
        found = row[heading.index(line[4])]
        assert found == f"{float(line[5]):.{line[6]}f}"
    assert f"`python benchmarks/navigation.py miss`, {lines[0][1]}" in made
    with pytest.raises(KeyError, match="no table of the part 'hit'"):
        tables.table('source = "navigation.csv"\npart = "hit"')


def test_what_is_said_of_tuning_with_navigation_errors():
    with open(ROOT / "benchmarks" / "navigation.csv", newline="") as file:
        found = {(x[0], x[4]): float(x[5]) for x in csv.reader(file)}

    def range_tracking(of, heading):
        name = f"tuning, range-tracking, {of}"
        return [found[name, f"{heading}, {when}"] for when in ("before", "after")]

    changes, befores = [], []
    for seed in range(3):
        of, square = f"inertial, seed {seed}", "mean square of the miss, km2"
        before, after = range_tracking(of, square)
        befores.append(before)
        changes.append(100.0 * (after / before - 1.0))
        name = f"tuning, range-tracking, {of}"
        low, high = (found[name, f"{square}, change, {end}"] for end in ("low", "high"))
        assert low * high > 0.0
    says = "1.92 to 1.97 square kilometres before it"
    assert_says(says, min(befores), max(befores))
    assert_says("changes by -1.8, 1.0 and -2.0 %", *changes)
    assert_says("both of its intervals contain zero")
    of_it = sorted(
        {n for n, _ in found if n.startswith("tuning, predictor-corrector, i")}
    )
    assert len(of_it) == 2
    for name in of_it:
        ends = (found[name, f"{square}, change, {end}"] for end in ("low", "high"))
        assert np.prod(list(ends)) < 0.0
    (before, one), (_, other) = (
        range_tracking(f"aided, seed {seed}", "95 % of crossrange, km")
        for seed in (0, 1)
    )
    assert_says("errors fall from 0.43 to 0.10 and 0.19 km", before, one, other)
    (before, one), (_, other) = (
        range_tracking(f"aided, seed {seed}", "bank reversals") for seed in (0, 1)
    )
    assert_says(
        "the bank is reversed 44 and 21 times in place of 6", one, other, before
    )


@pytest.mark.parametrize(
    ("value", "digits", "printed"),
    [
        (0.0123456, 3, "0.0123"),
        (99.96, 3, "100"),
        (9.996, 3, "10.0"),
        (-1234.5, 3, "-1234"),
        (3e-16, 3, "0"),
        (-3e-16, 3, "0"),
        (0.0, 3, "0"),
    ],
)
def test_numbers_have_their_digits(value, digits, printed):
    assert tables.decimal(value, digits) == printed


def test_a_mean_has_the_digits_of_its_deviation():
    assert tables.with_deviation(140.8123, 5.123, 3) == "140.8 ± 5.1"
    assert tables.with_deviation(0.0025, 0.0036, 3) == "0.0025 ± 0.0036"
    assert tables.with_deviation(2.0, 0.0, 3) == "2.00 ± 0"


def test_a_saved_table_comes_back(tmp_path):
    records = benchmark("records")
    file = tmp_path / "some.csv"
    first = [
        records.Cell("a, b", "x", 1.23456789, 2, 1.5),
        records.Cell("c", "x", 2.0, -1),
    ]
    records.save(file, "one", first)
    records.save(file, "two", first[:1])
    records.save(file, "one", first)
    saved = records.load(file)
    assert set(saved) == {"one", "two"}
    assert saved["one"].cells == first and saved["two"].cells == first[:1]


def test_every_page_can_be_filled():
    """Every table has its numbers, and every command and mission exists."""
    for path in sorted(ROOT.joinpath("docs").rglob("*.md")):
        made = filling.filled(path.read_text())
        assert "```table" not in made, path
        assert not re.search(r"^\{\{", made, re.M), path


def test_every_command_has_a_page():
    import typer

    from jentry.cli.entry import app

    commands = set(typer.main.get_group(app).commands)
    pages = {path.stem for path in ROOT.joinpath("docs", "commands").glob("*.md")}
    assert pages == commands | {"index", "configuration"}


def test_every_mission_has_a_page():
    from jentry.missions import every_mission

    names = {mission.name for mission in every_mission()}
    pages = {path.stem for path in ROOT.joinpath("docs", "missions").glob("*.md")}
    others = {
        "index",
        "predictor-corrector",
        "neural-law",
        "laws-compared",
        "benchmark",
    }
    assert pages == names | others


def test_a_table_of_the_benchmark_has_the_numbers_of_its_file():
    path = ROOT / "benchmarks" / "benchmark.json"
    record = json.loads(path.read_text())
    (case,) = (x for x in record["cases"] if x["name"] == "mars-range-tracking")
    made = tables.table('source = "benchmark.json"\ntable = "mars-range-tracking"')
    heading, _, *rows = cells(made)
    place = heading.index("95 % km")
    assert [row[0] for row in rows] == [law["name"] for law in case["laws"]]
    for row, law in zip(rows, case["laws"], strict=True):
        found = law["statistics"]["miss_over_ground_percentile_95"]
        mean, deviation = map(float, row[place].split(" ± "))
        np.testing.assert_allclose(mean, found["value"] / 1000.0, rtol=5e-3)
        spread = np.std(found["sets"], ddof=1) / 1000.0
        np.testing.assert_allclose(deviation, spread, rtol=5e-2)


def test_a_table_of_the_benchmark_needs_a_case_that_was_flown():
    with pytest.raises(ValueError, match="table is 'moon': choose from all, mars-drag"):
        tables.table('source = "benchmark.json"\ntable = "moon"')
