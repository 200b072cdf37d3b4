"""The terminal-point law: decisions, and flights on Mars."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import along_each, fly_compiled, with_leaf
from laws import terminal_point

from jentry._computed_once import computed_once
from jentry.campaign import monte_carlo
from jentry.flight import (
    FixedStep,
    Outcome,
    check,
    fly,
    misses,
)
from jentry.guidance import FixedCycle, FixedSide, TerminalPoint
from jentry.guidance.terminal_point import COLUMNS
from jentry.missions.mars import drag_tracking, range_tracking
from jentry.motion import EntryState, from_ground_track
from jentry.motion.index import EnergyIndex, VelocityIndex
from jentry.onboard import Reference, measure
from jentry.units import degree, km


MARS, END = 3397e3, 503.0


@computed_once
def scenario():
    return range_tracking.MISSION.scenario(law="terminal-point")


def planned_cosine(velocity):
    return float(drag_tracking.reference().cos_bank(jnp.asarray(velocity)))


@functools.cache
def nominal():
    """The undispersed flight, kept each second."""
    return fly_compiled(scenario(), FixedStep(), 1.0)


def read(reference, velocity):
    values = reference.over_index(jnp.asarray(velocity, float))
    return {name: float(x[0]) for name, x in values.items()}


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


@pytest.mark.parametrize(
    ("narrowing", "downrange", "crossrange", "reverses"),
    [
        (None, -200 * km, 5 * km, False),
        (0.5, -200 * km, 5 * km, True),  # full lift up
        (0.5, 200 * km, 5 * km, True),  # and down
        (0.5, 0.0, 5 * km, False),
        (0.5, 0.0, 8 * km, True),
        (0.5, -200 * km, 2.5 * km, False),
    ],
)
def test_corridor_is_narrower_at_a_limit_of_the_bank(
    narrowing, downrange, crossrange, reverses
):
    """Half width at 4 km/s: 0.3 km + 4e-4 V^2 = 6.7 km, over a sphere some 2 % more."""
    law = dataclasses.replace(plain(), narrowing=narrowing)
    # To the right of the aim, with a bank to the right.
    measurement = at_reference(law, 4000.0, downrange=downrange, crossrange=-crossrange)
    assert float(decided(law, measurement).side) == (-1.0 if reverses else 1.0)


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

    def miss(gains):
        flown = with_leaf(dense, lambda s: s.guidance.gain, gains[0])
        return misses(flown, fly(flown, FixedStep())).downrange

    (slope,), (differences,) = along_each(miss, [5.0], [1e-4])
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
    fixed = {"lateral": FixedSide(), "narrowing": 0.5}
    with pytest.raises(ValueError, match="narrowing is 0.5 and lateral FixedSide"):
        TerminalPoint(**{**fields, **fixed})
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
