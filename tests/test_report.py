"""What the commands print: every number and unit, against arithmetic done here."""

import dataclasses
import itertools
import re

import cheap
import numpy as np
import pytest
import xarray
from helpers import fly_compiled

from jentry.campaign.results import output_names
from jentry.cli.campaign_report import SETS, print_campaign, print_summary
from jentry.cli.mission_report import print_flight
from jentry.flight import Outcome, misses
from jentry.missions import ALL
from jentry.statistics.summary import summarize
from jentry.units import degree, km


def rows(printed):
    """Cells of each line of the printed tables, by the first one; of the first such."""
    lines = [line for line in printed.splitlines() if line.startswith("│")]
    cells = [[cell.strip() for cell in line.strip("│").split("│")] for line in lines]
    return {first: rest for first, *rest in reversed(cells)}


def stored(values, outcomes=None):
    """A campaign as it is read from a folder: name -> (values, unit)."""
    count = len(next(iter(values.values()))[0])
    columns = {
        name: ("run", np.asarray(numbers, float), {"units": unit})
        for name, (numbers, unit) in values.items()
    }
    outcomes = np.zeros(count) if outcomes is None else outcomes
    columns["outcome"] = ("run", np.asarray(outcomes, np.int8), {"units": "1"})
    return xarray.Dataset(columns, {"run": np.arange(count)})


# Statistics.


def test_statistics_and_units(capsys):
    """0 to 100 in any order: each percentile is its own number, the mean 50, and the
    squared deviations sum to 2 (1 + 4 + ... + 2500) = 85850, over 100 for a sample.
    """
    order = np.random.default_rng(0).permutation(101)
    statistics = [0, 100, 50, np.sqrt(858.5), 1, 5, 50, 95, 99]
    quantities = {
        "end time": ("s", 1.0, "s"),
        "crossrange error": ("m", 1e3, "km"),
        "heading error": ("rad", degree, "deg"),
        "velocity error": ("m/s", 1.0, "m/s"),
        "miss distance": ("m", 1e-2, "m"),  # nowhere as far as 10 m
        "peak drag": ("m/s2", 1.0, "m/s2"),
        "peak dynamic pressure": ("Pa", 1e3, "kPa"),
        "peak heat rate": ("W/m2", 1e4, "W/cm2"),
        "peak load factor": ("1", 1.0, "1"),
    }
    results = stored(
        {
            words.replace(" ", "_"): (order * size, unit)
            for words, (unit, size, _) in quantities.items()
        }
        | {"vehicle.mass": (900.0 + order, "kg"), "end_altitude": (order, "m")}
    )
    print_campaign(
        dataclasses.replace(cheap.MISSION, published=()), results, True, full=True
    )
    printed = capsys.readouterr().out
    table = rows(printed)
    for words, (_, _, unit) in quantities.items():
        size = 1e-2 if words == "miss distance" else 1.0
        expected = [unit, *(f"{size * x:.4f}" for x in statistics)]
        assert table.pop(words) == expected
        if words.endswith("error"):
            assert table.pop(f"|{words}|") == expected
    assert not table  # neither inputs nor the state itself
    assert "101 of 101 runs reached the end of guided flight\n" in printed
    assert "cheap: 101 finite flights, errors are actual minus desired" in printed


def test_signs_are_of_the_error_and_magnitudes_beside_it(capsys):
    results = stored({"downrange_error": ([-3e3, 1e3, -1e3, 4e-3], "m")})
    print_campaign(cheap.MISSION, results, False, full=True)
    table = rows(capsys.readouterr().out)
    assert table["downrange error"][:4] == ["km", "-3.0000", "1.0000", "-0.7500"]
    # 4 mm is 4e-6 km, which is not zero.
    assert table["|downrange error|"][:4] == ["km", "4.0e-06", "3.0000", "1.2500"]


@pytest.mark.parametrize("outcome", [Outcome.REACHED, Outcome.NOT_FINITE])
def test_one_flight_that_is_not_finite(capsys, outcome):
    """It is counted, and the statistics are those of the others."""
    errors = [1e3, 2e3, np.nan, 6e3]
    outcomes = [Outcome.REACHED, Outcome.CRASHED, outcome, Outcome.REACHED]
    results = stored({"downrange_error": (errors, "m")}, outcomes)
    print_campaign(cheap.MISSION, results, False, full=True)
    printed = capsys.readouterr().out
    assert rows(printed)["downrange error"][:5] == [
        *["km", "1.0000", "6.0000", "3.0000"],
        f"{np.sqrt(7.0):.4f}",  # squares of -2, -1 and 3, over two
    ]
    assert "nan" not in printed
    assert "cheap: 3 finite flights" in printed
    assert "1 of 4 runs met the surface\n" in printed
    ended = 3 if outcome is Outcome.REACHED else 1
    said = f"{ended} of 4 runs {outcome.message}; 1 of them left out of the statistics"
    assert said in " ".join(printed.split())


