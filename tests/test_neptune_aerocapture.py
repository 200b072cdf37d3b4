"""The Neptune orbiter: its corridor beside AMAT and scipy, and its law."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, with_leaf
from pages import ROOT, assert_same, assert_says, benchmark, published
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import bisect

from jentry._computed_once import computed_once
from jentry.flight import FixedStep, Outcome, misses
from jentry.missions import find_mission
from jentry.missions.neptune_aerocapture.scenario import _AIR
from jentry.motion import EntryState, OrbitTarget, orbit_of
from jentry.onboard.measurement import measure
from jentry.planning import capture_corridor
from jentry.units import degree, km


RADIUS, SPIN, MU, J2 = 24622e3, 1.083385e-4, 6.8365299e15, 3411e-6
"""AMAT/planet.py"""
BALLISTIC, LIFT_TO_DRAG, VELOCITY, TOP, APOAPSIS = 200.0, 0.4, 28e3, 1000e3, 400e6
"""Example 11 of AMAT"""
AMAT_LIMITS = -12.7393, -13.7081
"""tests/test_girija2020.py of AMAT, deg: lift down, lift up"""

AIR = CubicSpline(10e3 * np.arange(len(_AIR)), np.log(_AIR))


@computed_once
def mission():
    return find_mission("neptune-aerocapture")


@computed_once
def scenario():
    return mission().scenario()


def braked_too_much(
    path,
    lift,
    *,
    j2,
    inertial,
    prograde=1.0,
    altitude=TOP,
    velocity=VELOCITY,
    mass=1000.0,
):
    """Reciprocal of the apoapsis radius over that of the target, less 1, of a flight in
    the equator: r, V and gamma, by the equations of Vinh."""

    ballistic = BALLISTIC * mass / 1000.0

    def slope(_, y):
        r, v, gamma = y
        drag = 0.5 * np.exp(AIR(min(r - RADIUS, 1010e3))) * v * v / ballistic
        pull = MU / r**2 * (1.0 + 1.5 * j2 * (RADIUS / r) ** 2) - SPIN**2 * r
        turn = (lift * LIFT_TO_DRAG * drag - pull * np.cos(gamma)) / v
        turn += v / r * np.cos(gamma) + 2.0 * SPIN * prograde
        return [v * np.sin(gamma), -drag - pull * np.sin(gamma), turn]

    def left(_, y):
        return y[0] - RADIUS - TOP - 1e3

    def fallen(_, y):
        return y[0] - RADIUS

    left.terminal = fallen.terminal = True
    start = [RADIUS + altitude, velocity, path]
    tolerances = {"rtol": 1e-9, "atol": [1e-2, 1e-5, 1e-11]}
    ends = solve_ivp(slope, (0.0, 4000.0), start, events=(left, fallen), **tolerances)
    r, v, gamma = ends.y[:, -1]
    level = v * np.cos(gamma) + (SPIN * r * prograde if inertial else 0.0)
    energy = 0.5 * (level**2 + (v * np.sin(gamma)) ** 2) - MU / r
    momentum = r * level
    eccentricity = np.sqrt(1.0 + 2.0 * energy * (momentum / MU) ** 2)
    return (1.0 - eccentricity) * MU / momentum**2 * (RADIUS + APOAPSIS) - 1.0


def limit(lift, start, **how):
    """Flight-path angle, deg, near which the search begins."""
    ends = (start - 0.05) * degree, (start + 0.05) * degree
    angle = bisect(lambda x: braked_too_much(x, lift, **how), *ends, xtol=1e-7)
    return angle / degree


def test_the_limits_that_amat_prints_come_out_of_its_definition():
    """So the frame of its entry is that of its equations, and towards east."""
    for lift, printed in zip((-1.0, 1.0), AMAT_LIMITS, strict=True):
        found = limit(lift, printed, j2=J2, inertial=False)
        # A table every 10 km in place of 5 km; the print has four decimals.
        assert found == pytest.approx(printed, abs=3e-4)


def test_the_case_is_that_of_amat():
    start, vehicle = scenario().initial_state, scenario().vehicle
    assert float(start.altitude) == TOP and float(start.velocity) == VELOCITY
    assert float(start.heading) == pytest.approx(90 * degree)
    assert float(start.flight_path_angle) == pytest.approx(-13.85 * degree)
    lift, drag = (
        float(getattr(vehicle.aerodynamics, f"{name}_coefficient"))
        for name in ("lift", "drag")
    )
    ballistic = float(vehicle.mass) / (drag * float(vehicle.reference_area))
    assert ballistic == pytest.approx(BALLISTIC)
    assert lift / drag == pytest.approx(LIFT_TO_DRAG)
    planet, target = scenario().planet, scenario().target
    assert float(planet.radius) == RADIUS and float(planet.rotation_rate) == SPIN
    assert float(planet.gravity.gravitational_parameter) == MU
    assert float(target.apoapsis_altitude) == APOAPSIS
    # Eastwards with a planet that turns eastwards: prograde, in the equator.
    orbit = orbit_of(planet, start)
    assert float(orbit.inclination) == 0.0 and not bool(orbit.is_bound)


def test_dispersions_are_those_of_amat():
    table = mission().dispersion_table()
    spreads = {n: float(d.distribution.moments()[1]) for n, d in table.items()}
    assert spreads == pytest.approx(
        {"flight_path_angle": 0.11 * degree, "density": 0.1, "lift": 0.013 / 0.40}
    )


@pytest.mark.slow
def test_the_corridor_is_that_of_bisection_in_scipy():
    found = capture_corridor(scenario())
    for name, lift in (("shallow", -1.0), ("steep", 1.0)):
        angle = float(getattr(found, name)) / degree
        theirs = limit(lift, angle, j2=0.0, inertial=True)
        # Steps of 1 s, and another cubic of the table.
        assert angle == pytest.approx(theirs, abs=5e-4)
        oblate = limit(lift, angle, j2=J2, inertial=True)
        assert_says("corridor by 0.013 degrees", oblate - theirs)
    saved = published("neptune aerocapture corridor")
    row = "`jentry corridor neptune-aerocapture`"
    for name, value in (("shallow", found.shallow), ("steep", found.steep)):
        assert_same(saved[row, f"{name} limit, deg"], value / degree)


@pytest.mark.slow
def test_westwards_the_corridor_is_another_one():
    """Retrograde: a heading of 270 degrees, where Coriolis pushes down."""
    said = "Towards west the corridor lies between -9.19 and -9.68 degrees"
    west = eqx.tree_at(lambda s: s.initial_state.heading, scenario(), 270 * degree)
    found = capture_corridor(west)
    assert_says(said, float(found.shallow) / degree, float(found.steep) / degree)
    for name, lift in (("shallow", -1.0), ("steep", 1.0)):
        angle = float(getattr(found, name)) / degree
        theirs = limit(lift, angle, j2=0.0, inertial=True, prograde=-1.0)
        assert angle == pytest.approx(theirs, abs=5e-4)


@pytest.mark.slow
def test_a_flight_that_stops_in_the_air_is_refused():
    """With steps of 4 s a steep one stops at the speed of the entry, on a hyperbola."""
    with pytest.raises(ValueError, match="from -20 deg stopped where its steps were"):
        capture_corridor(scenario(), solver=FixedStep(4.0))
    end = scenario().termination.conditions["escaped"].altitude
    high = eqx.tree_at(lambda s: s.initial_state.altitude, scenario(), end)
    with pytest.raises(ValueError, match="from -20 deg began where an end condition"):
        capture_corridor(high, solver=FixedStep(4.0))


@pytest.mark.slow
def test_flights_of_our_own_have_the_limits_of_amat(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    saved = published("neptune aerocapture corridor")
    row = "as AMAT: J2, apoapsis of the relative velocity"
    found = benchmark("published").corridor_as_in_amat()
    names = "shallow limit, deg", "steep limit, deg"
    for name, angle, printed in zip(names, found, AMAT_LIMITS, strict=True):
        assert angle / degree == pytest.approx(printed, abs=3e-4)
        assert_same(saved[row, name], angle / degree)
        assert saved[row, name].published == printed


decided = eqx.filter_jit(
    lambda law, time, state, held: law.update(
        time, measure(law.model.planet, law.model.vehicle, state, 0.0 * time), (), held
    )[1]
)


def decisions(begun, number, path, cycles, *, altitude, velocity, **of_the_law):
    """Decisions of the law in a state in the equator, from a number: the cosine of the
    bank if the second phase has begun, or the time to it, s."""
    state = EntryState(altitude, 0.0, 0.0, velocity, path, 90 * degree)
    law, time = law_with(**of_the_law), jnp.asarray(1.0)
    _, held = law.init(measure(law.model.planet, law.model.vehicle, state, 0.0 * time))
    number = jnp.asarray(number)
    if begun:
        held = dataclasses.replace(held, exits=jnp.ones(()), cos_bank=number)
    else:
        held = dataclasses.replace(held, switches_at=time + number)
    for _ in range(cycles):
        held = decided(law, time, state, held)
        yield float(held.cos_bank if begun else held.switches_at - time)


def law_with(apoapsis=APOAPSIS, mass=1000.0):
    law = with_leaf(scenario().law, lambda x: x.model.vehicle.mass, mass)
    return dataclasses.replace(law, orbit=OrbitTarget(apoapsis, 0.0))


def test_late_in_the_climb_more_lift_upwards_is_taken_where_it_lowers_the_apoapsis():
    state = {"path": 5.57 * degree, "altitude": 356e3, "velocity": 20.1 * km}
    lower = {"path": 4.91 * degree, "altitude": 312e3, "velocity": 20.2 * km}

    def apoapsis(cosine, **state):
        braked = braked_too_much(lift=cosine, j2=0.0, inertial=True, **state)
        return (RADIUS + APOAPSIS) / (1.0 + braked) - RADIUS

    start, aim = -0.8, 0.1
    said = (
        "At 356 km on the way up more lift upwards leads to a lower apoapsis, at 312 km"
    )
    assert_says(said, *(x["altitude"] / km for x in (state, lower)))
    assert apoapsis(start, **lower) + 100 * km < apoapsis(aim, **lower)
    goal = apoapsis(aim, **state)
    assert apoapsis(start, **state) - 40 * km > goal
    *_, found = decisions(True, start, cycles=3, apoapsis=goal, **state)
    # Scipy has no lift to the side.
    assert apoapsis(found, **state) == pytest.approx(goal, abs=2 * km)


def test_a_bank_that_leads_to_the_ground_is_left_whatever_its_slope_is():
    """A vehicle so heavy that it reaches the ground has more energy there with less lift,
    since it is there sooner."""
    state = {"path": -1.0 * degree, "altitude": 30e3, "velocity": 25.0 * km}

    def braked(cosine):
        return braked_too_much(lift=cosine, j2=0.0, inertial=True, mass=1e6, **state)

    assert braked(-0.4) > braked(-0.5) > 1.0
    *_, found = decisions(True, -0.5, cycles=4, mass=1e6, **state)
    # Scipy has no lift to the side.
    assert found == pytest.approx(bisect(braked, 0.4, 0.8), abs=0.01)


def test_a_switch_late_in_the_climb_becomes_an_early_one():
    """Where a later one lowers the apoapsis, which is that of a hyperbola."""
    state = {"path": -2.24 * degree, "altitude": 211e3, "velocity": 26.5 * km}
    upwards, downwards = np.cos(15 * degree), np.cos(75 * degree)
    for lift, ends in ((upwards, -1.0), (downwards, 1.0)):
        braked = braked_too_much(lift=lift, j2=0.0, inertial=True, **state)
        assert braked * ends > 0.0
    found = list(decisions(False, 170.0, cycles=4, **state))
    assert 170.0 > found[0] > found[1] > found[2] > 0.0
    assert found[3] == pytest.approx(found[2], abs=1e-3)


@pytest.mark.slow
def test_the_nominal_flight_is_captured_near_its_apoapsis():
    flight = fly_compiled(scenario())
    assert flight.outcome == Outcome.REACHED
    missed = misses(scenario(), flight)
    # 1 m/s at the exit is 700 km of apoapsis. A prediction has steps of 4 s.
    assert abs(float(missed.apoapsis)) < 0.5 * km
    assert float(missed.velocity_increment) < 100.0
    assert float(flight.state.altitude) == pytest.approx(1001 * km, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("wait", [150.0, 1500.0])
def test_a_switch_that_is_planned_after_the_exit_is_found_again(wait):
    """From where a later switch changes nothing, since the flight has ended before."""
    late = eqx.tree_at(lambda s: s.guidance.latest_switch, scenario(), 2.0 * wait)
    flight = fly_compiled(late)
    assert flight.outcome == Outcome.REACHED
    assert abs(float(misses(late, flight).apoapsis)) < 0.5 * km
