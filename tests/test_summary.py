"""What a campaign says: every number of it, in every form, against numpy."""

import csv
import html.parser
import io
import json
import math

import numpy as np
import pytest
import xarray

from jentry.cli.campaign_report import print_summary
from jentry.cli.html_page import page_of
from jentry.flight import Outcome
from jentry.statistics.acceptance import Requirement
from jentry.statistics.miss_ellipse import ellipse_of
from jentry.statistics.summary import RADII, Caveat, Summary, summarize
from jentry.units import degree


RUNS = 400


def campaign(runs=RUNS, seed=0, **more):
    """Errors that are normal with a covariance of its own, two of them without an end."""
    draws = np.random.default_rng(seed)
    turned = np.array([[math.cos(0.4), -math.sin(0.4)], [math.sin(0.4), math.cos(0.4)]])
    along, across = turned @ (draws.normal(size=(2, runs)) * [[3e3], [1e3]]) + [
        [500],
        [0],
    ]
    outcomes = np.zeros(runs, np.int8)
    outcomes[:2] = Outcome.NOT_FINITE
    outcomes[2:3] = Outcome.CRASHED
    load = draws.uniform(1.0, 3.0, runs)
    variables = {
        "vehicle.mass": (np.linspace(900.0, 1100.0, runs), {"units": "kg"}),
        "outcome": (outcomes, {"units": "1", "flag_values": [0]}),
        "end_time": (draws.normal(300.0, 4.0, runs), {"units": "s"}),
        "end_altitude": (draws.normal(9e3, 4.0, runs), {"units": "m"}),
        "downrange_error": (along, {"units": "m"}),
        "crossrange_error": (across, {"units": "m"}),
        "miss_distance": (np.hypot(along, across), {"units": "m"}),
        "peak_load_factor": (load, {"units": "1", "shown_units": "g", "limit": 2.5}),
        "low_cycles": (draws.uniform(0, 1, runs) ** 9, {"units": "1", "caveat": 1}),
        **more,
    }
    described = {
        "mission": "cheap",
        "law": "right",
        "seed": 3,
        "versions": {"jax": "1"},
    }
    return xarray.Dataset(
        {name: ("run", *rest) for name, rest in variables.items()},
        {"run": np.arange(runs)},
        {"campaign": json.dumps(described)},
    )


REQUIREMENTS = [
    Requirement.of("|downrange_error| < 20 km, 95 % at 90 %"),
    Requirement.of("downrange_error < 500 m, 95 % at 90 %"),
]


@pytest.fixture(scope="module")
def results():
    return campaign()


@pytest.fixture(scope="module")
def summary(results) -> Summary:
    return summarize(results, (50.0, 99.0, 99.87), REQUIREMENTS)


def test_statistics_are_of_the_finite_flights(results, summary):
    assert (summary.runs, summary.finite) == (RUNS, RUNS - 2)
    assert summary.outcomes == {
        Outcome.REACHED: (RUNS - 3, 0),
        Outcome.CRASHED: (1, 0),
        Outcome.NOT_FINITE: (2, 2),
    }
    told = {each.words: each for each in summary.statistics}
    assert set(told) == {
        *("end time", "downrange error", "|downrange error|", "crossrange error"),
        *("|crossrange error|", "miss distance", "peak load factor"),
    }
    for words, each in told.items():
        values = results[each.name].values[2:]
        values = np.abs(values) if words.startswith("|") else values
        numbers = (each.minimum, each.maximum, each.mean.value)
        assert numbers == (values.min(), values.max(), values.mean())
        assert each.standard_deviation.value == pytest.approx(np.std(values, ddof=1))
        for p, interval in each.percentiles.items():
            assert interval.value == np.percentile(values, p)
            assert not interval.lower > interval.value
        assert math.isnan(each.percentiles[99.87].upper)  # of 398 runs
    assert told["downrange error"].shown_unit == "km"
    assert told["peak load factor"].shown_unit == "g"


def test_limits_and_caveats(results, summary):
    (limit,) = summary.limits
    load = results["peak_load_factor"].values[2:]
    assert (limit.name, limit.limit, limit.beyond) == (
        *("peak_load_factor", 2.5),
        np.sum(load > 2.5),
    )
    shares = results["low_cycles"].values
    assert summary.caveats == {"low_cycles": Caveat(RUNS, shares.max())}