def test_no_flight_and_one_flight(capsys):
    nothing = stored({"downrange_error": ([np.nan], "m")}, [Outcome.NOT_FINITE])
    print_campaign(cheap.MISSION, nothing, False, full=True)
    printed = capsys.readouterr().out
    assert "1 of 1 runs stopped where" in printed and not rows(printed)
    assert "1 of them left out of the statistics" in " ".join(printed.split())
    print_campaign(
        cheap.MISSION, stored({"downrange_error": ([2e3], "m")}), False, full=True
    )
    # One number has no standard deviation.
    assert rows(capsys.readouterr().out)["downrange error"][:5] == [
        *["km", "2.0000", "2.0000", "2.0000", "-"]
    ]


# What a campaign ends with.


def short_rows(printed):
    """Cells of the short table by the words of their row."""
    lines = printed.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("──"))
    found = {}
    for line in lines[first + 1 :]:
        cells = re.split(r"\s{2,}", line.strip())
        if len(cells) < 7:
            break
        found[cells[0]] = cells[1:]
    return found


def test_the_short_table_has_what_is_aimed_at_and_limited(capsys):
    """-100 to 0 m in any order: mean -50, magnitudes 0 to 100. A peak without a limit
    counts where the mission is tuned for it."""
    order = np.random.default_rng(0).permutation(101)
    results = stored(
        {
            "downrange_error": (-1.0 * order, "m"),
            "crossrange_error": (1e-11 * order, "m"),
            "end_time": (1.0 * order, "s"),
            "peak_drag": (1.0 * order, "m/s2"),
            "peak_heat_rate": (1e4 * order, "W/m2"),
            "peak_dynamic_pressure": (1e3 * order, "Pa"),
        }
    )
    results["peak_heat_rate"].attrs["limit"] = 89.5e4
    tuned = dataclasses.replace(cheap.MISSION, published=(), tuned_for=("drag=1m/s2",))
    print_campaign(tuned, results, False)
    printed = capsys.readouterr().out
    deviation = f"{np.sqrt(858.5):.4g}"
    assert short_rows(printed) == {
        "downrange error": ["km", "-0.05", "0.0293", "0.05", "0.095", "0.099", "0.1"],
        "peak drag": ["m/s2", "50", deviation, "50", "95", "99", "100"],
        "peak heat rate": ["W/cm2", "50", deviation, "50", "95", "99", "100", "11"],
    }
    assert "not shown, since they do not vary: crossrange error\n" in printed
    assert "2 more quantities" in printed and "report FOLDER --full" in printed
    assert "magnitudes" in printed and "exceed the limit" in printed


def test_percentiles_that_are_asked_for_are_those_of_the_short_table(capsys):
    results = stored({"downrange_error": (np.arange(1.0, 102.0), "m")})
    print_summary("cheap", summarize(results, [10.0, 99.87]))
    heads = next(x for x in capsys.readouterr().out.splitlines() if "unit" in x)
    assert heads.split() == "unit mean std 10 % 99.87 % maximum".split()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=[] if name == "mars-drag-tracking" else pytest.mark.slow
        )
        for name in ALL
    ],
)
def test_the_short_table_fits_100_columns(capsys, name):
    """With numbers of any size and sign, and every limit that the mission has."""
    mission = ALL[name]
    scenario = mission.scenario()
    spread = np.random.default_rng(1).normal(size=40)
    sizes = itertools.cycle([-1.2345e-9, 1.2345e-4, -0.012345, 12345.6, -1234567.0])
    values = {}
    for output in output_names(scenario):
        numbers = next(sizes) * (1.0 + spread), unit_of_output(output, scenario)
        values[output] = numbers
    results = stored(values)
    for constraint in scenario.constraints:
        results[f"peak_{constraint}"].attrs["limit"] = 1.0
    print_campaign(dataclasses.replace(mission, published=()), results, False)
    lines = capsys.readouterr().out.splitlines()
    table = lines[lines.index(next(x for x in lines if "unit" in x)) :]
    table = table[: table.index(next(x for x in table if "magnitudes" in x))]
    assert len(table) > 4
    assert max(map(len, (line.rstrip() for line in table))) <= 100


def unit_of_output(output, scenario):
    if output.startswith("peak_"):
        known = scenario.constraints.get(output.removeprefix("peak_"))
        return "1" if known is None else known.unit
    for word, unit in (("angle", "rad"), ("heading", "rad"), ("velocity", "m/s")):
        if word in output:
            return unit
    return "s" if output == "end_time" else "m"


# Published values.

SIZE = cheap.MISSION.published_runs


