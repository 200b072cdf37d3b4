"""Lateral logic: predicted crossrange, corridors and reversals, alone and in flight."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import (
    bank_profile,
    fly_compiled,
    mars_planet,
    mars_scenario,
    over,
    with_leaf,
)
from lateral_states import ORIGIN, TIME, after, headed, seen

from jentry.fields import Scalar, scalar
from jentry.flight import FixedStep, Scenario, check, fly
from jentry.guidance import (
    AbstractLateralLogic,
    CrossrangeCorridor,
    Destination,
    FixedSide,
    HeadingCorridor,
    Sampled,
    VelocityReversals,
)
from jentry.guidance.lateral import predicted_crossrange, reverse_bank, turned
from jentry.guidance.open_loop import vertical_lift_command
from jentry.missions import find_mission
from jentry.motion import EntryDynamics, ground_track
from jentry.onboard import Measurement
from jentry.units import degree, km


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


def test_a_corridor_without_width_far_from_the_target_is_refused():
    """It would reverse the bank in every cycle, to a miss that looks small."""
    scenario = find_mission("mars-range-tracking").scenario("range-tracking")
    narrow = with_leaf(scenario, lambda s: s.guidance.lateral.widening, -1e-4)
    with pytest.raises(ValueError, match=r"guidance\.lateral\.widening is -0\.0001"):
        check(narrow)


@pytest.mark.parametrize("cos_bank", [-1.3, -0.4, 0.7, 1.3])
def test_bank_to_the_left_mirrors_bank_to_the_right(cos_bank):
    angle_of_attack = jnp.asarray(0.0)
    right = vertical_lift_command(jnp.asarray(cos_bank), angle_of_attack)
    left = turned(right, -1.0)
    assert left.cos_bank == right.cos_bank
    assert left.sin_bank == -right.sin_bank
    assert right.sin_bank >= 0.0


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
