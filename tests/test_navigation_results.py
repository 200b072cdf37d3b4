"""What campaigns, reports and figures say of a navigation that is not perfect."""

import dataclasses
import json

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank
from matplotlib.figure import Figure
from test_navigation import windy

from jentry.addresses import replace_leaves
from jentry.campaign import (
    Dispersion,
    Normal,
    add,
    monte_carlo,
    open_campaign,
    run_campaign,
)
from jentry.campaign.outputs import is_output
from jentry.campaign.results import OutputNamed, dataset, output_names
from jentry.cli.campaign_report import print_summary
from jentry.cli.html_page import page_of
from jentry.cli.mission_report import print_flight
from jentry.flight import (
    FixedStep,
    Outcome,
    Target,
    Termination,
    VelocityBelow,
    believed_misses,
    navigation_errors,
)
from jentry.flight.scenario_checks import check
from jentry.motion import MachNumber
from jentry.onboard import (
    InertialNavigation,
    KnowledgeError,
    PerfectAccelerometers,
    TrackError,
)
from jentry.plots import campaign_figures, draw_navigation_errors
from jentry.plots.figure_data import FigureData
from jentry.plots.one_flight import flight_figures
from jentry.statistics import Requirement, consistency_of, judged, summarize
from jentry.statistics.acceptance import require_outputs
from jentry.units import degree, km


HEADING = 70 * degree
"""The direction of the entry of `windy`"""

RUNS, SOLVER, INTERVAL = 32, FixedStep(0.5), 10.0

TABLE = {
    "delivery": Dispersion(
        lambda s: s.initial_state.altitude, Normal(0.0, 500.0), apply=add
    ),
    "knowledge": Dispersion(lambda s: s.navigation.knowledge.up, Normal(0.0, 100.0)),
    "speed": Dispersion(
        lambda s: s.navigation.knowledge.velocity_east, Normal(0.0, 0.5)
    ),
}


def open_loop():
    """Constant bank, believed to be 1 km ahead at the start; the parachute opens at the
    velocity that is believed."""
    ahead = 1.0 * km * np.array([np.sin(HEADING), np.cos(HEADING)])
    scenario = windy(
        InertialNavigation(KnowledgeError(*ahead)),
        PerfectAccelerometers(),
        seconds=60.0,
    )
    limit = {"parachute": VelocityBelow(4900.0, by="navigation")}
    return dataclasses.replace(
        scenario,
        guidance=ConstantBank(0.9),
        target=Target(10 * km, 503.0, 600 * km),
        termination=Termination(limit, 60.0),
        constraints={**scenario.constraints, "mach": MachNumber()},
        values_at_end=("mach", "dynamic_pressure"),
    )


@pytest.fixture(scope="module")
def campaign():
    key = jax.random.key(0)
    return monte_carlo(open_loop(), TABLE, key, RUNS, solver=SOLVER, history=INTERVAL)


@pytest.fixture(scope="module")
def results(campaign):
    return dataset(open_loop(), campaign, INTERVAL)


@pytest.fixture(scope="module")
def summary(results):
    return summarize(results)


def first(campaign):
    """The first flight, and its scenario."""
    inputs = {address: values[0] for address, values in campaign.inputs.items()}
    flight = jax.tree.map(lambda x: jnp.asarray(x[0]), campaign.flights)
    return replace_leaves(open_loop(), inputs), flight