def test_json_has_all_of_it_to_the_last_digit(results, summary):
    told = json.loads(summary.as_json())
    assert told["campaign"]["mission"] == "cheap" and told["campaign"]["seed"] == 3
    assert (told["runs"], told["finite_flights"]) == (RUNS, RUNS - 2)
    assert told["outcomes"]["not_finite"] == {"runs": 2, "left_out": 2}
    assert told["intervals"]["confidence"] == 0.95
    by_name = {each["quantity"]: each for each in told["statistics"]}
    error = by_name["|downrange_error|"]
    values = np.abs(results["downrange_error"].values[2:])
    assert error["mean"]["value"] == values.mean() and error["unit"] == "m"
    assert error["percentiles"]["99.87"]["upper"] is None
    assert [v["decision"] for v in told["requirements"]] == ["passes", "fails"]
    assert told["requirements"][0]["requirement"] == REQUIREMENTS[0].text
    assert set(told["miss_ellipse"]["radii"]) == {"50", "90", "99"}


def test_csv_has_the_same_numbers(summary):
    rows = list(csv.DictReader(io.StringIO(summary.as_csv())))
    told = {
        each["quantity"]: each for each in json.loads(summary.as_json())["statistics"]
    }
    assert len(rows) == len(told) * (2 + 2 + 3)
    for row in rows:
        each = told[row["quantity"]]
        assert row["unit"] == each["unit"]
        name = row["statistic"]
        if name.startswith("percentile_"):
            expected = each["percentiles"][name.removeprefix("percentile_")]
        else:
            expected = each[name]
        if name in ("minimum", "maximum"):
            assert (
                float(row["value"]) == expected and row["lower"] == row["upper"] == ""
            )
        else:
            for part in ("value", "lower", "upper"):
                number = float(row[part]) if row[part] else None
                assert number == expected[part]


def test_one_run_and_none():
    one = summarize(campaign(4).isel(run=[3]))
    told = json.loads(one.as_json())
    mean = told["statistics"][0]["mean"]
    assert mean["value"] is not None and mean["lower"] is mean["upper"] is None
    nothing = summarize(campaign(2))
    assert (nothing.finite, nothing.statistics, nothing.ellipse) == (0, [], None)
    json.loads(nothing.as_json())
    page_of("nothing", nothing, {})


# Misses over the ground.


def test_the_ellipse_of_a_normal_distribution():
    """Standard deviations of 3 and 1 km, turned by 0.4 rad, about 500 m: each to three of
    its standard errors, s / sqrt(2 n) and s / sqrt(n).
    """
    runs = 40_000
    found = ellipse_of(campaign(runs), RADII)
    assert found is not None
    for axis, truth in zip(found.semi_axes, (3e3, 1e3), strict=True):
        assert axis == pytest.approx(truth, abs=3 * truth / math.sqrt(2 * runs))
    assert found.angle == pytest.approx(0.4, abs=3 * 3 / 8 / math.sqrt(runs))
    assert found.mean[0] == pytest.approx(500.0, abs=3 * 2.8e3 / math.sqrt(runs))
    assert found.mean[1] == pytest.approx(0.0, abs=3 * 1.5e3 / math.sqrt(runs))
    for p, share in found.inside.items():
        error = math.sqrt(p / 100 * (1 - p / 100) / runs)
        assert share == pytest.approx(p / 100, abs=3 * error)


def test_circles_and_outlines():
    results = campaign()
    found = ellipse_of(results, RADII)
    assert found is not None
    errors = np.stack(
        [results[f"{n}_error"].values for n in ("downrange", "crossrange")]
    )
    distance = np.hypot(*errors)
    for p, radius in found.radii.items():
        assert radius.value == pytest.approx(np.percentile(distance, p))
        assert radius.lower < radius.value
    # Of each point on the outline the Mahalanobis distance is that of the percentage:
    # chi-squared with two degrees has the quantile -2 ln(1 - p).
    inverse = np.linalg.inv(np.cov(errors))
    for p in RADII:
        away = found.outline(p) - errors.mean(axis=1)[:, None]
        squares = np.einsum("ij,ik,kj->j", away, inverse, away)
        np.testing.assert_allclose(squares, -2 * math.log(1 - p / 100), rtol=1e-9)
        inside = np.einsum(
            "ij,ik,kj->j",
            *(errors - errors.mean(axis=1)[:, None],),
            inverse,
            errors - errors.mean(axis=1)[:, None],
        )
        assert found.inside[p] == np.mean(inside <= -2 * math.log(1 - p / 100))


