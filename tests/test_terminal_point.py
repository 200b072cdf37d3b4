"""The terminal-point law: influence coefficients, decisions, and flights on Mars."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, truths, with_leaf
from laws import terminal_point
from scipy.integrate import solve_ivp

from jentry._computed_once import computed_once
from jentry.campaign import monte_carlo
from jentry.flight import (
    FixedStep,
    Outcome,
    Scenario,
    Target,
    Termination,
    VelocityBelow,
    check,
    fly,
    misses,
)
from jentry.guidance import BankProfile, FixedCycle, TerminalPoint
from jentry.guidance.terminal_point import COLUMNS
from jentry.missions.mars import drag_tracking, range_tracking
from jentry.motion import EntryState, EquatorialDynamics, from_ground_track
from jentry.motion.index import AltitudeIndex, EnergyIndex, VelocityIndex
from jentry.onboard import PolynomialProfile, Reference, measure
from jentry.planning import ReferenceFlight, open_loop, plan_terminal_point
from jentry.units import degree, foot, km, nautical_mile
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


@functools.cache
def nominal():
    """The undispersed flight, kept each second."""
    return fly_compiled(scenario(), FixedStep(), 1.0)


def read(reference, velocity):
    values = reference.over_index(jnp.asarray(velocity, float))
    return {name: float(x[0]) for name, x in values.items()}


# The influence coefficients.


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


# The law.


def at_reference(law, velocity, *, downrange=0.0, crossrange=0.0, **deviations):
    """Measurement on the reference at a velocity, with deviations in range and heading."""
    at = read(law.reference, velocity)
    air = drag_tracking.mars()
    density = 2.0 * 115.0 * at["drag"] / velocity**2
    altitude = float(air.atmosphere.scale_height) * np.log(0.0158 / density)
    along = float(law.aim.downrange) - at["range_to_go"] + downrange
    place = from_ground_track(
        air, law.aim.origin, jnp.asarray(along), jnp.asarray(crossrange)
    )
    path = np.arcsin(at["altitude_rate"] / velocity)
    state = EntryState(altitude, *place, velocity, path, 90 * degree)
    measurement = measure(air, drag_tracking.lander(), state, jnp.zeros(()))
    return dataclasses.replace(measurement, **deviations)


def decided(law, measurement):
    _, held = law.init(measurement)
    _, held = law.update(jnp.asarray(100.0), measurement, (), held)
    return held


def plain():
    """The law without its extension."""
    return dataclasses.replace(scenario().law, early_end=None)


@pytest.mark.parametrize("velocity", [6000.0, 3000.0, 1300.0])
def test_reference_commands_its_own_lift(velocity):
    law = plain()
    measurement = at_reference(law, velocity)
    # Rounding of a range of 700 km, and of the altitude.
    assert abs(law.range_error(measurement)) < 1e-3
    np.testing.assert_allclose(
        decided(law, measurement).cos_bank, planned_cosine(velocity), atol=1e-6
    )


def test_command_is_the_law_of_apollo():
    law, velocity = plain(), 4000.0
    at = read(law.reference, velocity)
    exact = at_reference(law, velocity, downrange=3e3)
    drag = 1.05 * exact.drag
    measurement = dataclasses.replace(exact, drag=drag, lift=0.2 * drag)
    error = -3e3 - at["range_per_drag"] * 0.05 * at["drag"]
    up = at["lift_to_drag_up"] + 5.0 * error / at["range_per_lift_to_drag"]
    held = decided(law, measurement)
    np.testing.assert_allclose(held.cos_bank, up / 0.2, rtol=1e-6)
    np.testing.assert_allclose(held.cos_bank**2 + held.sin_bank**2, 1.0, rtol=1e-12)


def test_bank_stays_between_its_limits():
    law = plain()
    law = dataclasses.replace(law, smallest_bank=15 * degree, largest_bank=110 * degree)
    for downrange, bank in ((-200 * km, 15 * degree), (200 * km, 110 * degree)):
        held = decided(law, at_reference(law, 4000.0, downrange=downrange))
        np.testing.assert_allclose(held.cos_bank, np.cos(bank), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right", "left"])
def test_prebank_until_the_drag_is_sensed(side):
    law = with_leaf(scenario().law, lambda law: law.lateral.first_sign, side)
    measurement = at_reference(law, 6000.0, downrange=50 * km)
    for drag, before in ((3.9, True), (4.1, False), (0.0, True)):
        drag = jnp.asarray(drag)
        sensed = dataclasses.replace(measurement, drag=drag, lift=0.18 * drag)
        held = decided(law, sensed)
        same = np.isclose(held.cos_bank, np.cos(law.prebank), rtol=1e-12)
        assert same == before
        if before:
            assert np.sign(held.sin_bank) == side
    first = law.init(measurement)[1]
    np.testing.assert_allclose(first.sin_bank, side * np.sin(law.prebank), rtol=1e-12)


@pytest.mark.parametrize(
    ("crossrange", "bank"), [(200.0, None), (-200.0, None), (20e3, 30), (-20e3, -30)]
)
def test_heading_is_aligned_at_the_end(crossrange, bank):
    """To the left of the aim it banks to the right, which is positive."""
    law = scenario().law
    measurement = at_reference(law, 890.0, crossrange=crossrange)
    held = decided(law, measurement)
    found = np.arctan2(held.sin_bank, held.cos_bank) / degree
    if bank is None:
        to_go = read(law.reference, 890.0)["range_to_go"]
        bank = 20.0 * np.arctan(crossrange / to_go) / degree
    # The plane approximation of the bearing.
    np.testing.assert_allclose(found, bank, rtol=1e-3)
    # Just above the velocity it controls the range.
    before = decided(law, at_reference(law, 910.0, crossrange=crossrange))
    np.testing.assert_allclose(before.cos_bank, planned_cosine(910.0), atol=0.02)


def test_thin_air_is_known_to_end_the_flight_early():
    law = scenario().law
    exact = at_reference(law, 3000.0)
    for factor in (0.7, 0.9, 1.2):
        thin = dataclasses.replace(exact, drag=factor * exact.drag)
        sensed = jnp.asarray(True)
        lost = float(law.early_end.range_lost(law.aim, thin, sensed))
        if factor > 1.0:  # the velocity ends it
            assert lost == 0.0
            continue
        altitude = 10 * km - 9354.5 * np.log(factor)
        flight = nominal().history.states
        higher, east = np.asarray(flight.altitude), np.asarray(flight.longitude)
        there = np.isfinite(higher)
        place = np.interp(-altitude, -higher[there], MARS * east[there])
        # Of a flight that tracks the reference, between points a second apart.
        at_end = float(nominal().state.longitude) * MARS
        np.testing.assert_allclose(lost, at_end - place, atol=1 * km)
        gained = law.range_error(thin) - plain().range_error(thin)
        np.testing.assert_allclose(gained, lost, rtol=1e-9)


# Flights.


def test_undispersed_flight_ends_at_the_target():
    flight = nominal()
    assert flight.outcome == Outcome.REACHED
    missed = misses(scenario(), flight)
    # Range control ends at 900 m/s, 38 km before the end. The reference is without bank
    # from there on, and ends higher than the target of the mission.
    assert abs(missed.downrange) < 50.0
    assert abs(missed.crossrange) < 50.0
    assert abs(missed.velocity) < 1e-6
    assert 0.0 < missed.altitude < 550.0


@pytest.mark.slow
def test_dispersed_flights():
    """64 flights with wide errors of density and coefficients; bounds of this seed."""
    table = range_tracking.MISSION.dispersion_table()
    campaign = monte_carlo(scenario(), table, jax.random.key(0), runs=64)
    away = np.hypot(campaign.misses.downrange, campaign.misses.crossrange)
    assert np.median(away) < 0.3 * km
    assert np.percentile(away, 95.0) < 2.2 * km


@pytest.mark.slow
def test_miss_has_the_derivative_of_differences_by_the_gain():
    dense = with_leaf(scenario(), lambda s: s.planet.density_scale, 1.1)

    @eqx.filter_jit
    def miss(gain):
        flown = with_leaf(dense, lambda s: s.guidance.gain, gain)
        return misses(flown, fly(flown, FixedStep())).downrange

    gain, step = jnp.asarray(5.0), 1e-4
    slope = jax.jvp(miss, (gain,), (jnp.ones(()),))[1]
    differences = (miss(gain + step) - miss(gain - step)) / (2.0 * step)
    assert abs(slope) > 0.1
    # Rounding of the range over the step; no reversal changes its cycle.
    np.testing.assert_allclose(slope, differences, rtol=1e-4, atol=1e-4)


# What is refused.


def test_bad_input_is_refused(reference):
    law = terminal_point(reference)
    fields = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}
    quantities = law.reference.quantities
    over_energy = Reference(EnergyIndex(), quantities)
    with pytest.raises(ValueError, match="over EnergyIndex"):
        TerminalPoint(**{**fields, "reference": over_energy})
    some = {name: quantities[name] for name in COLUMNS[:-2]}
    some = Reference(VelocityIndex(), some)
    lacking = "no range_per_altitude_rate, range_per_lift_to_drag"
    with pytest.raises(ValueError, match=lacking):
        TerminalPoint(**{**fields, "reference": some})
    with pytest.raises(
        ValueError, match="smallest_bank is 2 rad and largest_bank 1 rad"
    ):
        TerminalPoint(**{**fields, "smallest_bank": 2.0, "largest_bank": 1.0})
    with pytest.raises(ValueError, match="period is 0.0 s"):
        TerminalPoint(**{**fields, "cycle": FixedCycle(0.0)})


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (lambda s: s.guidance.gain, 0.0, "guidance.gain is 0"),
        (lambda s: s.guidance.gate, -1.0, "guidance.gate is -1 m/s2"),
        (lambda s: s.guidance.least_effect, 0.0, "guidance.least_effect is 0 m"),
        (lambda s: s.guidance.largest_bank, 4.0, "guidance.largest_bank is"),
        (lambda s: s.guidance.alignment.velocity, 0.0, "alignment.velocity is 0 m/s"),
    ],
)
def test_numbers_that_cannot_be_flown_are_refused(where, value, message):
    with pytest.raises(ValueError, match=message):
        check(with_leaf(scenario(), where, value))


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


def made_up_flight():
    """A reference flight of one point, which was not flown."""
    start = drag_tracking.entry()
    states = jax.tree.map(lambda x: x[None], start.initial_state)
    return ReferenceFlight(start, 0.1, jnp.zeros(1), states, start.initial_state)