def along_and_across(longitude, latitude):
    """Arcs from the start along and to the left of its heading, m, by unit vectors."""
    start = open_loop().initial_state
    lon, lat = float(start.longitude), float(start.latitude)
    here = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    ahead = np.sin(HEADING) * east + np.cos(HEADING) * np.cross(here, east)
    there = np.stack(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    along = np.arctan2(ahead @ there, here @ there)
    across = np.arcsin(np.cross(here, ahead) @ there)
    return 3397 * km * along, 3397 * km * across


def test_the_vehicle_reports_its_miss_with_the_error_of_its_navigation(results):
    """Against great circles by unit vectors: 1 km ahead at the start remains 1 km."""
    ends = {n: results[f"end_{n}"].values for n in ("longitude", "latitude")}
    known = {n: results[f"end_navigated_{n}"].values for n in ends}
    actual, believed = along_and_across(**ends), along_and_across(**known)
    desired = 600 * km, 0.0
    for place, name in enumerate(("downrange_error", "crossrange_error")):
        # Rounding of arcs of 2e5 m, through an arc sine.
        for values, found in (
            (actual[place] - desired[place], results[name]),
            (believed[place] - desired[place], results[f"believed_{name}"]),
            (believed[place] - actual[place], results[f"navigation_{name}"]),
        ):
            np.testing.assert_allclose(found, values, rtol=0, atol=1e-6)
    ahead = results["navigation_downrange_error"].values
    # Arcs on the ground are shorter than those at 70 km; 40 s at 0.5 m/s add 20 m.
    np.testing.assert_allclose(ahead, 1 * km * 3397.0 / 3467.0, atol=80.0)
    assert np.ptp(ahead) > 10.0
    for name, desired in (("altitude", 10 * km), ("velocity", 503.0)):
        known = results[f"end_navigated_{name}"].values
        np.testing.assert_array_equal(
            results[f"believed_{name}_error"], known - desired
        )
        np.testing.assert_allclose(
            results[f"navigation_{name}_error"],
            known - results[f"end_{name}"].values,
            rtol=0,
            atol=1e-9,
        )
    square = sum(
        np.square(results[f"believed_{name}_error"].values)
        for name in ("downrange", "crossrange", "altitude")
    )
    np.testing.assert_allclose(results["believed_miss_distance"] ** 2, square)
    assert results["believed_downrange_error"].attrs["comment"] == (
        "believed minus desired"
    )
    assert results["navigation_heading_error"].attrs == {
        "units": "rad",
        "long_name": "navigation heading error",
        "comment": "believed minus actual",
    }


def test_knowledge_and_delivery_apart(campaign, results):
    """The believed start is off by both."""
    off = results["navigated_altitude"] - results["altitude"]
    knowledge = campaign.inputs["navigation.knowledge.up"]
    np.testing.assert_allclose(off.values[:, 0], knowledge, atol=1e-8)
    assert results["end_navigated_altitude"].attrs["units"] == "m"
    ends = results["navigation_altitude_error"]
    assert np.all(np.isfinite(ends)) and np.corrcoef(ends, knowledge)[0, 1] > 0.999
    assert abs(np.corrcoef(results["end_altitude"], knowledge)[0, 1]) < 0.6


def test_stored_runs_have_all_of_it(results, tmp_path):
    given = dict(solver=SOLVER, history=INTERVAL)
    run_campaign(tmp_path, open_loop(), TABLE, 0, RUNS, **given)
    stored = open_campaign(tmp_path)
    assert {*stored.data_vars} == {*results.data_vars}
    for name in map(str, stored.data_vars):
        np.testing.assert_array_equal(stored[name], results[name], err_msg=name)
        assert stored[name].attrs.get("comment") == results[name].attrs.get("comment")


def test_outputs_are_known_without_a_flight_and_are_functions_of_one(campaign, results):
    names = output_names(open_loop())
    assert sorted(names) == sorted(filter(is_output, map(str, results.data_vars)))
    scenario, flight = first(campaign)
    for name in names:
        found = float(OutputNamed(name)(scenario, flight))
        expected = float(results[name].values[0])
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9), name


def test_perfect_navigation_has_none_of_it(campaign):
    for name in output_names(cheap.scenario()):
        assert not name.startswith(("believed_", "navigation_", "end_navigated_")), name
    scenario, flight = first(campaign)
    perfect = dataclasses.replace(flight, navigated=None)
    assert believed_misses(scenario, perfect) is None
    assert navigation_errors(scenario, perfect) is None


