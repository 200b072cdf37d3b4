"""Attitude responses in flight: forces, sensed controls, limits and the first attitude."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from attitudes import FREE, STEP, Turning, lagging, scenario, swings
from helpers import along_each, fly_compiled, with_leaf

from jentry.fields import Scalar
from jentry.flight import FixedStep, fly
from jentry.flight.closed_loop import start
from jentry.flight.sensing import sense
from jentry.guidance import AbstractContinuousLaw, BankProfile
from jentry.motion import Controls, IdealAttitude, Response, SecondOrderAttitude
from jentry.motion.attitude import Swing
from jentry.onboard import PolynomialProfile
from jentry.units import degree


def test_forces_are_sensed_at_the_attitude_that_is_flown():
    """So an angle of attack that follows the forces is no algebraic loop; flown at once
    it is refused."""
    with pytest.raises(ValueError, match="Turning commands .* attitude that takes"):
        fly(scenario(attitude=IdealAttitude()), FixedStep(1.0))
    flight = fly_compiled(scenario(), FixedStep(0.5), 1.0)
    history = flight.history
    flown = np.asarray(history.controls.angle_of_attack)
    wanted = np.asarray(history.commands.angle_of_attack)
    drag = np.asarray(history.constraints.drag)
    finite = np.isfinite(flown)
    # The command is that of the drag at the attitude that is flown.
    np.testing.assert_allclose(wanted[finite], 0.1 + 1e-3 * drag[finite], rtol=1e-12)
    # While the drag grows the angle of attack is late.
    rising = finite & (np.gradient(drag) > 0.1)
    assert np.sum(rising) > 10 and np.all(flown[rising] < wanted[rising])


def test_the_bank_is_sensed_as_it_is_flown():
    """Within the limits of its angle and of its rate, which a step may leave."""
    given = scenario(attitude=lagging(rate=5 * degree))
    lane = start(given, 0.1)
    for (angle, rate), (flown, turns) in (
        ((-0.4, 0.03), (-0.4, 0.03)),
        ((0.4, -0.5), (0.4, -5 * degree)),
        ((1.5, 0.03), (80 * degree, 0.03)),
    ):
        attitude = dataclasses.replace(
            lane.moving.attitude,
            bank_angle=Swing(jnp.asarray(angle), jnp.asarray(rate)),
        )
        moving = dataclasses.replace(lane.moving, attitude=attitude)
        bank = sense(given, lane.flown, moving, lane.held).bank
        assert (float(bank.angle), float(bank.rate)) == pytest.approx((flown, turns))
    assert IdealAttitude().bank(None) is None


def test_an_attitude_follows_its_law_as_its_equation_says():
    """A held bank: the same second-order response as alone, from the first command on."""
    given = scenario(Turning(per_drag=0.0), lagging(rate=5 * degree))
    start = with_leaf(given, lambda s: s.guidance.bank_angle, -0.4)

    class Reversing(AbstractContinuousLaw[None]):
        """-0.4 rad at the very start, 0.9 after it."""

        def init(self, measurement):
            return None

        def __call__(self, time, measurement, memory):
            bank = jnp.where(time > 0.0, 0.9, -0.4)
            return Controls.from_bank(bank, jnp.asarray(0.1)), None

    flight = fly_compiled(
        dataclasses.replace(start, guidance=Reversing()), FixedStep(STEP), 1.0
    )
    controls = flight.history.controls
    bank = np.arctan2(controls.sin_bank, controls.cos_bank)[:20]
    axis = Response(0.5, 0.9, 5 * degree, FREE, -80 * degree, 80 * degree)
    alone = swings(axis, 0.9, 20.0, (-0.4, 0.0)).angle[:: round(1.0 / STEP)][:20]
    # A sixth of the first step is still commanded as before: so much later, at 5 deg/s.
    late = STEP / 6.0 * 5.0 * degree
    np.testing.assert_allclose(bank, alone, atol=1.2 * late)


VARYING = BankProfile(PolynomialProfile([0.6, 0.2], 503.0, 6000.0), jnp.asarray(0.1))
"""A law whose bank follows the velocity"""


@pytest.mark.slow
def test_a_swift_attitude_is_an_ideal_one():
    """Of a bank and an angle of attack that change little: the error goes with the lag,
    2 damping / frequency."""
    ideal = fly_compiled(scenario(VARYING, IdealAttitude()), FixedStep(0.1))
    far = []
    for frequency in (2.0, 4.0):
        end = fly_compiled(scenario(VARYING, lagging(frequency)), FixedStep(0.1))
        far.append(float(end.state.longitude - ideal.state.longitude))
    assert ideal.history is None and abs(far[1]) < 1e-4
    assert far[0] / far[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_gradients_reach_the_response():
    """Of where the flight ends, by the frequency of the bank, against differences."""

    def end(frequencies):
        given = scenario(VARYING, lagging(rate=5 * degree, acceleration=2 * degree))
        moved = with_leaf(
            given, lambda s: s.attitude.bank_response.frequency, frequencies[0]
        )
        return fly(moved, FixedStep(0.5)).state.longitude

    pushed, differences = along_each(end, [0.5], [1e-4])
    pulled = jax.jit(jax.grad(end))(jnp.array([0.5]))
    np.testing.assert_allclose(pulled, pushed, rtol=1e-9)
    assert abs(float(pushed[0])) > 1e-5
    # Second order of the step, and a flight of order one to 1e-13.
    np.testing.assert_allclose(pushed, differences, rtol=1e-5)


@pytest.mark.slow
def test_side_by_side_is_one_by_one():
    given = scenario(attitude=lagging(rate=5 * degree))

    def end(bank):
        moved = with_leaf(given, lambda s: s.guidance.bank_angle, bank)
        return fly(moved, FixedStep(0.5)).state

    banks = jnp.array([0.2, 0.9, 1.2])
    together = jax.jit(jax.vmap(end))(banks)
    alone = jax.jit(lambda x: jax.lax.map(end, x))(banks)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11)


def test_the_trim_of_the_vehicle_is_flown_where_a_law_leaves_the_angle_alone():
    law = BankProfile(PolynomialProfile([0.6], 503.0, 6000.0))
    ends = []
    for trim in (0.05, 0.2):
        given = scenario(law, IdealAttitude())
        moved = with_leaf(given, lambda s: s.vehicle.trim_angle_of_attack, trim)
        ends.append(fly_compiled(moved, FixedStep(0.5), 1.0))
    for flight, trim in zip(ends, (0.05, 0.2), strict=True):
        angle = np.asarray(flight.history.controls.angle_of_attack)
        assert np.all(angle[np.isfinite(angle)] == trim)
    # More lift at the larger one.
    assert float(ends[1].time) > float(ends[0].time) + 1.0


def test_commands_are_kept_where_they_are_not_flown_at_once():
    shapes = eqx.filter_eval_shape(fly, scenario(), FixedStep(1.0), 1.0)
    assert shapes.history.commands is not None
    law = BankProfile(PolynomialProfile([0.6], 503.0, 6000.0))
    shapes = eqx.filter_eval_shape(
        fly, scenario(law, IdealAttitude()), FixedStep(1.0), 1.0
    )
    assert shapes.history.commands is None


@pytest.mark.parametrize("name", ["frequency", "rate_limit", "acceleration_limit"])
def test_a_response_that_is_none_is_refused(name):
    where = lambda s: getattr(s.attitude.bank_response, name)
    with pytest.raises(ValueError, match=f"attitude.bank_response.{name} is 0"):
        fly(with_leaf(scenario(), where, 0.0), FixedStep(1.0))


def test_no_step_flies_beyond_the_limits_of_the_angles():
    """Steps of a quarter of a second, in which the response runs into its stops."""
    axis = Response(2.0, 0.05, 20 * degree, 40 * degree, -0.3, 0.3)

    class Swinging(AbstractContinuousLaw[None]):
        def init(self, measurement):
            return None

        def __call__(self, time, measurement, memory):
            wave = 0.35 * jnp.sin(0.8 * time)
            return Controls.from_bank(wave, wave), None

    given = scenario(Swinging(), SecondOrderAttitude(axis, axis))
    controls = fly_compiled(given, FixedStep(0.25), 1.0).history.controls
    angle = np.asarray(controls.angle_of_attack)
    bank = np.arcsin(np.asarray(controls.sin_bank))
    for flown in (angle, bank):
        # An arc sine of a sine.
        assert 0.29 < np.nanmax(np.abs(flown)) <= 0.3 + 1e-15


class FirstDrag(AbstractContinuousLaw[Scalar]):
    """Remembers the drag that it sensed first; bank -0.9 and angle of attack 0.1 rad."""

    def init(self, measurement):
        return measurement.drag

    def __call__(self, time, measurement, memory):
        angle = 0.1 + 0.0 * time
        return Controls.from_bank(-0.9 + 0.0 * time, angle), 0.0 * memory


def started(**first):
    response = Response(0.5, 0.9, 5 * degree, 1.7 * degree, -80 * degree, 80 * degree)
    return scenario(FirstDrag(), SecondOrderAttitude(response, response, **first))


def test_an_attitude_may_start_where_it_is_told_at_rest():
    first = {"first_angle_of_attack": 40 * degree, "first_bank_angle": 30 * degree}
    given = started(**first)
    swings = given.attitude.init(
        Controls.from_bank(jnp.asarray(-0.9), jnp.asarray(0.1))
    )
    assert float(swings.bank_angle.angle) == 30 * degree
    assert float(swings.bank_angle.rate) == float(swings.angle_of_attack.rate) == 0.0
    history = fly_compiled(given, FixedStep(0.5), 1.0).history
    angle, bank = (
        np.asarray(history.controls.angle_of_attack),
        np.arctan2(history.controls.sin_bank, history.controls.cos_bank),
    )
    assert angle[0] == pytest.approx(40 * degree, rel=1e-12)
    assert bank[0] == pytest.approx(30 * degree, rel=1e-12)
    # From rest, by 1.7 deg/s2 at most; and on to what is commanded.
    assert 0.0 < bank[0] - bank[1] < 0.85001 * degree
    assert bank[60] == pytest.approx(-0.9, abs=1e-2)
    assert angle[60] == pytest.approx(0.1, abs=1e-2)


@pytest.mark.parametrize("first", [None, 0.3, -0.2])
def test_the_first_forces_are_those_of_the_first_attitude(first):
    given = started() if first is None else started(first_angle_of_attack=first)
    sensed = start(given, 1.0).memory
    angle = 0.1 if first is None else first
    one = with_leaf(given, lambda s: s.attitude, IdealAttitude())
    one = with_leaf(one, lambda s: s.guidance, at(angle))
    drag = fly_compiled(one, FixedStep(0.5), 1.0).history.constraints.drag[0]
    assert float(sensed) == pytest.approx(float(drag), rel=1e-12)


def at(angle):
    profile = PolynomialProfile([1.0], 503.0, 6000.0)
    return BankProfile(profile, jnp.asarray(angle))


def test_without_one_of_its_own_an_attitude_starts_at_the_first_command():
    state = started().attitude.init(
        Controls.from_bank(jnp.asarray(-0.9), jnp.asarray(0.1))
    )
    assert float(state.bank_angle.angle) == pytest.approx(-0.9, rel=1e-14)
    assert float(state.angle_of_attack.angle) == 0.1
    one = started(first_bank_angle=0.2).attitude.init(Controls(0.1, 1.0, 0.0))
    assert float(one.bank_angle.angle) == 0.2
    assert float(one.angle_of_attack.angle) == 0.1


@pytest.mark.slow
def test_the_first_attitude_is_a_leaf_within_the_limits():
    given = started(first_bank_angle=30 * degree)
    where = lambda s: s.attitude.first_bank_angle

    def end(angle):
        return fly(with_leaf(given, where, angle), FixedStep(0.5)).state.latitude

    slope = jax.jit(jax.grad(end))(jnp.asarray(0.5))
    assert abs(float(slope)) > 1e-6
    far = with_leaf(given, where, 3.0).attitude.init(Controls(0.1, 1.0, 0.0))
    assert float(far.bank_angle.angle) == 80 * degree
    with pytest.raises(ValueError, match="first_bank_angle is 30 rad.*30deg"):
        fly(with_leaf(given, where, 30.0), FixedStep(1.0))
