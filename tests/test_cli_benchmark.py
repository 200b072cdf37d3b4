"""`jentry benchmark`: its table, resumption, laws and cases of one's own, bad input."""

import json
import re

import numpy as np
import pytest
from commands import assert_refused

from jentry.campaign import open_campaign
from jentry.cli import benchmark_runs
from jentry.cli.benchmark_tables import shares_of_cases, table_of_all, table_of_case
from jentry.flight import Outcome
from jentry.missions import find_mission
from jentry.missions.benchmark_cases import CASES, BenchmarkCase


WORDS = ("benchmark", "--cases", "cheap", "--sets", 2, "--runs", 20, "--step", 2)
WORDS += ("--out", "out")

OWN_LAW = """
import jentry
from jentry import Controls, Scalar, scalar


class HalfBank(jentry.AbstractContinuousLaw[None]):
    bank: Scalar = scalar(unit="rad")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        return Controls.from_bank(self.bank, measurement.trim_angle_of_attack), None


def law(scenario):
    return HalfBank(bank=0.5 * scenario.guidance.bank_angle)


LAW = law
"""


@pytest.fixture
def benchmark(command, monkeypatch):
    """The command, with a cheap case among the cases, and no measurement of time."""
    cheap = BenchmarkCase(
        "cheap", "cheap", ("right", "steep"), ("all",), resolution=1.0
    )
    monkeypatch.setitem(CASES, "cheap", cheap)
    cost = {
        "flights_per_second": 5.0,
        "flights": 40,
        "machine": "M",
        "measured_on": "D",
    }
    monkeypatch.setattr(benchmark_runs, "_flights_a_second", lambda *given: cost)
    return lambda *more: command(*WORDS, *more)


def record(folder="out"):
    with open(f"{folder}/benchmark.json") as file:
        return json.load(file)


def row(printed, name):
    """Cells of the first row with a name."""
    (line, *_) = (x for x in printed.splitlines() if re.match(rf"│ {name} +│", x))
    return [cell.strip() for cell in line.strip("│").split("│")]


def test_a_table_that_is_equal_to_the_last_digit(benchmark, command, tmp_path):
    code, printed, said = benchmark()
    assert code == 0 and "cheap, steep" in said
    found = record()
    (case,) = found["cases"]
    assert [law["name"] for law in case["laws"]] == ["right", "steep"]
    assert (found["seed"], found["sets"], case["runs_in_a_set"]) == (0, 2, 20)
    for law in case["laws"]:
        results = open_campaign(tmp_path / "out" / "cheap" / law["name"])
        reached = results["outcome"].values == Outcome.REACHED
        miss = np.hypot(results["downrange_error"], results["crossrange_error"]).values
        large = np.where(reached, miss, 1e99)
        for percentile in (50, 95):
            there = law["statistics"][f"miss_over_ground_percentile_{percentile}"]
            expected = np.percentile(large, percentile)
            if expected > 1e90:
                assert there["value"] == "lost"
            else:
                assert there["value"] == pytest.approx(expected, rel=1e-12)
        assert law["statistics"]["failures"]["value"] == 1.0 - np.mean(reached)
        needs = law["statistics"]["miss_over_ground_percentile_99"]
        assert (needs["value"], needs["needs_runs"], needs["sets"]) == (None, 100, [])
    assert "needs 100 flights" in row(printed, "right")
    assert (tmp_path / "out" / "benchmark.html").read_text().count("<figure>") == 1
    # Again in the folder, where all is stored; and in another one.
    files = {x: x.stat().st_mtime_ns for x in tmp_path.glob("out/cheap/*/runs-*")}
    before = (tmp_path / "out" / "benchmark.json").read_bytes()
    assert benchmark()[1] == printed
    assert files == {
        x: x.stat().st_mtime_ns for x in tmp_path.glob("out/cheap/*/runs-*")
    }
    assert (tmp_path / "out" / "benchmark.json").read_bytes() == before
    assert benchmark("--out", "again", "--quiet") == (0, "", "")
    assert (tmp_path / "again" / "benchmark.json").read_bytes() == before
    # Laid beside itself, each law has a second row with equal numbers.
    code, printed, _ = benchmark("--beside", "again/benchmark.json")
    assert code == 0
    twice = row(printed, r"right \(again/benchmark.json\)")
    assert twice[1:] == row(printed, "right")[1:]
    assert f"again/benchmark.json: jentry {found['versions']['jentry']}, " in printed
    # Another seed cannot be continued, nor laid beside.
    assert_refused(benchmark("--seed", 1), "out holds a benchmark with seed 0")
    words = "--seed", 1, "--out", "other", "--beside", "again/benchmark.json"
    assert_refused(benchmark(*words), "has seed 0, and this benchmark 1")
    words = "--sets", 3, "--beside", "again/benchmark.json"
    assert_refused(benchmark(*words), "has sets 2, and this benchmark 3")
    words = "--runs", 21, "--beside", "again/benchmark.json"
    assert_refused(benchmark(*words), "has sets of 20 runs in cheap")
    # A file that lies.
    text = before.decode().replace('"sets": 2', '"sets": 3')
    (tmp_path / "lie.json").write_text(text)
    words = "--sets", 3, "--beside", "lie.json"
    assert_refused(benchmark(*words), "was changed since it was written")
    (tmp_path / "else.json").write_text('{"kind": "summary"}')
    assert_refused(benchmark("--beside", "else.json"), "is of the kind 'summary'")