def test_the_box_of_a_parachute(results):
    """Mach number and dynamic pressure where the parachute opens are actual ones."""
    altitude, speed, path, heading = (
        results[f"end_{n}"].values
        for n in ("altitude", "velocity", "flight_path_angle", "heading")
    )
    assert np.all(results["outcome"] == Outcome.REACHED)
    np.testing.assert_allclose(results["end_navigated_velocity"], 4900.0, atol=1e-6)
    assert np.abs(speed - 4900.0).max() > 0.1
    over = speed * [
        np.cos(path) * np.sin(heading),
        np.cos(path) * np.cos(heading),
        np.sin(path),
    ]
    airspeed = np.linalg.norm(over - np.array([[60.0], [-35.0], [4.0]]), axis=0)
    density = 0.0158 * np.exp(-altitude / 9354.5)
    pressure = 0.5 * density * airspeed**2
    np.testing.assert_allclose(results["end_dynamic_pressure"], pressure, rtol=1e-10)
    air = open_loop().planet.atmosphere
    sound = np.sqrt(
        float(air.heat_capacity_ratio * air.gas_constant * air.isothermal_temperature)
    )
    np.testing.assert_allclose(results["end_mach"], airspeed / sound, rtol=1e-12)
    # Here the dynamic pressure still rises: its peak is that of the end.
    assert np.all(results["end_dynamic_pressure"] <= results["peak_dynamic_pressure"])

    # Half way between two runs.
    order = np.sort(pressure)
    low, high = 0.5 * (order[:-1] + order[1:])[[2, -4]]
    for text, failures in (
        (f"end_dynamic_pressure > {low:.9f} Pa, 50 % at 90 %", 3),
        (f"end_dynamic_pressure < {high:.9f} Pa, 50 % at 90 %", 4),
        (f"end_mach < {np.max(airspeed) / sound + 1.0}, 50 % at 90 %", 0),
        ("|navigation_downrange_error| < 2 km, 50 % at 90 %", 0),
        ("believed_miss_distance < 1 km, 50 % at 90 %", RUNS),
    ):
        requirement = Requirement.of(text)
        require_outputs([requirement], open_loop(), [])
        assert judged(results, requirement).failures == failures, text
    cautious = Requirement.of("navigation_altitude_error < 1 km, 50 % at 90 %")
    assert "has a sign, believed minus actual" in str(cautious.caution)


def test_values_at_the_end_are_of_constraints_of_the_scenario():
    mach = MachNumber()
    for constraints, names, told in (
        ({"mach": mach}, ("Mach",), "values_at_end has 'Mach', which is no constraint"),
        ({"altitude": mach}, ("altitude",), "the results have another end_altitude"),
    ):
        scenario = dataclasses.replace(
            cheap.scenario(), constraints=constraints, values_at_end=names
        )
        with pytest.raises(ValueError, match=told):
            check(scenario)


def test_reports_have_the_believed_miss_beside_the_actual_one(
    campaign, results, summary, capsys
):
    print_summary("open loop", summary)
    lines = capsys.readouterr().out.splitlines()
    words = [line[:23].strip() for line in lines]
    place = words.index("downrange error")
    assert words[place + 1 : place + 3] == ["believed", "navigation"]
    place = words.index("miss distance")
    assert words[place + 1] == "believed"
    mean = float(results["believed_miss_distance"].mean()) / km
    assert lines[place + 1].split()[1:3] == ["km", f"{mean:.4g}"]
    # All runs end at the same believed velocity, so that this one stands alone.
    assert words[words.index("velocity error") + 1] == "navigation"
    note = "navigation: believed minus actual"
    assert sum(note in line for line in lines) == 1
    page = page_of("Open loop", summary, {})
    assert note in page
    assert page.index("believed downrange error") < page.index(">crossrange error")

    scenario, flight = first(campaign)
    print_flight(cheap.MISSION, scenario, flight)
    lines = capsys.readouterr().out.splitlines()
    rows = {
        x[0]: x[1:]
        for x in ([c.strip() for c in y.split("│")[1:-1]] for y in lines)
        if x
    }
    for name in ("altitude", "altitude error", "miss distance"):
        assert rows[name][1] == "km"
    actual, believed = (
        float(results[n].values[0]) / km
        for n in ("miss_distance", "believed_miss_distance")
    )
    assert rows["miss distance"] == [f"{actual:.6f}", "km", f"{believed:.6f}"]
    pressure = float(results["end_dynamic_pressure"].values[0])
    assert rows["dynamic pressure at the end"][0] == f"{pressure / 1e3:.6f}"
    assert any("what the vehicle would report" in line for line in lines)


