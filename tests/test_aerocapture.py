"""The two phases of the aerocapture law, and its flights over Mars."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import along_each, with_leaf

from jentry._computed_once import computed_once
from jentry.flight import Outcome, fly, misses
from jentry.guidance import (
    AerocaptureGuidance,
    FixedSide,
    InclinationCorridor,
    OrbitPlane,
)
from jentry.missions import find_mission
from jentry.motion import EntryState, OrbitTarget, orbit_of
from jentry.onboard.measurement import measure
from jentry.units import degree, km


pytestmark = pytest.mark.slow
MISSION = find_mission("mars-aerocapture")


@computed_once
def scenario():
    return MISSION.scenario()


@computed_once
def law():
    return scenario().law


flown = eqx.filter_jit(lambda scenario: fly(scenario, history=1.0))


@computed_once
def flight():
    return flown(scenario())


def sensed(state, scale=1.0):
    """What is measured in a state, in air that is denser by a factor."""
    planet = dataclasses.replace(scenario().planet, density_scale=jnp.asarray(scale))
    return measure(planet, scenario().vehicle, state, jnp.zeros(()))


def at(time):
    index = int(time)
    return jax.tree.map(lambda x: x[index], flight().history.states)


def held_at(time):
    return jax.tree.map(lambda x: x[int(time)], flight().history.decisions)


def decided(time, held, state, scale=1.0):
    law_ = law()
    return eqx.filter_jit(lambda t, m, h: law_.update(t, m, (), h)[1])(
        jnp.asarray(float(time)), sensed(state, scale), held
    )


def test_the_nominal_flight_meets_the_apoapsis():
    assert flight().outcome == Outcome.REACHED
    missed = misses(scenario(), flight())
    # A prediction has steps of 4 s, and the last corrections are above 80 km.
    assert abs(float(missed.apoapsis)) < 500.0
    assert abs(float(missed.inclination)) < 0.1 * degree


def test_lift_is_up_first_and_then_constant():
    history, law_ = flight().history, law()
    decisions = history.decisions
    flying = np.isfinite(history.time)
    exits = np.asarray(decisions.exits)[flying] == 1.0
    first = int(np.argmax(exits))
    assert 90 < first < 200 and exits[first:].all() and not exits[:first].any()
    cosine = np.asarray(history.controls.cos_bank)[flying]
    steep = np.cos(float(law_.first_bank))
    # The turn to the exit bank may begin within the last cycle.
    np.testing.assert_allclose(cosine[: first - 1], steep, rtol=1e-12)
    # While there is air that matters the bank hardly changes.
    assert np.ptp(cosine[first + 5 : first + 100]) < 0.15


def test_a_plan_is_flown_as_predicted():
    """In each phase the corrected number leads to the apoapsis of the target."""
    for time in (100, 200):
        state, held = at(time), held_at(time)
        number = held.cos_bank if bool(held.exits) else held.switches_at - time
        end = law().predicted(
            sensed(state), held.estimate.ahead, number, held.exits > 0.5, held.side
        )
        high = orbit_of(scenario().planet, end.state).apoapsis_altitude
        assert bool(end.has_end)
        assert float(high) == pytest.approx(500 * km, abs=3 * km)


def test_a_switch_that_is_past_begins_the_second_phase():
    held = held_at(100)
    late = dataclasses.replace(held, switches_at=jnp.asarray(50.0))
    after = decided(101, late, at(101))
    assert not bool(held.exits) and bool(after.exits)
    # Before the lowest point, the bank is within its bounds.
    assert np.cos(165 * degree) <= float(after.cos_bank) <= np.cos(15 * degree)


def test_the_second_phase_does_not_end():
    held = held_at(200)
    after = decided(201, held, at(201))
    assert bool(after.exits) and float(after.switches_at) == float(held.switches_at)


def test_denser_air_switches_earlier_or_banks_less():
    """Either way there is less drag, in place of that of the denser air."""
    held = held_at(200)
    thin, thick = (decided(201, held, at(201), x) for x in (0.9, 1.1))
    assert float(thick.estimate.factors.drag) == pytest.approx(1.1, rel=1e-9)
    assert float(thin.cos_bank) < float(held.cos_bank) < float(thick.cos_bank)


def test_without_air_to_feel_nothing_is_decided():
    state = scenario().initial_state
    _, held = law().init(sensed(state))
    after = decided(0.0, held, state)
    assert float(after.decisions) == 0.0 and not bool(after.exits)
    assert float(after.switches_at) > float(held.switches_at)


def test_a_law_that_cannot_be_is_refused():
    model = law().model
    with pytest.raises(ValueError, match="corrections is 0"):
        AerocaptureGuidance(model, corrections=0)
    with pytest.raises(ValueError, match="200 steps of 0.0 s: both must be positive"):
        AerocaptureGuidance(model, step=0.0)
    with pytest.raises(ValueError, match="first_bank is 130 deg and exit_bank 120 deg"):
        AerocaptureGuidance(model, first_bank=130 * degree)
    with pytest.raises(ValueError, match="orbit that is the target of its scenario"):
        outside = AerocaptureGuidance(model)
        outside.update(*_arguments(outside))
    corridor = InclinationCorridor(0.05 * degree)
    free = OrbitTarget(500 * km, 500 * km)
    aimless = AerocaptureGuidance(model, orbit=free, lateral=corridor)
    with pytest.raises(ValueError, match="about the inclination of a target orbit"):
        aimless.update(*_arguments(aimless))


def _arguments(law):
    measurement = sensed(scenario().initial_state)
    return jnp.zeros(()), measurement, *law.init(measurement)


@pytest.mark.parametrize(
    ("heading", "inclination", "sign"),
    [
        # Northwards a turn to the right, towards east, lowers the inclination.
        (40.0, 45.0, 1.0),
        (40.0, 55.0, -1.0),
        # Southwards it is the other way round.
        (140.0, 45.0, -1.0),
        (140.0, 55.0, 1.0),
    ],
)
def test_the_bank_turns_the_plane_back(heading, inclination, sign):
    """The derivative of the inclination in the heading says which side is back."""
    planet, heading = scenario().planet, heading * degree

    def tilt(x):
        state = EntryState(60 * km, 0.0, 0.2, 4000.0, 0.0, x)
        return orbit_of(planet, state).inclination

    too_much = float(tilt(heading)) - inclination * degree
    assert float(jax.grad(tilt)(heading)) * sign * too_much < 0.0
    corridor = InclinationCorridor(0.05 * degree)
    state = EntryState(60 * km, 0.0, 0.2, 4000.0, 0.0, heading)
    plane = OrbitPlane(planet, jnp.asarray(inclination * degree))
    measured = sensed(state)
    for before in (1.0, -1.0):
        side = corridor.update(jnp.zeros(()), measured, jnp.asarray(before), plane)
        assert float(side) == sign


def test_within_the_corridor_the_side_stays():
    planet = scenario().planet
    state = EntryState(60 * km, 0.0, 0.2, 4000.0, 0.0, 40 * degree)
    plane = OrbitPlane(planet, orbit_of(planet, state).inclination + 0.04 * degree)
    corridor = InclinationCorridor(0.05 * degree)
    for before in (1.0, -1.0):
        side = corridor.update(jnp.zeros(()), sensed(state), jnp.asarray(before), plane)
        assert float(side) == before


def test_flights_in_other_air_are_captured_as_well_in_a_batch():
    scales = jnp.array([0.5, 1.0, 1.5])

    def costs(scale):
        thick = with_leaf(scenario(), lambda s: s.planet.density_scale, scale)
        flight = fly(thick)
        missed = misses(thick, flight)
        return flight.outcome, missed.apoapsis, missed.velocity_increment

    outcomes, high, increments = jax.jit(jax.vmap(costs))(scales)
    assert np.all(outcomes == Outcome.REACHED)
    # The batch has the flight alone, to the rounding of a chaotic choice of reversals.
    alone = float(misses(scenario(), flight()).velocity_increment)
    assert float(increments[1]) == pytest.approx(alone, abs=0.5)
    assert np.all(np.abs(high) < 3 * km) and np.all(increments < 125.0)


def test_the_derivative_of_a_flight_is_its_difference():
    """To a fixed side, and over the air, between two jumps."""
    steady = eqx.tree_at(lambda s: s.guidance.lateral, scenario(), FixedSide())

    def cost(scale):
        air = with_leaf(steady, lambda s: s.planet.density_scale, scale)
        return misses(air, fly(air)).velocity_increment

    (slope,), (difference,) = along_each(lambda x: cost(x[0]), jnp.ones(1), [1e-5])
    # The second difference over the steps.
    assert slope == pytest.approx(difference, rel=2e-2)