@pytest.mark.parametrize("turn", [-1.5, -0.7, 0.0, 0.7, 1.5])
def test_the_angle_of_the_larger_axis(turn):
    draws = np.random.default_rng(1).normal(size=(2, 20_000)) * [[2e3], [20.0]]
    cosine, sine = math.cos(turn), math.sin(turn)
    errors = np.array([[cosine, -sine], [sine, cosine]]) @ draws
    results = campaign(20_000).assign(
        downrange_error=("run", errors[0]), crossrange_error=("run", errors[1])
    )
    found = ellipse_of(results, RADII)
    assert found is not None and found.angle == pytest.approx(turn, abs=1e-3)


def test_a_flight_in_a_plane_has_no_ellipse():
    results = campaign()
    flat = results.assign(crossrange_error=1e-9 * results["crossrange_error"])
    assert ellipse_of(flat, RADII) is None
    assert ellipse_of(results.drop_vars("crossrange_error"), RADII) is None
    assert ellipse_of(results.isel(run=slice(2)), RADII) is None


# What is printed, and the page.


def test_what_is_printed_has_the_numbers(summary, capsys):
    print_summary("cheap", summary, full=True)
    printed = capsys.readouterr().out
    assert f"{RUNS - 3} of {RUNS} runs reached the end" in printed
    lines = [line for line in printed.splitlines() if line.startswith("│")]
    cells = [[c.strip() for c in line.strip("│").split("│")] for line in lines]
    means = [row for row in cells if row[0] == "|downrange error|"]
    each = next(s for s in summary.statistics if s.words == "|downrange error|")
    assert means[0][4] == f"{each.mean.value / 1e3:.4f}"
    assert means[1][2] == f"{each.mean.lower / 1e3:.4f} … {each.mean.upper / 1e3:.4f}"
    assert means[1][-1].endswith("… -")  # too few runs for an upper bound
    ellipse = summary.ellipse
    assert ellipse is not None
    rows = {row[0]: row for row in cells}
    assert (
        rows["radius about the target"][2] == f"{ellipse.radii[50.0].value / 1e3:.4f}"
    )
    reach = math.sqrt(-2 * math.log(0.5)) * ellipse.semi_axes[0] / 1e3
    assert rows["larger semi-axis of the ellipse"][2] == f"{reach:.4f}"
    assert f"{ellipse.angle / degree:.4f} deg from downrange" in printed
    assert rows[REQUIREMENTS[0].text][1:3] == ["passes", str(RUNS)]
    assert "has a sign, actual minus desired" in " ".join(printed.split())
    assert "2 of the failures are runs without an end" in " ".join(printed.split())


class Page(html.parser.HTMLParser):
    """A page, with what it asks for."""

    def __init__(self, text):
        super().__init__()
        self.open, self.asks, self.text, self.rows = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.asks += [v for name, v in attrs if name in ("src", "href")]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in ("meta", "link", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += f" {data}"


def test_the_page_stands_alone_and_has_the_numbers(summary):
    picture = b"\x89PNG not a real one"
    text = page_of("A <b> & c", summary, {"end_errors": picture})
    page = Page(text)
    assert not page.open
    assert "A <b> & c" in page.text
    assert all(asked.startswith("data:") for asked in page.asks) and len(page.asks) == 2
    assert "http" not in text and "url(" not in text and "@import" not in text
    rows = {row[0].strip(): [cell.split() for cell in row] for row in page.rows if row}
    each = next(s for s in summary.statistics if s.words == "|downrange error|")
    told = rows["|downrange error|"]
    assert told[3] == [f"{each.maximum / 1e3:.4f}"]
    low, high = each.mean.lower / 1e3, each.mean.upper / 1e3
    assert told[4] == [f"{each.mean.value / 1e3:.4f}", f"{low:.4f}", "…", f"{high:.4f}"]
    assert rows[REQUIREMENTS[0].text][1] == ["passes"]
    assert rows[REQUIREMENTS[1].text][1] == ["fails"]
    joined = " ".join(" ".join(page.text).split())
    assert "mission cheap, law right, seed 3, jax 1" in joined
    assert "2 of 400 runs stopped where" in joined and "2 of them left out" in joined
    assert "exceed the limit of the peak load factor, 2.5 g" in joined
    assert "flights have low cycles" in joined and "end errors" in joined