@pytest.mark.slow
def test_it_resumes_after_a_stop(benchmark, monkeypatch, tmp_path):
    assert benchmark("--out", "whole")[0] == 0
    fly = benchmark_runs.run_campaign

    def stopped(out, *given, **options):
        if out.name == "steep":
            raise KeyboardInterrupt
        fly(out, *given, **options)

    with monkeypatch.context() as patch:
        patch.setattr(benchmark_runs, "run_campaign", stopped)
        code, _, said = benchmark()
    assert code == 130 and "interrupted; the same command resumes" in said
    assert not (tmp_path / "out" / "benchmark.json").exists()
    first = {x: x.stat().st_mtime_ns for x in tmp_path.glob("out/cheap/right/*")}
    assert first
    assert benchmark()[0] == 0
    assert first == {x: x.stat().st_mtime_ns for x in first}
    assert record() == record("whole")


@pytest.mark.slow
def test_a_law_of_ones_own_has_its_row(benchmark, tmp_path):
    (tmp_path / "half.py").write_text(OWN_LAW)
    code, printed, _ = benchmark("--law", "half.py")
    assert code == 0
    (case,) = record()["cases"]
    assert [(x["name"], x["own"]) for x in case["laws"]] == [
        ("right", False),
        ("steep", False),
        ("half", True),
    ]
    assert len({law["draws"] for law in case["laws"]}) == 1
    assert row(printed, "half")[1].endswith("± 0.00")
    results = open_campaign(tmp_path / "out" / "cheap" / "half")
    assert json.loads(results.attrs["campaign"])["code"].keys() == {"half.py"}
    # Alone, by its name.
    code, printed, _ = benchmark("--law", "half.py", "--laws", "half", "--out", "alone")
    assert code == 0 and [x["name"] for x in record("alone")["cases"][0]["laws"]] == [
        "half"
    ]
    # Changed, it does not continue the flights of the former law.
    (tmp_path / "half.py").write_text(OWN_LAW.replace("0.5 *", "0.6 *"))
    code, _, said = benchmark("--law", "half.py", "--laws", "half", "--quiet")
    assert code == 3 and "half holds another campaign: code.half.py differs" in said


def test_a_case_of_ones_own(benchmark, tmp_path):
    text = (
        "import dataclasses, cheap\n"
        "MISSION = dataclasses.replace(cheap.MISSION, name='mine', "
        "laws={'right': cheap.scenario})\n"
    )
    (tmp_path / "my_case.py").write_text(text)
    words = "--case", "my_case.py", "--cases", "mine", "--json"
    code, printed, said = benchmark(*words)
    assert (code, said) == (0, "")
    (case,) = json.loads(printed)["cases"]
    assert (case["name"], case["measure"], case["laws"][0]["name"]) == (
        "mine",
        "miss_distance",
        "right",
    )


REFUSED = {
    "case": (("--cases", "chaep"), "no case 'chaep' to fly; nearest: cheap"),
    "cases": (("--cases", "cheap,,"), "write names, separated by commas"),
    "law": (("--laws", "left"), "no case has a law 'left'; nearest: "),
    "name of a law": (("--law", "right"), "give a file that defines LAW"),
    "no file": (("--law", "nowhere.py"), "there is no file"),
    "name of a case": (("--case", "cheap"), "give a file that defines MISSION"),
    "short": (("--short",), "leave out --sets and --runs"),
    "runs": (("--runs", 0), "--runs is 0: it must be 1 or more"),
    "step": (("--step", 0), "step is 0.0 s"),
    "both": (("--json", "--quiet"), "give one of them"),
}


