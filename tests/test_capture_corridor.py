"""The entry corridor against bisection with scipy, and the floor of the increment."""

import numpy as np
import pytest
from helpers import fly_compiled
from pages import assert_same, published
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator
from scipy.optimize import bisect

from jentry.flight import FixedStep, Outcome, misses
from jentry.missions import find_mission
from jentry.missions.mars_aerocapture.scenario import _AIR, entry
from jentry.planning import best_flight, capture_corridor
from jentry.units import degree


RADIUS, MU, SPIN = 3393.94e3, 4.282829e13, 7.088218e-5
MASS, AREA, SINE, COSINE = 1089.0, 14.7, np.sin(-27.5 * degree), np.cos(27.5 * degree)
DRAG = 1.269 * COSINE - 0.205 * SINE
LIFT = -0.205 * COSINE - 1.269 * SINE
AIR = PchipInterpolator(5e3 * np.arange(len(_AIR)), np.log(_AIR))


def density(altitude):
    return np.exp(AIR(min(max(altitude, 0.0), 125e3)))


def apoapsis_error(path, up):
    """Reciprocal of the apoapsis radius over that of the target, less 1, by vectors in the
    inertial frame: positive if the flight is braked too much."""
    heading = 38.04 * degree
    speed = 5687.0
    place = np.array([RADIUS + 120e3, 0.0, 0.0])
    level = np.array([0.0, np.sin(heading), np.cos(heading)])
    velocity = speed * (np.sin(path) * np.array([1.0, 0, 0]) + np.cos(path) * level)
    spin = np.array([0.0, 0.0, SPIN])
    velocity = velocity + np.cross(spin, place)

    def slope(_, y):
        place, velocity = y[:3], y[3:]
        r = np.linalg.norm(place)
        wind = velocity - np.cross(spin, place)
        v = np.linalg.norm(wind)
        along, above = wind / v, place / r
        normal = above - (above @ along) * along
        normal /= np.linalg.norm(normal)
        force = 0.5 * density(r - RADIUS) * v * v * AREA / MASS
        air = force * (up * LIFT * normal - DRAG * along)
        return np.concatenate([velocity, air - MU / r**3 * place])

    def high(_, y):
        return np.linalg.norm(y[:3]) - RADIUS - 125e3

    def low(_, y):
        return np.linalg.norm(y[:3]) - RADIUS

    high.terminal = low.terminal = True
    solved = solve_ivp(
        slope,
        (0.0, 1500.0),
        np.concatenate([place, velocity]),
        rtol=1e-9,
        atol=1e-4,
        events=(high, low),
    )
    place, velocity = solved.y[:3, -1], solved.y[3:, -1]
    momentum = np.cross(place, velocity)
    vector = np.cross(velocity, momentum) / MU - place / np.linalg.norm(place)
    latus = momentum @ momentum / MU
    inverse = (1.0 - np.linalg.norm(vector)) / latus
    return inverse * (RADIUS + 500e3) - 1.0


@pytest.mark.slow
def test_the_corridor_is_that_of_bisection_in_scipy():
    found = capture_corridor(entry())
    for limit, up in ((found.shallow, -1.0), (found.steep, 1.0)):
        at = float(limit)
        theirs = bisect(
            lambda path, up=up: apoapsis_error(path, up),
            at - 0.02,
            at + 0.02,
            xtol=1e-7,
        )
        # Steps of 1 s, and a table whose cubic differs a little from scipy's.
        assert at == pytest.approx(theirs, abs=0.01 * degree)
    assert float(found.steep) < -10.24 * degree < float(found.shallow)
    assert float(found.width) == float(found.shallow) - float(found.steep)
    saved = published("mars aerocapture corridor")
    row = "`jentry corridor mars-aerocapture`"
    for name in ("shallow", "steep"):
        cell = saved[row, f"{name} limit, deg"]
        assert_same(cell, float(getattr(found, name)) / degree)


def test_a_corridor_that_is_not_there_is_refused():
    with pytest.raises(
        ValueError, match="lift upwards, the apoapsis .* not between -9"
    ):
        capture_corridor(entry(), -9 * degree, -5 * degree, FixedStep(4.0))
    with pytest.raises(ValueError, match="steepest < shallowest"):
        capture_corridor(entry(), -5 * degree, -9 * degree)
    lander = find_mission("mars-range-tracking").scenario()
    with pytest.raises(ValueError, match="target is a place"):
        capture_corridor(lander)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "case"),
    [("mars-aerocapture", "free-plane"), ("neptune-aerocapture", None)],
)
def test_the_law_is_not_better_than_the_floor_and_near_to_it(name, case):
    mission = find_mission(name)
    scenario = mission.scenario(case=case)
    best = best_flight(scenario, mission.problem())
    missed = misses(best.scenario, best.flight)
    floor = float(missed.velocity_increment)
    assert best.flight.outcome == Outcome.REACHED
    # Of 500 km, and of 400 000 km.
    assert abs(float(missed.apoapsis)) < 2e-5 * float(scenario.target.apoapsis_altitude)
    law = float(misses(scenario, fly_compiled(scenario)).velocity_increment)
    assert floor < law < 1.1 * floor
    saved = published(f"{name.replace('-', ' ')} floor")
    column = "velocity increment, m/s"
    assert_same(saved["best flight", column], floor)
    assert_same(saved["law", column], law)
