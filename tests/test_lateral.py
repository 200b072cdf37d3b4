"""Lateral logic: where the flight would pass, and which way it is banked."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    bank_profile,
    fly_compiled,
    mars_entry,
    mars_planet,
    mars_scenario,
    over,
    with_leaf,
)
from scipy.optimize import brentq

from jentry.fields import Scalar, scalar
from jentry.flight import FixedStep, Scenario, fly
from jentry.guidance import (
    AbstractLateralLogic,
    CrossrangeCorridor,
    Destination,
    FixedSide,
    HeadingCorridor,
    PredictedCrossrange,
    Sampled,
    SmoothReversals,
    VelocityReversals,
)
from jentry.guidance.lateral import (
    PredictedPassage,
    predicted_crossrange,
    reverse_bank,
    turned,
)
from jentry.guidance.open_loop import vertical_lift_command
from jentry.motion import EntryDynamics, EntryState, ground_track
from jentry.onboard import Measurement
from jentry.units import degree, km


ORIGIN = eqx.tree_at(
    lambda s: (s.longitude, s.latitude, s.heading),
    mars_entry(),
    tuple(jnp.asarray(x * degree) for x in (20.0, 35.0, 60.0)),
)


def after(planet, state, distance):
    """The point at a distance along the great circle: the textbook formula."""
    angle = distance / planet.radius
    latitude = jnp.arcsin(
        jnp.sin(state.latitude) * jnp.cos(angle)
        + jnp.cos(state.latitude) * jnp.sin(angle) * jnp.cos(state.heading)
    )
    longitude = state.longitude + jnp.arctan2(
        jnp.sin(state.heading) * jnp.sin(angle) * jnp.cos(state.latitude),
        jnp.cos(angle) - jnp.sin(state.latitude) * jnp.sin(latitude),
    )
    return eqx.tree_at(
        lambda s: (s.longitude, s.latitude), state, (longitude, latitude)
    )


def headed(state: EntryState, angle):
    return eqx.tree_at(lambda s: s.heading, state, state.heading + angle)


@pytest.mark.parametrize("angle", [-3.0, -0.2, 0.4, 2.0])
@pytest.mark.parametrize("distance", [0.0, 100 * km, 700 * km])
def test_prediction_is_where_the_great_circle_leads(angle, distance):
    planet = mars_planet()
    # Somewhere near the entry plane: on a great circle 1 degree off, 60 km from its start.
    state = headed(after(planet, headed(ORIGIN, degree), 60 * km), angle * degree)
    distance = jnp.asarray(distance)
    predicted = predicted_crossrange(planet, ORIGIN, state, distance)
    _, crossrange = ground_track(planet, ORIGIN, after(planet, state, distance))
    # What is left out is crossrange^3 / (6 radius^2), 0.4 m at 30 km.
    assert abs(predicted - crossrange) < 1.0
    assert abs(ground_track(planet, ORIGIN, state)[1]) > 1 * km


def test_straight_ahead_there_is_no_crossrange():
    predicted = predicted_crossrange(
        mars_planet(), ORIGIN, ORIGIN, jnp.asarray(700 * km)
    )
    assert abs(predicted) < 1e-6  # rounding of the planet's radius


def test_bank_is_reversed_outside_of_the_corridor_only():
    sign = jax.vmap(reverse_bank, in_axes=(0, 0, None))
    before = jnp.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    crossrange = jnp.array([0.9, -0.9, 1.1, 1.1, -1.1, -1.1])
    # Left of the corridor it turns to the right, which is positive.
    wanted = [1.0, -1.0, 1.0, 1.0, -1.0, -1.0]
    np.testing.assert_array_equal(sign(before, crossrange, jnp.asarray(1.0)), wanted)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_the_edge_of_the_corridor_the_bank_stays(side, sign):
    edge = jnp.asarray(1.0)
    just_beyond = jnp.asarray(side * np.nextafter(1.0, 2.0))
    assert reverse_bank(jnp.asarray(sign), side * edge, edge) == sign
    assert reverse_bank(jnp.asarray(sign), just_beyond, edge) == side


def test_the_choice_of_a_side_has_no_derivative():
    gradient = jax.grad(reverse_bank, argnums=(0, 1, 2))
    assert gradient(jnp.asarray(1.0), jnp.asarray(-2.0), jnp.asarray(1.0)) == (0, 0, 0)


def test_corridor_narrows_with_velocity_to_its_floor():
    corridor = CrossrangeCorridor(floor=300.0, widening=4e-4)
    assert corridor.half_width(jnp.asarray(0.0)) == 300.0
    assert corridor.half_width(jnp.asarray(5000.0)) == 300.0 + 4e-4 * 25e6


@pytest.mark.parametrize("cos_bank", [-1.3, -0.4, 0.7, 1.3])
def test_bank_to_the_left_mirrors_bank_to_the_right(cos_bank):
    angle_of_attack = jnp.asarray(0.0)
    right = vertical_lift_command(jnp.asarray(cos_bank), angle_of_attack)
    left = turned(right, -1.0)
    assert left.cos_bank == right.cos_bank
    assert left.sin_bank == -right.sin_bank
    assert right.sin_bank >= 0.0


# What the objects decide.


TIME = jnp.asarray(3.0)


def seen(state: EntryState) -> Measurement:
    one = jnp.asarray(1.0)
    return Measurement(state, one, one, 0.0 * one, 0.0 * one)


def at_speed(velocity) -> Measurement:
    return seen(with_leaf(ORIGIN, lambda s: s.velocity, velocity))


def signs(logic: AbstractLateralLogic, velocities) -> list[float]:
    """Of the bank before the first cycle, and in the cycles that begin at velocities."""
    side = logic.init(at_speed(velocities[0]))
    found = [logic.sign(side)]
    for velocity in velocities:
        side = logic.update(TIME, at_speed(velocity), side, None)
        found.append(logic.sign(side))
    return [float(x) for x in found]


PASSES = {
    "each once": ([7700, 7001, 6999, 6500, 5999], [1, 1, 1, -1, -1, 1]),
    "exactly at it": ([7700, 7000, 6999, 6000], [1, 1, -1, -1, 1]),
    "two in a cycle": ([7700, 7010, 5990, 5010, 4990], [1, 1, 1, 1, 1, -1]),
    "three in a cycle": ([7700, 4990], [1, 1, -1]),
    "faster at first": ([6990, 7005, 7010, 6995, 5995], [1, 1, 1, 1, -1, 1]),
    "to and fro": ([7001, 6999, 7001, 6999, 7001, 6000], [1, 1, -1, -1, -1, -1, 1]),
    "begun below": ([6500, 6400, 5990], [1, 1, 1, -1]),
    "begun at it": ([7000, 6999, 6000], [1, 1, 1, -1]),
    "begun at it and faster": ([7000, 7001, 6999], [1, 1, 1, -1]),
    "begun below all": ([4000, 3000], [1, 1, 1]),
}


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("name", PASSES)
def test_bank_is_reversed_once_where_a_velocity_is_passed(name, order):
    flown, wanted = PASSES[name]
    logic = VelocityReversals([7000.0, 6000.0, 5000.0][::order])
    assert signs(logic, flown) == wanted
    left = VelocityReversals([7000.0, 6000.0, 5000.0][::order], -1.0)
    assert signs(left, flown) == [-x for x in wanted]


def test_reversals_that_would_cancel_are_refused():
    with pytest.raises(ValueError, match="6000 m/s more than once"):
        VelocityReversals([7000.0, 6000.0, 6000.0])
    with pytest.raises(ValueError, match="must be a list"):
        VelocityReversals(7000.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda sign: VelocityReversals([7000.0], sign),
        lambda sign: CrossrangeCorridor(300.0, 4e-4, sign),
        lambda sign: HeadingCorridor(0.0, 0.0, 1e6, [1.0], [1.0], sign),
    ],
)
def test_a_first_side_that_is_none_is_refused(make):
    assert float(make(-1.0).first_sign) == -1.0
    for wrong in (0.0, 0.5, 2.0, np.nan):
        with pytest.raises(ValueError, match="first_sign is .* it must be 1"):
            make(wrong)


def test_a_fixed_side_stays():
    assert signs(FixedSide(), [7000.0, 100.0]) == [1.0] * 3
    assert signs(FixedSide(to_the_left=True), [7000.0, 100.0]) == [-1.0] * 3


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize("beyond", [-1.0, 1.0])
@pytest.mark.parametrize("before", [1.0, -1.0])
def test_crossrange_corridor_is_about_the_destination(before, beyond, side):
    """A metre beyond it and a metre within it."""
    planet, state = mars_planet(), headed(ORIGIN, -0.5 * degree)
    ahead = jnp.asarray(500 * km)
    passing = predicted_crossrange(planet, ORIGIN, state, ahead)
    corridor = CrossrangeCorridor(floor=300.0, widening=4e-4)
    width = 300.0 + 4e-4 * float(state.velocity) ** 2
    destination = Destination(planet, ORIGIN, ahead, passing - side * (width + beyond))
    after = corridor.update(TIME, seen(state), jnp.asarray(before), destination)
    assert float(after) == (side if beyond > 0.0 else before)


def bearing(state, longitude, latitude):
    """From vectors: the angle between the horizontal parts of heading and target."""
    up, target = (
        np.array([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])
        for a, b in (
            (float(state.longitude), float(state.latitude)),
            (longitude, latitude),
        )
    )
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    to_east, to_north = target @ east, target @ north
    return np.arctan2(to_east, to_north)


TARGETS = [(30.0, 40.0), (-100.0, 20.0), (20.5, 35.5), (150.0, -50.0), (21.0, 34.0)]
"""Longitude and latitude, deg: near and far, to the left and to the right, and behind"""


def corridor_to(longitude, latitude, **given):
    where = longitude * degree, latitude * degree
    widths = {"velocities": [2e3, 7e3], "half_widths": [5 * degree, 15 * degree]}
    return HeadingCorridor(*where, 3397 * km, **(widths | given))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("heading", [0.0, 60.0, 200.0, 350.0])
def test_heading_error_is_counted_clockwise_to_the_bearing(target, heading):
    state = with_leaf(ORIGIN, lambda s: s.heading, heading * degree)
    found = corridor_to(*target).heading_error(state)
    wanted = bearing(state, *np.radians(target)) - np.radians(heading)
    wanted = np.arctan2(np.sin(wanted), np.cos(wanted))
    np.testing.assert_allclose(found, wanted, atol=1e-13)


@pytest.mark.parametrize(
    ("velocity", "width"),
    [(100.0, 5.0), (2000.0, 5.0), (4500.0, 10.0), (7000.0, 15.0), (9000.0, 15.0)],
)
def test_width_of_a_heading_corridor_is_linear_and_held_beyond(velocity, width):
    found = corridor_to(0.0, 0.0).half_width(jnp.asarray(velocity))
    np.testing.assert_allclose(found, width * degree, rtol=1e-14)
    table = {"velocities": [1e3, 2e3, 8e3], "half_widths": [0.1, 0.3, 0.2]}
    corridor = corridor_to(0.0, 0.0, **table)
    found = corridor.half_width(jnp.asarray(velocity))
    wanted = np.interp(velocity, [1e3, 2e3, 8e3], [0.1, 0.3, 0.2])
    np.testing.assert_allclose(found, wanted, rtol=1e-14)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right", "left"])
@pytest.mark.parametrize("beyond", [-0.01, 0.01])
def test_heading_corridor_turns_towards_its_target(target, side, beyond):
    """A hundredth of a degree beyond it, and within it; at 4500 m/s it is 10 deg wide."""
    off = side * (10.0 + beyond) * degree
    heading = bearing(ORIGIN, *np.radians(target)) - off
    state = with_leaf(ORIGIN, lambda s: s.heading, heading)
    state = with_leaf(state, lambda s: s.velocity, 4500.0)
    corridor = corridor_to(*target)
    for before in (1.0, -1.0):
        after = corridor.update(TIME, seen(state), jnp.asarray(before), None)
        assert float(after) == (side if beyond > 0.0 else before)


def test_at_its_target_a_heading_corridor_leaves_the_bank():
    corridor = corridor_to(20.0, 35.0)
    for before in (1.0, -1.0):
        assert corridor.update(TIME, seen(ORIGIN), jnp.asarray(before), None) == before


def test_a_surrogate_shares_the_reversal_of_a_heading_corridor_out():
    """Over the distance by which the target would be passed: 1 km of 2 km beyond it."""
    planet, distance = mars_planet(), 400 * km
    target = after(planet, ORIGIN, distance)
    where = (float(x) / degree for x in (target.longitude, target.latitude))
    corridor = corridor_to(
        *where,
        velocities=[1.0],
        half_widths=[0.01],
        switching=SmoothReversals(2 * km),
    )

    def sign(heading):
        state = with_leaf(ORIGIN, lambda s: s.heading, heading)
        return corridor.update(TIME, seen(state), jnp.asarray(-1.0), None)

    heading = ORIGIN.heading - 0.01 - 1 * km / distance
    np.testing.assert_allclose(sign(heading), 0.0, atol=1e-9)
    slope = jax.grad(sign)(heading)
    # Twice the share, which falls as the heading rises.
    np.testing.assert_allclose(slope, -2.0 * distance / (2 * km), rtol=1e-9)


def test_lists_of_a_heading_corridor_must_fit():
    with pytest.raises(ValueError, match="two lists of one length"):
        corridor_to(0.0, 0.0, half_widths=[0.1])
    with pytest.raises(ValueError, match="two lists of one length"):
        corridor_to(0.0, 0.0, velocities=[], half_widths=[])


# In flight.


def steady(lateral) -> Scenario:
    """Free flight on Mars with a bank profile of 60 degrees."""
    law = with_leaf(bank_profile(), lambda law: law.cos_bank.coefficients, [0.5, 0.0])
    law = with_leaf(law, lambda law: law.lateral, lateral)
    return with_leaf(mars_scenario(dynamics=EntryDynamics()), lambda s: s.guidance, law)


def sampled(scenario: Scenario, period=1.0) -> Scenario:
    law = Sampled(scenario.guidance, period)
    return with_leaf(scenario, lambda s: s.guidance, law)


@pytest.mark.slow
def test_the_same_bank_to_either_side_is_the_same_flight_in_a_mirror():
    right, left = (
        fly_compiled(steady(FixedSide(left)), FixedStep(0.5)) for left in (False, True)
    )
    assert float(right.state.latitude) < -0.01
    np.testing.assert_allclose(left.state.latitude, -right.state.latitude, rtol=1e-9)
    np.testing.assert_allclose(left.state.altitude, right.state.altitude, rtol=1e-9)


@pytest.mark.slow
def test_reversals_at_velocities_are_flown():
    """The bank changes its sign in the first cycle below each of them, and only there."""
    wanted = [5500.0, 3000.0, 1200.0]
    flight = fly_compiled(
        sampled(steady(VelocityReversals(wanted))), FixedStep(0.5), 1.0
    )
    history = flight.history
    flown = np.isfinite(history.time)
    velocity = np.asarray(history.states.velocity)[flown]
    sign = np.sign(np.asarray(history.controls.sin_bank)[flown])
    below = np.sum(velocity[:, None] <= np.array(wanted), axis=1)
    np.testing.assert_array_equal(sign, (-1.0) ** below)
    assert set(below) == {0, 1, 2, 3}
    assert np.all(np.asarray(history.controls.cos_bank)[flown] == 0.5)


def test_heading_corridor_brings_the_flight_towards_its_target():
    """Whichever side is banked to first; without a reversal it passes far off."""
    ends = []
    for sign in (1.0, -1.0):
        corridor = HeadingCorridor(
            723.32 / 3397, 0.0, 3397 * km, [500.0, 7e3], [1 * degree, 3 * degree], sign
        )
        flight = fly_compiled(sampled(steady(corridor)), FixedStep(0.5))
        ends.append(float(flight.state.latitude))
    right = fly_compiled(steady(FixedSide()), FixedStep(0.5))
    assert abs(float(right.state.latitude)) > 3.0 * max(map(abs, ends))
    assert ends[0] == pytest.approx(-ends[1], rel=1e-6)


class Timed(AbstractLateralLogic[Scalar]):
    """A lateral logic of a user: to the left after a time."""

    time: Scalar = scalar(unit="s")

    def init(self, measurement):
        return 1.0 + 0.0 * measurement.drag

    def update(self, time, measurement, side, destination):
        return jnp.where(time >= self.time, -1.0, 1.0)

    def sign(self, side):
        return side


def test_a_logic_of_a_user_is_one_class():
    flight = fly_compiled(sampled(steady(Timed(60.0))), FixedStep(0.5), 1.0)
    sign = np.sign(np.asarray(flight.history.controls.sin_bank))
    flown = np.isfinite(sign)
    time = np.asarray(flight.history.time)[flown]
    np.testing.assert_array_equal(sign[flown], np.where(time < 60.0, 1.0, -1.0))


def test_a_logic_that_decides_needs_a_cycle():
    given = steady(VelocityReversals([3000.0]))
    with pytest.raises(ValueError, match="BankProfile has a VelocityReversals, .*Samp"):
        fly(given, FixedStep(1.0))


def test_a_corridor_about_a_destination_needs_one():
    given = sampled(steady(CrossrangeCorridor(300.0, 4e-4)))
    with pytest.raises(ValueError, match="take a HeadingCorridor"):
        fly(given, FixedStep(1.0))


@pytest.mark.slow
@pytest.mark.parametrize("make", [FixedSide, lambda: VelocityReversals([5e3, 2e3])])
def test_decisions_side_by_side_are_those_one_by_one(make):
    given = sampled(steady(make()))

    def end(mass):
        return fly(
            with_leaf(given, lambda s: s.vehicle.mass, mass), FixedStep(1.0)
        ).state

    masses = jnp.array([900.0, 992.0, 1100.0])
    together = over(end)(masses)
    alone = jax.jit(lambda x: jax.lax.map(end, x))(masses)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11)


# A side by what is predicted


def towards(kept, reversed_now, sign=1.0):
    """A destination whose law predicts these errors of the crossrange, in 200 s.

    A bank that is reversed takes 13 s more, by which nothing is reckoned.
    """

    def predicted(side):
        error = jnp.where(side == sign, kept, reversed_now)
        return PredictedPassage(error, jnp.where(side == sign, 200.0, 213.0))

    nothing = jnp.asarray(0.0)
    return Destination(mars_planet(), ORIGIN, nothing, nothing, predicted)


@pytest.mark.parametrize(
    ("kept", "reversed_now", "turns"),
    [
        (9e3, 2.9e3, True),
        (-9e3, 2.9e3, True),
        (9e3, -3.1e3, False),
        (1e3, 9e3, False),
        (400.0, 1.0, False),  # within the tolerance
        (9e3, float("nan"), False),
        (float("nan"), 1.0, False),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bank_is_reversed_where_that_is_predicted_to_end_nearer(
    kept, reversed_now, turns, sign
):
    logic = PredictedCrossrange(factor=3.0, tolerance=500.0, first_sign=sign)
    side = logic.init(seen(ORIGIN))
    after = logic.update(TIME, seen(ORIGIN), side, towards(kept, reversed_now, sign))
    assert float(logic.sign(after)) == (-sign if turns else sign)
    assert float(after.reversals) == turns


def test_reversals_are_counted_and_limited():
    logic = PredictedCrossrange(most=2.0)
    side = logic.init(seen(ORIGIN))
    signs = []
    for _ in range(4):
        to_there = towards(9e3, 1e3, float(logic.sign(side)))
        side = logic.update(TIME, seen(ORIGIN), side, to_there)
        signs.append(float(logic.sign(side)))
    assert signs == [-1.0, 1.0, 1.0, 1.0]
    assert float(side.reversals) == 2.0


def error_of(reversed_after, push=5.0, at_reversal=0.0, rate=0.0, time=200.0):
    """Of a push to the right, positive to the left, that turns over after a while."""
    before, after = reversed_after, time - reversed_after
    drift = rate * time - push * before * (0.5 * before + after)
    return at_reversal + drift + 0.5 * push * after**2


@pytest.mark.parametrize("factor", [3.0, 5.0])
@pytest.mark.parametrize("rate", [30.0, 100.0])
def test_the_next_reversal_is_where_it_leaves_its_share(factor, rate):
    """Under a constant push to the side; beyond the destination."""
    kept, reversed_now = (error_of(t, rate=rate) for t in (200.0, 0.0))
    assert kept < 0.0 < reversed_now
    logic = PredictedCrossrange(factor=factor, foresees=True)
    side = logic.init(seen(ORIGIN))
    assert np.isinf(logic.reverses_at(side))
    side = logic.update(TIME, seen(ORIGIN), side, towards(kept, reversed_now))
    expected = brentq(
        lambda t: error_of(t, rate=rate) + kept / factor, 0.0, 200.0, xtol=1e-9
    )
    assert float(side.sign) == 1.0
    at = float(TIME) + expected
    assert float(logic.reverses_at(side)) == pytest.approx(at, abs=1e-6)
    # At a decision before it nothing is done; at one after it, it has been.
    where_it_is = towards(kept, reversed_now)
    early = logic.update(jnp.asarray(at - 1e-3), seen(ORIGIN), side, where_it_is)
    assert (float(early.sign), float(early.reversals)) == (1.0, 0.0)
    where_it_is = towards(-kept / factor, kept, -1.0)
    late = logic.update(jnp.asarray(at + 1e-3), seen(ORIGIN), side, where_it_is)
    assert (float(late.sign), float(late.reversals)) == (-1.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "kept", "reversed_now"),
    [
        ({}, 1e3, 9e3),  # it would end farther away
        ({"tolerance": 10e3}, -9e3, 20e3),
        ({"most": 0.0}, -9e3, 20e3),
        ({}, 9e3, 9e3),  # nothing turns it
        ({}, float("nan"), 9e3),
    ],
)
def test_no_reversal_is_expected_where_none_will_be(changes, kept, reversed_now):
    logic = PredictedCrossrange(**changes, foresees=True)
    before = logic.init(seen(ORIGIN))
    side = logic.update(TIME, seen(ORIGIN), before, towards(kept, reversed_now))
    assert float(side.reversals) == 0.0
    assert float(logic.reverses_at(side)) == np.inf


def test_after_a_reversal_the_next_one_turns_back():
    """The two errors have changed their places."""
    logic = PredictedCrossrange(factor=3.0, foresees=True)
    side = logic.init(seen(ORIGIN))
    after = logic.update(TIME, seen(ORIGIN), side, towards(-9e3, 2e3))
    assert float(after.sign) == -1.0
    root = np.sqrt(4.0 / 3.0 * 2.0 / 11.0)
    at = float(TIME) + 200.0 * (1.0 - root)
    assert float(after.reverses_at) == pytest.approx(at)


def test_a_prediction_is_needed_to_go_by():
    logic = PredictedCrossrange()
    silent = dataclasses.replace(towards(1.0, 1.0), predicted=None)
    for destination in (None, silent):
        with pytest.raises(ValueError, match="take a CrossrangeCorridor"):
            logic.update(TIME, seen(ORIGIN), logic.init(seen(ORIGIN)), destination)
