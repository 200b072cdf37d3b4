"""End conditions with a direction against Kepler's arcs, and which flights have an end."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, mars_planet, mars_scenario, with_leaf

from jentry.flight import (
    Adaptive,
    AltitudeAbove,
    AltitudeBelow,
    Apoapsis,
    Crossing,
    FixedStep,
    Outcome,
    Periapsis,
    Termination,
    VelocityAbove,
    fly,
    has_end,
)
from jentry.motion import EntryState
from jentry.units import degree, km


RADIUS, MU = 3397.0e3, 4.28283e13
NEVER = 1e9
"""m or m/s"""


# Kepler's arcs in closed form, in numpy.


def orbit(altitude, velocity, path):
    """Semi-major axis, eccentricity, and eccentric anomaly at a state."""
    radius = RADIUS + altitude
    axis = 1.0 / (2.0 / radius - velocity**2 / MU)
    momentum = radius * velocity * np.cos(path)
    eccentricity = np.sqrt(1.0 - momentum**2 / (MU * axis))
    anomaly = np.arctan2(
        radius * velocity * np.sin(path) / np.sqrt(MU * axis), 1.0 - radius / axis
    )
    return axis, eccentricity, anomaly


def duration(axis, eccentricity, first, last):
    """From one eccentric anomaly to a later one, s: Kepler's equation."""
    mean = [x - eccentricity * np.sin(x) for x in (first, last)]
    return np.sqrt(axis**3 / MU) * (mean[1] - mean[0])


def time_to_apoapsis(altitude, velocity, path, _):
    axis, eccentricity, first = orbit(altitude, velocity, path)
    return duration(axis, eccentricity, first, np.pi)


def time_to_periapsis(altitude, velocity, path, _):
    axis, eccentricity, first = orbit(altitude, velocity, path)
    return duration(axis, eccentricity, first, 0.0)


def time_to_exit(altitude, velocity, path, through):
    """Up through an altitude, after the periapsis."""
    axis, eccentricity, first = orbit(altitude, velocity, path)
    last = np.arccos((1.0 - (RADIUS + through) / axis) / eccentricity)
    return duration(axis, eccentricity, first, last)


def time_to_fall(altitude, velocity, path, through):
    """Down through an altitude, after the apoapsis."""
    axis, eccentricity, first = orbit(altitude, velocity, path)
    last = np.arccos((1.0 - (RADIUS + through) / axis) / eccentricity)
    return duration(axis, eccentricity, first, 2.0 * np.pi - last)


UP = {"exit": Crossing(AltitudeAbove(NEVER)), "high": Apoapsis()}
DOWN = {"fall": Crossing(AltitudeBelow(-NEVER)), "low": Periapsis()}

ARCS = {
    # Altitude, velocity, path angle, altitude of the condition; and a closed form.
    "exit": (UP, (125 * km, 3600.0, -6 * degree, 120 * km), time_to_exit),
    "exit from below": (UP, (110 * km, 3600.0, -2 * degree, 120 * km), time_to_exit),
    "high": (UP, (125 * km, 3450.0, 8 * degree, NEVER), time_to_apoapsis),
    "high after low": (UP, (125 * km, 3650.0, -8 * degree, NEVER), time_to_apoapsis),
    "high on the far side": (
        UP,
        (125 * km, 3450.0, 8 * degree, 100 * km),
        time_to_apoapsis,
    ),
    "fall": (DOWN, (100 * km, 2500.0, 20 * degree, 150 * km), time_to_fall),
    "fall from above": (DOWN, (180 * km, 2500.0, 5 * degree, 150 * km), time_to_fall),
    "low": (DOWN, (125 * km, 3600.0, -6 * degree, -NEVER), time_to_periapsis),
}

STEP = FixedStep(2.0)


def vacuum(ends, numbers, time_limit=9000.0):
    altitude, velocity, path, through = numbers
    scenario = mars_scenario(ConstantBank())
    state = EntryState(altitude, 0.0, 0.0, velocity, path, 90 * degree)
    name = next(iter(ends))
    for where, value in (
        (lambda s: s.planet, mars_planet(density_scale=1e-30)),
        (lambda s: s.initial_state, state),
        (lambda s: s.termination, Termination(ends, time_limit)),
    ):
        scenario = with_leaf(scenario, where, value)
    return with_leaf(
        scenario,
        lambda s: s.termination.conditions[name].condition.altitude,
        through,
    )


@functools.cache
def flown(upwards):
    """Names of the arcs that end upwards, or the others; flights, slopes of their time."""
    names = [name for name in ARCS if (ARCS[name][0] is UP) == upwards]
    numbers = jnp.array([ARCS[name][1] for name in names])
    return names, *times_and_slopes(UP if upwards else DOWN, numbers)


@eqx.filter_jit
def times_and_slopes(ends, numbers):
    """Flights, and the derivatives of their end times with respect to the numbers."""

    def time(numbers):
        flight = fly(vacuum(ends, tuple(numbers)), STEP)
        return flight.time, flight

    slopes, flights = jax.vmap(jax.jacfwd(time, has_aux=True))(numbers)
    return flights, slopes