def test_the_figure_has_the_errors_over_time(campaign, results):
    scenario, flight = first(campaign)
    deviations = {"altitude": np.full((RUNS, results.sizes["time"]), 100.0)}
    figure = draw_navigation_errors(scenario, results, "Title", deviations)
    alone = draw_navigation_errors(scenario, flight.history)
    assert figure.get_suptitle() == "Title"
    assert len(figure.axes) == len(alone.axes) == 4
    off = (results["navigated_altitude"] - results["altitude"]).values
    axes = figure.axes[2]
    *runs, zero, above, below = (line.get_ydata() for line in axes.lines)
    np.testing.assert_array_equal(runs, off / km)
    assert set(zero) == {0.0} and set(above) == {0.3} and set(below) == {-0.3}
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["32 runs", "3 standard deviations"]
    assert axes.get_ylabel() == "Altitude, believed minus actual (km)"
    np.testing.assert_array_equal(alone.axes[2].lines[0].get_ydata(), off[0] / km)
    # Along the heading at the start these are the arcs of the knowledge error.
    ahead, left = (figure.axes[i].lines[0].get_ydata()[0] for i in (0, 1))
    start = float(results["altitude"].values[0, 0])
    expected = 3397 * km / (3397 * km + start)
    assert ahead == pytest.approx(expected, rel=1e-4)
    assert left == pytest.approx(0.0, abs=1e-3)

    data = FigureData.of(results, results, None, scenario)
    from jentry.plots.campaign import navigation

    assert isinstance(campaign_figures(data, {"n": navigation})["n"], Figure)
    with pytest.raises(ValueError, match="deviations has 'up': choose from downrange"):
        draw_navigation_errors(scenario, results, deviations={"up": [1.0]})
    with pytest.raises(ValueError, match="no histories of navigated states"):
        draw_navigation_errors(scenario, results.drop_dims("time"))
    perfect = dataclasses.replace(flight.history, navigated=None)
    with pytest.raises(ValueError, match="navigation is perfect"):
        draw_navigation_errors(scenario, perfect)


# The filter: its results are put into those of the flights above.


def with_filter(results, values):
    """Results with normalised errors squared at the end."""
    described = {"units": "1", "long_name": "normalised error squared"}
    return results.assign({"end_normalised_error_squared": ("run", values, described)})


@pytest.mark.parametrize(
    ("average", "judgement", "place"),
    [
        (9.0, "consistent", "1, within"),
        (27.0, "too sure: its errors are larger than it says", "3, above"),
        (4.5, "too careful: its errors are smaller than it says", "0.5, below"),
    ],
)
def test_reports_say_whether_the_filter_is_consistent(
    results, average, judgement, place, capsys
):
    """The bounds are quantiles of chi-square with 9 x 32 = 288 degrees of freedom, over
    288, which sums of its density give."""
    values = average + np.linspace(-1.0, 1.0, RUNS)
    summary = summarize(with_filter(results, values))
    print_summary("open loop", summary)
    said = " ".join(capsys.readouterr().out.split())
    expected = (
        f"the navigation filter is {judgement}. Mean of the normalised error squared at "
        f"the end, over its 9 components: {place} the chi-square bounds LOWER and "
        f"UPPER (99 % of sets of 32 runs)"
    )
    lower, upper = quantiles(288)
    expected = expected.replace("LOWER", f"{lower:.4g}").replace(
        "UPPER", f"{upper:.4g}"
    )
    assert expected in said
    assert expected in page_of("Open loop", summary, {})
    told = json.loads(summary.as_json())["navigation_filter"]
    assert told["consistent"] == (average == 9.0)
    assert told["average"] == pytest.approx(average)


