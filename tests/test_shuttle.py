"""The Shuttle's re-entry: against Betts's equations by scipy, and the published optima."""

import dataclasses
import functools

import numpy as np
import pytest
import shuttle_by_hand as by_hand
from helpers import choices, fly_compiled
from pages import assert_same, published

from jentry.missions import find_mission
from jentry.planning.control_splines import free_part
from jentry.planning.flight_problem import best_flight
from jentry.units import degree, foot


MISSION = find_mission("shuttle")
BTU = 1055.05585262 / foot**2
"""W/m2 of a Btu/(ft2 s)"""


def test_the_published_table_has_the_published_latitudes():
    saved = published("shuttle")
    for choice in choices(MISSION):
        cell = saved[f"`{choice}`", "latitude at the end, deg"]
        value = MISSION.problem().published[choice] / degree
        assert cell.published == pytest.approx(value, abs=1e-9)


def assert_as_saved(choice, flight):
    saved = published("shuttle")
    latitude = float(flight.state.latitude) / degree
    assert_same(saved[f"`{choice}`", "latitude at the end, deg"], latitude)
    assert_same(saved[f"`{choice}`", "time, s"], flight.time)


@functools.cache
def found(variant, nodes=40):
    problem = dataclasses.replace(MISSION.problem(), nodes=nodes)
    return best_flight(MISSION.scenario_of(variant), problem)


def flown_by_hand(best):
    controls = free_part(best.scenario)
    angle, bank = (
        by_hand.spline(each.breakpoints, each.coefficients)
        for each in (controls.angle_of_attack, controls.bank)
    )
    return by_hand.fly(angle, bank)


def assert_same_end(flight, state, time, hottest):
    """Steps of 2 s leave some centimetres, and the peak is that at a step."""
    end = flight.state
    assert float(flight.time) == pytest.approx(time, abs=1e-3)
    assert float(end.altitude) / foot == pytest.approx(state[0], abs=1.0)
    assert float(end.velocity) / foot == pytest.approx(state[3], abs=0.05)
    for name, place in (("longitude", 1), ("latitude", 2), ("heading", 5)):
        assert float(getattr(end, name)) == pytest.approx(state[place], abs=1e-7)
    path = float(end.flight_path_angle)
    assert path == pytest.approx(state[4], abs=1e-3 * degree)
    assert float(flight.peaks.wing_heat_rate) / BTU == pytest.approx(hottest, rel=1e-3)


def test_constant_controls():
    flight = fly_compiled(MISSION.scenario())
    assert_same_end(flight, *by_hand.fly(lambda e: 20 * degree, lambda e: -45 * degree))


@pytest.mark.slow
@pytest.mark.optimized
def test_few_nodes():
    """An optimum of ten nodes: below the best, above what it began with, and real."""
    best = found("glide", 10)
    assert_same_end(best.flight, *flown_by_hand(best))
    assert_published_end(best.flight)
    latitude = float(best.flight.state.latitude) / degree
    assert -best.at_start / degree + 5.0 < latitude < 34.1412
    assert best.slope_left < 1e-3
    end = float(best.flight.state.latitude)
    assert -best.objective == pytest.approx(end, rel=1e-14)  # compiled apart


def assert_published_end(flight):
    """To one foot and a thousandth of a degree; the velocity follows from the energy."""
    end = flight.state
    assert abs(float(end.altitude) / foot - 80e3) < 1.0
    assert abs(float(end.velocity) / foot - 2500.0) < 0.05
    assert abs(float(end.flight_path_angle) / degree + 5.0) < 1e-3


@pytest.mark.slow
@pytest.mark.optimized
def test_cross_range_of_the_literature():
    """34.1412 deg at 2008.59 s; this one has 40 nodes, and no more than the best."""
    best = found("glide")
    assert_published_end(best.flight)
    assert 34.140 <= float(best.flight.state.latitude) / degree <= 34.1413
    assert float(best.flight.time) == pytest.approx(2008.59, abs=0.1)
    assert_same_end(best.flight, *flown_by_hand(best))
    assert_as_saved("glide", best.flight)


@pytest.mark.slow
@pytest.mark.optimized
def test_cross_range_with_limited_heating():
    """30.6255 deg at 2198.67 s; the limit is kept every 10 s, and between to 0.1 %."""
    best = found("glide case limited-heating")
    assert_published_end(best.flight)
    latitude = float(best.flight.state.latitude) / degree
    assert latitude == pytest.approx(30.6255, abs=0.01)
    assert float(best.flight.time) == pytest.approx(2198.67, abs=5.0)
    kept = best.constraints["wing_heat_rate"] / BTU
    assert np.nanmax(kept) == pytest.approx(70.0, rel=1e-6)
    assert float(best.flight.peaks.wing_heat_rate) / BTU < 70.0 * 1.001
    assert len(best.active["wing_heat_rate"]) > 20
    assert np.all(best.multipliers["wing_heat_rate"] <= 0.0)
    assert_as_saved("glide case limited-heating", best.flight)
    assert_same_end(best.flight, *flown_by_hand(best))