@pytest.mark.slow
@pytest.mark.parametrize("upwards", [True, False], ids=["up", "down"])
def test_arcs_end_where_kepler_has_them_end(upwards):
    names, flights, _ = flown(upwards)
    termination = vacuum(*ARCS[names[0]][:2]).termination
    for lane, name in enumerate(names):
        _, numbers, closed_form = ARCS[name]
        by = termination.names[int(flights.ended_by[lane])]
        assert by == name.split()[0]
        skips = by == "exit"
        outcome = Outcome.SKIPPED_OUT if skips else Outcome.REACHED
        assert flights.outcome[lane] == outcome
        # RK4 on an arc of some 1000 s in steps of 2 s: (2/1000)^4 = 2e-11, grown by the
        # instability of the time along an arc.
        expected = closed_form(*numbers)
        np.testing.assert_allclose(flights.time[lane], expected, rtol=1e-9)
        axis, eccentricity, _ = orbit(*numbers[:3])
        altitude = {
            "exit": numbers[3],
            "fall": numbers[3],
            "high": axis * (1.0 + eccentricity) - RADIUS,
            "low": axis * (1.0 - eccentricity) - RADIUS,
        }[by]
        np.testing.assert_allclose(flights.state.altitude[lane], altitude, atol=1e-4)


@pytest.mark.parametrize("upwards", [True, False], ids=["up", "down"])
def test_end_times_have_the_derivatives_of_the_closed_forms(upwards):
    names, _, slopes = flown(upwards)
    for lane, name in enumerate(names):
        _, numbers, closed_form = ARCS[name]
        start = np.array(numbers)
        steps = np.array([10.0, 0.01, 1e-6, 10.0])
        for place, step in enumerate(steps):
            change = step * np.eye(4)[place]
            difference = closed_form(*(start + change)) - closed_form(*(start - change))
            # Of differences: rounding of some 1000 s, 2e-13, over changes of some 0.01 s.
            np.testing.assert_allclose(
                slopes[lane, place], difference / (2 * step), rtol=1e-7, atol=1e-9
            )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["exit", "high after low"])
def test_adaptive_steps_end_there_too(name):
    ends, numbers, closed_form = ARCS[name]
    flight = eqx.filter_jit(fly)(vacuum(ends, numbers), Adaptive())
    np.testing.assert_allclose(flight.time, closed_form(*numbers), rtol=1e-9)
    assert flight.outcome == (
        Outcome.SKIPPED_OUT if name == "exit" else Outcome.REACHED
    )


def test_a_condition_counts_from_its_near_side():
    """And without `Crossing` a flight on the far side does not begin."""
    plain = Termination({"ceiling": AltitudeAbove(120 * km)}, 10.0)
    armed = Termination({"ceiling": Crossing(AltitudeAbove(120 * km))}, 10.0)
    zero = jnp.asarray(0.0)

    def state(altitude):
        return EntryState(altitude, 0.0, 0.0, 3000.0, 0.0, 0.0)

    above, on, below = (state(x * km) for x in (125, 120, 115))
    planet = mars_planet()
    assert plain.always is None
    assert plain.counting(zero, above, above, planet) is None
    assert plain.smallest_margin(zero, above, above, planet, plain.always) == -5 * km
    assert armed.smallest_margin(zero, above, above, planet, armed.always) == 10.0
    for where, counts in ((above, False), (on, False), (below, True)):
        counting = armed.counting(zero, where, where, planet)
        assert np.array_equal(counting, [counts, True])
    # A step from below to above meets it; one from above to below comes near.
    near = state(120 * km - 3.0)
    up, down = (
        armed.smallest_margin(
            zero, after, after, planet, armed.counting(zero, before, before, planet)
        )
        for before, after in ((below, above), (above, near))
    )
    assert up == -5 * km
    np.testing.assert_allclose(down, 3.0)


def test_directions_of_the_conditions():
    """Positive before, negative behind, in the direction that the name says."""
    low = EntryState(10 * km, 0.0, 0.0, 1000.0, -0.1, 0.0)
    high = EntryState(20 * km, 0.0, 0.0, 2000.0, 0.1, 0.0)
    for condition, before, behind in (
        (AltitudeAbove(15 * km), low, high),
        (AltitudeBelow(15 * km), high, low),
        (VelocityAbove(1500.0), low, high),
        (Apoapsis(), high, low),
        (Periapsis(), low, high),
        (Crossing(VelocityAbove(1500.0)), low, high),
    ):
        assert condition.margin(before, mars_planet()) > 0.0
        assert condition.margin(behind, mars_planet()) < 0.0


def test_the_wrapper_keeps_the_outcome():
    assert Crossing(AltitudeAbove(1.0)).outcome == Outcome.SKIPPED_OUT
    ground = AltitudeBelow(0.0, outcome=Outcome.CRASHED)
    assert Termination({"a": Crossing(ground)}, 1.0).outcomes == (
        Outcome.CRASHED,
        Outcome.TIMED_OUT,
    )


def test_which_flights_have_an_end():
    ends = {
        Outcome.REACHED: True,
        Outcome.SKIPPED_OUT: True,
        Outcome.CRASHED: True,
        Outcome.TIMED_OUT: True,
        Outcome.NOT_FINITE: False,
        Outcome.BEGAN_BEYOND_END: False,
        Outcome.SINGULAR: False,
        Outcome.NOT_A_BANK: False,
        Outcome.BEYOND_TABLE: False,
    }
    assert set(ends) == set(Outcome)
    # Codes are stored in files: they never change.
    assert [int(outcome) for outcome in ends] == list(range(9))
    for outcome, whether in ends.items():
        assert bool(has_end(int(outcome))) == whether
    assert np.array_equal(has_end(np.array(list(ends))), list(ends.values()))
    assert np.array_equal(has_end(jnp.array(list(ends))), list(ends.values()))