def quantiles(degrees):
    """0.5 and 99.5 % of chi-square, over its degrees of freedom, from its density."""
    x = np.linspace(0.3, 2.0, 200_001)
    density = np.exp((0.5 * degrees - 1.0) * np.log(x) - 0.5 * degrees * (x - 1.0))
    below = np.cumsum(density) / np.sum(density)
    return np.interp([0.005, 0.995], below, x)


def test_flights_that_do_not_count_are_left_out_of_the_consistency(results):
    assert consistency_of(results) is None
    values = np.full(RUNS, 9.0)
    values[0], values[1] = np.nan, -1.0
    found = consistency_of(with_filter(results, values))
    assert (found.runs, found.average, found.not_positive) == (30, 9.0, 1)
    assert not found.holds and "covariance of 1 flight, left out" in found.words
    found = consistency_of(with_filter(results, np.full(RUNS, -1.0)))
    assert found.runs == 0 and found.words.endswith("is not positive")
    assert consistency_of(with_filter(results, np.full(RUNS, np.nan))) is None


def with_knowledge(campaign):
    """The campaign as if a filter had said 100, 200, 300 m and 4 m/s at the start, and a
    hundredth of it later; its altimeter measured seven values."""
    count = campaign.flights.history.time.shape
    falling = np.where(np.arange(count[1]) == 0, 1.0, 0.01) * np.ones(count)
    sizes = TrackError(*(x * falling for x in (100.0, 200.0, 300.0, 4.0)))
    return eqx.tree_at(
        lambda c: (
            c.flights.history.knowledge.track_deviation,
            c.flights.knowledge.measured,
        ),
        campaign,
        (sizes, {"altimeter": np.full(RUNS, 7.0)}),
        is_leaf=lambda x: x is None or isinstance(x, dict) and not x,
    )


def test_the_figure_has_the_deviations_of_the_filter(campaign):
    """Of a campaign and of one flight, without being asked for them."""
    known = with_knowledge(campaign)
    results = dataset(open_loop(), known, INTERVAL)
    assert set(results["altimeter_measured"].values) == {7.0}
    assert results["navigation_downrange_deviation"].attrs["units"] == "m"
    names = sorted(filter(is_output, map(str, results.data_vars)))
    assert names == sorted(output_names(open_loop()))
    scenario, _ = first(campaign)
    history = jax.tree.map(lambda x: jnp.asarray(x[0]), known.flights.history)
    for flown in (results, history):
        figure = draw_navigation_errors(scenario, flown)
        for axes, start in zip(figure.axes, (0.1, 0.2, 0.3, 4.0), strict=True):
            *_, above, below = (line.get_ydata() for line in axes.lines)
            expected = [3.0 * start, 0.03 * start, 0.03 * start]
            np.testing.assert_allclose(above[:3], expected, rtol=1e-12)
            np.testing.assert_array_equal(above, -below)
            assert axes.get_yscale() == "symlog"
            labels = [text.get_text() for text in axes.get_legend().get_texts()]
            assert labels[-1] == "3 sigma of the filter"
    (*_, zero) = (
        x.get_ydata()
        for x in draw_navigation_errors(scenario, results, deviations={}).axes[0].lines
    )
    assert set(zero) == {0.0}


def test_figures_of_one_flight(campaign):
    """Errors of the navigation beside the flight, unless navigation is perfect."""
    scenario, flight = first(campaign)
    assert [*flight_figures(scenario, flight, "Title", "a")] == ["a", "a-navigation"]
    perfect = dataclasses.replace(flight.history, navigated=None)
    alone = dataclasses.replace(flight, history=perfect)
    assert [*flight_figures(scenario, alone)] == ["flight"]