@pytest.mark.parametrize(("words", "said"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(benchmark, tmp_path, words, said):
    assert_refused(benchmark(*words), said)
    assert not list(tmp_path.glob("**/*.nc"))


FILES = {
    "nothing": ("", "defines no LAW: end it with LAW = "),
    "a number": ("LAW = 3", "is 3: it must be a law, or a function"),
    "a class": (OWN_LAW + "\nLAW = HalfBank", "is the class HalfBank"),
    "no law": ("def law(scenario): return 1\nLAW = law", "LAW of mine makes a int"),
    "error": (
        "def law(scenario):\n    return scenario.nothing\nLAW = law",
        "mine.py, line 2: AttributeError",
    ),
    "syntax": ("LAW =", "mine.py, line 1"),
}


@pytest.mark.parametrize(("text", "said"), FILES.values(), ids=FILES)
def test_files_that_are_no_law(benchmark, tmp_path, text, said):
    (tmp_path / "mine.py").write_text(text)
    assert_refused(benchmark("--law", "mine.py"), said)


def test_a_file_with_the_name_of_a_law(benchmark, tmp_path):
    (tmp_path / "steep.py").write_text(OWN_LAW)
    assert_refused(
        benchmark("--law", "steep.py"), "has the name of a law of mission cheap"
    )


def test_a_law_that_does_not_fly_somewhere_is_reported(benchmark, monkeypatch):
    """The other laws of the case fly."""
    case = BenchmarkCase("cheap", "cheap", ("right", "left"), ("all",))
    monkeypatch.setitem(CASES, "cheap", case)
    code, printed, _ = benchmark()
    assert code == 0
    assert "left does not fly in cheap: mission cheap has no law 'left'" in printed
    assert record()["skipped"][0]["law"] == "left"


def statistic(value, needs=None, deviation=None):
    return {
        "unit": "m",
        "value": value,
        "needs_runs": needs,
        "deviation_of_sets": deviation,
    }


def law(name, value, rank):
    named = {f"e_percentile_{p}": statistic(value) for p in ("50", "95", "99")}
    named["e_percentile_99.9"] = statistic(None, 1000)
    for each in ("failures", "nominal", "mean_bank_rate", "bank_reversals"):
        named[each] = statistic(0.25, deviation=0.5)
    return {
        "name": name,
        "draws": "x",
        "other_draws": "",
        "dispersions": "all",
        "rank": {"value": rank, "lower": None, "upper": None},
        "statistics": named,
    }


def case_of(name, *laws):
    more = {"mission": name, "case": None, "worlds": [], "measure": "e"}
    return {"name": name, "runs_in_a_set": 9, "resolution": 2.0, "laws": laws, **more}


def test_cells_of_a_table():
    case = case_of("a", law("one", 1500.0, 1.0), law("two", "lost", 2.0))
    one, two = table_of_case(case, 4, {}).rows
    assert one[:3] == ["one", "25.00 ± 50.00", "0.000250 ± 0.000500"]
    assert one[3:7] == [*3 * ["1.5000"], "needs 1000 flights"]
    assert one[7] == "no limits" and one[-1] == "1"
    assert two[3:6] == 3 * ["lost"]


def test_profile_of_all_cases():
    """A law has no share of a case in which it does not fly, or in which it is lost."""
    record = {
        "profile_factors": [1.0, 10.0],
        "cases": [
            case_of("a", law("one", 1.0, 1.0), law("two", 1.5, 2.0)),
            case_of("b", law("one", 100.0, 2.0), law("two", 10.0, 1.0)),
            case_of("c", law("one", "lost", 2.0), law("six", 9.0, 1.0)),
            case_of("d", law("two", 7.0, 1.0), law("six", 15.0, 2.0)),
            case_of("alone", law("six", 7.0, 1.0)),
        ],
    }
    # Equal below the resolution in a. A case with one law does not count.
    assert shares_of_cases(record) == {
        "one": [0.25, 0.5],
        "two": [0.75, 0.75],
        "six": [0.25, 0.5],
    }
    found = table_of_all(record)
    rows = {row[0]: row[1:] for row in found.rows}
    assert rows["one"] == ["3", "1", "2", "1.6667"]
    assert found.notes == ["without cases in which one law flies: alone"]
    assert table_of_all({**record, "cases": record["cases"][-1:]}) is None


@pytest.mark.parametrize("name", CASES)
def test_every_case_names_what_its_mission_has(name):
    case = CASES[name]
    mission = find_mission(case.mission)
    assert set(case.laws) <= set(mission.laws) and len(case.laws) > 1
    assert set(case.dispersions) <= set(mission.dispersions)
    assert set(case.worlds) <= set(mission.worlds)
    assert case.case is None or case.case in mission.cases
