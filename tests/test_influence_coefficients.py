"""Influence coefficients of a planned flight, against flights and the table of Apollo."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import truths
from scipy.integrate import solve_ivp

from jentry._computed_once import computed_once
from jentry.flight import (
    Scenario,
    Target,
    Termination,
    VelocityBelow,
)
from jentry.guidance import BankProfile
from jentry.guidance.terminal_point import COLUMNS
from jentry.missions.mars import drag_tracking, range_tracking
from jentry.motion import EntryState, EquatorialDynamics
from jentry.motion.index import AltitudeIndex, VelocityIndex
from jentry.onboard import PolynomialProfile
from jentry.planning import (
    ReferenceFlight,
    open_loop,
    plan_drag_reference,
    plan_range_over_altitude,
    plan_terminal_point,
)
from jentry.units import foot, km, nautical_mile
from jentry.world import (
    ConstantAerodynamics,
    ConstantWind,
    InverseSquareGravity,
    Planet,
    USStandardAtmosphere1976,
    Vehicle,
)


MARS, END = 3397e3, 503.0


@computed_once
def scenario():
    return range_tracking.MISSION.scenario(law="terminal-point")


def read(reference, velocity):
    values = reference.over_index(jnp.asarray(velocity, float))
    return {name: float(x[0]) for name, x in values.items()}


def flown_on_by_scipy(reference, velocity, aligns, end, d_drag=0.0, d_rate=0.0, du=0.0):
    """Range from a deviation at a velocity to the end (m), integrated apart, over time.

    The air is exponential, so that drag and altitude rate give altitude and path angle.
    Below the velocity `aligns` the bank is zero.
    """
    loading, density, scale, gravity = 115.0, 0.0158, 9354.5, 4.28283e13
    at = read(reference, velocity)
    altitude = -scale * np.log(
        2.0 * loading * (at["drag"] + d_drag) / (density * velocity**2)
    )
    path = np.arcsin((at["altitude_rate"] + d_rate) / velocity)

    def rates(_, y, aligned):
        h, v, gamma, _ = y
        drag = 0.5 * density * np.exp(-h / scale) * v * v / loading
        up = 0.18 * (1.0 if aligned else planned_cosine(v)) + du
        r = MARS + h
        g = gravity / r**2
        return [
            v * np.sin(gamma),
            -drag - g * np.sin(gamma),
            (up * drag + (v * v / r - g) * np.cos(gamma)) / v,
            MARS / r * v * np.cos(gamma),
        ]

    def slow(_, y, aligned):
        return y[1] - aligns

    def ended(_, y, aligned):
        return y[1] - END if end == "velocity" else y[0] - end

    point = [altitude, velocity, path, 0.0]
    for aligned, event in (
        ((False, slow), (True, ended)) if aligns else ((False, ended),)
    ):
        event.terminal, event.direction = True, -1
        flown = solve_ivp(
            rates,
            (0.0, 600.0),
            point,
            events=event,
            rtol=1e-11,
            atol=1e-9,
            args=(aligned,),
        )
        assert flown.status == 1
        point = flown.y[:, -1]
    return point[3]


def assert_coefficients_are_differences(reference, aligns, end, close):
    steps = {
        "range_per_drag": ("d_drag", 1e-3),
        "range_per_altitude_rate": ("d_rate", 0.05),
        "range_per_lift_to_drag": ("du", 1e-5),
    }
    for velocity in (6500.0, 4500.0, 2500.0, 1300.0):
        ours = read(reference, velocity)
        flown = functools.partial(flown_on_by_scipy, reference, velocity, aligns, end)
        # The table is of a flight in steps of 0.1 s, one of them over a jump of the bank.
        np.testing.assert_allclose(ours["range_to_go"], flown(), atol=2.0)
        for name, (what, step) in steps.items():
            differences = (flown(**{what: step}) - flown(**{what: -step})) / (2 * step)
            np.testing.assert_allclose(ours[name], differences, rtol=close)


def planned_cosine(velocity):
    c0, c1 = np.asarray(drag_tracking.reference().cos_bank.coefficients)[:2]
    return c0 + c1 * (velocity - END) / (6750.0 - END)


def test_coefficients_are_differences_of_flights_to_the_end():
    """Those of the mission, whose bank is zero below 900 m/s."""

    # The table spreads the jump of the bank over an interval of 6 m/s.
    reference = scenario().law.reference
    assert_coefficients_are_differences(reference, 900.0, "velocity", 5e-5)


@pytest.mark.slow
def test_coefficients_of_the_range_to_an_altitude_are_differences():
    profile = drag_tracking.reference().cos_bank
    flight = ReferenceFlight.of(open_loop(drag_tracking.entry(), profile, 300.0))
    plan = eqx.filter_jit(plan_terminal_point)
    reference = plan(flight, END, AltitudeIndex())
    # The planned flight ends at 10 km; a smooth bank, and differences.
    assert_coefficients_are_differences(reference, None, 10 * km, 1e-5)


@pytest.mark.slow
def test_coefficients_of_apollo():
    """Its flight from 23 090 ft/s on, with an upward lift-to-drag ratio of 0.18.

    The listing has neither the vehicle nor the air nor the end of its reference. Here the
    ballistic coefficient is 340 kg/m2, the air that of 1976 and the Earth at rest; drag
    and altitude rate at 23 090 ft/s are those of the table.
    """
    table = truths("apollo_final_phase.csv")
    stored = {k: np.array([table[i][k] for i in table]) for k in table["0"]}
    unit = 51532.3946 * foot
    velocity = stored["velocity"] * unit
    drag, rate = -stored["minus_drag"] * 805.0 * foot, stored["rdot"] * unit
    length = 2700.0 * nautical_mile

    planet = Planet(
        6378.1 * km,
        gravity=InverseSquareGravity(3.986004e14),
        atmosphere=USStandardAtmosphere1976(),
    )
    vehicle = Vehicle(340.0, 1.0, aerodynamics=ConstantAerodynamics(0.18, 1.0))
    fast = velocity[-1]
    altitudes = jnp.linspace(60 * km, 80 * km, 20_001)
    drags = jax.vmap(planet.density)(altitudes) * fast**2 / (2.0 * 340.0)
    altitude = np.interp(-drag[-1], -np.asarray(drags), np.asarray(altitudes))
    start = EntryState(altitude, 0.0, 0.0, fast, np.arcsin(rate[-1] / fast), np.pi / 2)
    level = BankProfile(PolynomialProfile([1.0]))
    ends = Termination({"velocity": VelocityBelow(150.0)}, 900.0)
    target = Target(0.0, 150.0, 1000 * km)
    flight = ReferenceFlight.of(
        Scenario(
            planet,
            vehicle,
            start,
            level,
            ends,
            target,
            dynamics=EquatorialDynamics(),
        )
    )
    end = float(velocity[0])
    plan = eqx.filter_jit(plan_terminal_point)
    ours = [read(plan(flight, end, start_drag=8.0), v) for v in velocity]
    ours = {name: np.array([x[name] for x in ours]) for name in COLUMNS}

    # From 8 500 ft/s on, where the end has no effect. Measured: the coefficients of the
    # drag within 7 %, those of the altitude rate within 7.5 %, the drag within 4.5 %, the
    # altitude rate within 12 m/s and the range within 22 of 505 n mile.
    up = slice(4, None)
    per_drag = stored["drange_da"] * length / (805.0 * foot)
    np.testing.assert_allclose(ours["range_per_drag"][up], per_drag[up], rtol=0.08)
    per_rate = -stored["minus_drange_drdot"] * length / unit
    np.testing.assert_allclose(
        ours["range_per_altitude_rate"][up], per_rate[up], rtol=0.08
    )
    np.testing.assert_allclose(ours["drag"], drag, rtol=0.05)
    np.testing.assert_allclose(ours["altitude_rate"], rate, atol=12.0)
    to_go = (stored["range_to_go"] - stored["range_to_go"][0]) * length
    np.testing.assert_allclose(ours["range_to_go"], to_go, rtol=0.05, atol=1.0 * km)
    # The stored effect of the lift is within 3.5 % of ours from 14 000 ft/s on. Below, from
    # 8 500 to 10 100 ft/s, it is twice the derivative: the program has half the gain there.
    per_lift = stored["drange_dld"] * length
    np.testing.assert_allclose(
        ours["range_per_lift_to_drag"][6:], per_lift[6:], rtol=0.035
    )
    np.testing.assert_allclose(
        2.0 * ours["range_per_lift_to_drag"][4:6], per_lift[4:6], rtol=0.05
    )


def test_range_over_altitude_is_that_over_velocity():
    law = scenario().law
    air = drag_tracking.mars()
    for velocity in (5000.0, 2000.0, 1000.0, 600.0):
        at = read(law.reference, velocity)
        density = 2.0 * 115.0 * at["drag"] / velocity**2
        altitude = air.atmosphere.scale_height * np.log(0.0158 / density)
        found = float(law.early_end.range_to_go(jnp.asarray(altitude)))
        # The range changes by up to 50 times the altitude, which is read from the drag.
        np.testing.assert_allclose(found, at["range_to_go"], atol=2.0)


def test_plans_that_cannot_be_made_are_refused():
    with pytest.raises(ValueError, match="is under TerminalPoint"):
        flown = eqx.tree_at(lambda f: f.scenario, made_up_flight(), scenario())
        plan_terminal_point(flown, END)
    windy = eqx.tree_at(
        lambda f: f.scenario.planet.wind,
        made_up_flight(),
        ConstantWind(10.0, 0.0),
        is_leaf=lambda x: x is made_up_flight().scenario.planet.wind,
    )
    with pytest.raises(ValueError, match="ConstantWind, and a terminal-point"):
        plan_terminal_point(windy, END)


VELOCITIES = np.array([6000.0, 3000.0, 1010.0, 1000.0, np.nan])
HEIGHTS = np.array([60e3, 30e3, 16e3, 15e3, np.nan])


def made_up_descent():
    """A reference flight of four points and one after its end."""
    flight = made_up_flight()
    states = jax.tree.map(lambda x: jnp.repeat(x, 5), flight.states)
    states = eqx.tree_at(
        lambda s: (s.velocity, s.altitude),
        states,
        (jnp.asarray(VELOCITIES), jnp.asarray(HEIGHTS)),
    )
    return ReferenceFlight(flight.scenario, 0.1, 0.1 * jnp.arange(5), states, states)


@pytest.mark.parametrize(
    ("plan", "numbers", "message"),
    [
        (
            plan_terminal_point,
            (985.0,),
            "end_velocity is 985 m/s: .* has 1000 m/s to 6",
        ),
        (plan_terminal_point, (np.nan,), "end_velocity is nan m/s: the reference"),
        (
            plan_terminal_point,
            (4000.0, VelocityIndex(), 20.0),
            "end_velocity is 4000 m/s: it must be below.* 3000 m/s",
        ),
        (plan_range_over_altitude, (985.0, 40e3), "end_velocity is 985 m/s"),
        (
            plan_range_over_altitude,
            (1000.0, 13e3),
            "start_altitude is 13 km: .* has 15",
        ),
        (plan_range_over_altitude, (1000.0, 62e3), "start_altitude is 62 km"),
    ],
)
def test_numbers_beyond_the_planned_flight_are_refused(plan, numbers, message):
    with pytest.raises(ValueError, match=message):
        plan(made_up_descent(), *numbers)


@pytest.mark.parametrize("bound", [2e3, np.nan], ids=["large", "nan"])
def test_a_drag_that_the_planned_flight_does_not_have_is_refused(bound):
    drags = 0.5 * 0.0158 * np.exp(-HEIGHTS / 9354.5) * VELOCITIES**2 / 115.0
    largest = f"largest drag of the reference flight is {np.nanmax(drags):.6g} m/s2"
    with pytest.raises(ValueError, match=f"start_drag is .*{largest}"):
        plan_terminal_point(made_up_descent(), 1000.0, start_drag=bound)
    message = largest if bound == 2e3 else "gate is nan m/s2: it must be zero or more"
    with pytest.raises(ValueError, match=message):
        plan_drag_reference(made_up_descent(), VelocityIndex(), bound)


def test_a_table_needs_an_interval():
    with pytest.raises(ValueError, match="intervals is 0: it must be 1 or more"):
        plan_terminal_point(made_up_descent(), 1000.0, intervals=0)


def test_what_a_flight_does_not_reach_is_nan_in_a_compiled_program():
    """One step beyond the end is reached."""
    flight, index = made_up_descent(), VelocityIndex()
    reached = jax.jit(jax.vmap(lambda v: flight.reached(index, v, "v")))
    asked = jnp.array([995.0, 985.0, 1000.0, 6005.0, 6015.0])
    expected = [995.0, np.nan, 1000.0, 6005.0, np.nan]
    np.testing.assert_array_equal(reached(asked), expected)
    drags = jnp.array([1.0, 2.0, 3.0, 4.0, np.nan])
    first = jax.jit(lambda bound: flight.first_above(drags, bound, "bound"))
    for bound, velocity in ((1.5, 3000.0), (0.0, 6000.0), (4.0, np.nan)):
        time, state = first(bound)
        np.testing.assert_array_equal(state.velocity, velocity)
        assert np.isnan(time) == np.isnan(velocity)


def made_up_flight():
    """A reference flight of one point, which was not flown."""
    start = drag_tracking.entry()
    states = jax.tree.map(lambda x: x[None], start.initial_state)
    return ReferenceFlight(start, 0.1, jnp.zeros(1), states, start.initial_state)