def test_published_values_beside_a_population(capsys):
    """Its sets are taken apart here by numpy alone; the last runs are in no set."""
    times = np.random.default_rng(1).normal(301.0, 2.0, SETS * SIZE + SIZE - 1)
    print_campaign(cheap.MISSION, stored({"end_time": (times, "s")}), True)
    printed = capsys.readouterr().out
    means = times[: SETS * SIZE].reshape(SETS, SIZE).mean(axis=1)
    spread = means.std(ddof=1)
    assert 0 < np.sum(means < 300.0) < SETS
    assert rows(printed)["mean time"] == [
        *["s", "300.0000", f"{means.mean():.4f}", f"{spread:.4f}"],
        f"{(300.0 - means.mean()) / spread:+.1f}",
        f"{np.sum(means < 300.0)} of {SETS}",
    ]
    assert f"{SETS} sets of {SIZE} runs against A note" in printed


def test_fewer_sets_are_not_compared_with_published_values(capsys):
    """One set near to the paper is luck: it is said what would be a comparison."""
    few = stored({"end_time": (np.full(SETS * SIZE - 1, 300.0), "s")})
    print_campaign(cheap.MISSION, few, True)
    printed = capsys.readouterr().out
    assert "A note" not in printed and "mean time" not in rows(printed)
    assert f"--runs {SETS * SIZE} compares them with {SETS} sets" in printed


def test_sets_that_are_all_equal_have_no_spread_to_count_in(capsys):
    same = stored({"end_time": (np.full(SETS * SIZE, 301.0), "s")})
    print_campaign(cheap.MISSION, same, True)
    assert rows(capsys.readouterr().out)["mean time"][2:] == [
        *["301.0000", "0.0000", "-", f"0 of {SETS}"]
    ]


def test_a_flight_that_is_not_finite_is_in_no_set(capsys):
    times = np.full(SETS * SIZE, 299.0)
    times[SIZE] = np.nan
    print_campaign(cheap.MISSION, stored({"end_time": (times, "s")}), True)
    assert rows(capsys.readouterr().out)["mean time"][2:] == [
        *["299.0000", "0.0000", "-", f"{SETS} of {SETS}"]
    ]


# One flight.


def test_flight_and_units(capsys):
    scenario = cheap.scenario()
    flight = fly_compiled(scenario, cheap.SOLVER)
    print_flight(cheap.MISSION, scenario, flight)
    table = rows(capsys.readouterr().out)
    missed = misses(scenario, flight)
    state, peaks = flight.state, flight.peaks
    assert table.pop("time") == [f"{float(flight.time):.4f}", "s"]
    expected = {
        "altitude": (state.altitude, km, "km"),
        "longitude": (state.longitude, degree, "deg"),
        "latitude": (state.latitude, degree, "deg"),
        "velocity": (state.velocity, 1.0, "m/s"),
        "flight-path angle": (state.flight_path_angle, degree, "deg"),
        "heading": (state.heading, degree, "deg"),
        "downrange error": (missed.downrange, km, "km"),
        "crossrange error": (missed.crossrange, km, "km"),
        "altitude error": (missed.altitude, km, "km"),
        "velocity error": (missed.velocity, 1.0, "m/s"),
        "miss distance": (missed.distance, km, "km"),
        "peak drag": (peaks.drag, 1.0, "m/s2"),
        "peak dynamic pressure": (peaks.dynamic_pressure, 1e3, "kPa"),
        "peak heat rate": (peaks.heat_rate, 1e4, "W/cm2"),
        "peak load factor": (peaks.load_factor, 1.0, "g"),
    }
    assert set(table) == set(expected)
    for words, (value, size, unit) in expected.items():
        assert table[words] == [f"{float(value) / size:z.6f}", unit], words


def test_a_limit_is_told_in_the_unit_of_the_tables(capsys):
    values = {
        "peak_load_factor": (
            "run",
            [2.4, 2.6, 2.7],
            {"shown_units": "g", "limit": 2.5},
        ),
        "peak_heat_rate": ("run", [5e5, 7e5, 4e5], {"units": "W/m2", "limit": 6e5}),
        "peak_drag": ("run", [1.0, 2.0, 3.0], {"units": "m/s2"}),
    }
    values["peak_load_factor"][2]["units"] = "1"
    values["outcome"] = ("run", np.zeros(3, np.int8), {"units": "1"})
    results = xarray.Dataset(values, {"run": np.arange(3)})
    print_summary("cheap", summarize(results))
    printed = capsys.readouterr().out.splitlines()
    assert printed[1:3] == [
        "2 of 3 flights exceed the limit of the peak load factor, 2.5 g",
        "1 of 3 flights exceed the limit of the peak heat rate, 60 W/cm2",
    ]
