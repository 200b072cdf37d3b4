"""Attitude between command and motion: responses, limits, and what is sensed and flown."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, free_scenario, with_leaf

from jentry.fields import Scalar, scalar
from jentry.flight import FixedStep, fly
from jentry.flight.closed_loop import sense, start
from jentry.guidance import AbstractContinuousLaw, BankProfile
from jentry.motion import Controls, IdealAttitude, Response, SecondOrderAttitude
from jentry.motion.attitude import Swing
from jentry.onboard import PolynomialProfile
from jentry.units import degree
from jentry.world import PolynomialAerodynamics


FREE = 1e9
"""A limit that is none"""

FREQUENCY, DAMPING = 0.6, 0.7

STEP = 0.02


def response(rate=FREE, acceleration=FREE, reach=FREE, damping=DAMPING):
    return Response(FREQUENCY, damping, rate, acceleration, -reach, reach)


def swings(given, command, seconds, start=(0.0, 0.0)):
    """Angle and rate over time, by Runge-Kutta steps; (steps + 1,) each."""
    command = jnp.asarray(command)

    def step(swing, _):
        solver = FixedStep(STEP)
        field = lambda t, s: given.turn(s, command)
        after = solver.advance(field, jnp.asarray(0.0), jnp.asarray(STEP), swing)
        return after, after

    first = Swing(*map(jnp.asarray, start))
    _, path = jax.lax.scan(step, first, length=round(seconds / STEP))
    return jax.tree.map(lambda a, b: np.append(float(a), b), first, path)


def test_a_response_without_limits_is_that_of_the_linear_equation():
    """1 - exp(-d w t) (cos + d / sqrt(1 - d^2) sin)(w sqrt(1 - d^2) t)."""
    path = swings(response(), 0.3, 12.0)
    time = STEP * np.arange(len(path.angle))
    fall = np.exp(-DAMPING * FREQUENCY * time)
    turn = np.sqrt(1.0 - DAMPING**2)
    phase = FREQUENCY * turn * time
    wave = np.cos(phase) + DAMPING / turn * np.sin(phase)
    # What Runge-Kutta leaves in a step of 0.012 rad.
    np.testing.assert_allclose(path.angle, 0.3 * (1.0 - fall * wave), atol=1e-9)
    rate = 0.3 * FREQUENCY / turn * fall * np.sin(phase)
    np.testing.assert_allclose(path.rate, rate, atol=1e-9)


def test_limits_of_rate_and_acceleration_hold_and_are_used():
    """A reversal from 60 to -60 degrees: full acceleration, then full rate."""
    limit, swift = 5.0 * degree, 1.7 * degree
    given = response(limit, swift, damping=1.0)
    path = swings(given, -60.0 * degree, 60.0, (60.0 * degree, 0.0))
    moved = np.abs(np.diff(path.rate)) / STEP
    assert np.max(np.abs(path.rate)) <= limit * (1.0 + 1e-12) + swift * STEP
    assert np.max(moved) <= swift * (1.0 + 1e-12)
    # 5 deg/s after 2.94 s of 1.7 deg/s2, 7.35 deg on; then 5 deg/s.
    time = STEP * np.arange(len(path.angle))
    for seconds in (1.0, 2.5):
        fallen = 60.0 * degree - 0.5 * swift * seconds**2
        assert np.interp(seconds, time, path.angle) == pytest.approx(fallen, abs=1e-5)
    for seconds in (4.0, 12.0, 18.0):
        turned = 60.0 - 0.5 * 5.0**2 / 1.7 - 5.0 * (seconds - 5.0 / 1.7)
        # The corner where the limit is met lies within a step.
        found = np.interp(seconds, time, path.angle) / degree
        assert found == pytest.approx(turned, abs=0.5 * 1.7 * STEP * 5.0)
    assert path.angle[-1] == pytest.approx(-60.0 * degree, abs=1e-4)


def test_an_angle_stays_within_its_limits():
    """Neither a command nor a swing past it goes beyond."""
    given = response(reach=0.2, damping=0.1)
    beyond = swings(given, 0.5, 30.0)
    # A step may end behind the stop, by what it covers.
    assert np.max(beyond.angle) <= 0.2 + STEP * np.max(np.abs(beyond.rate))
    assert beyond.angle[-1] == pytest.approx(0.2, abs=1e-2)
    assert float(given.within(jnp.asarray(-0.7))) == -0.2


class Turning(AbstractContinuousLaw[None]):
    """A bank and an angle of attack that depends on the sensed drag of the instant."""

    bank_angle: Scalar = scalar(0.9, unit="rad")
    per_drag: Scalar = scalar(1e-3, unit="rad s2/m")

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        angle = 0.1 + self.per_drag * measurement.drag
        return Controls.from_bank(self.bank_angle, angle), None


def lagging(frequency=0.5, **limits):
    axis = lambda reach: Response(
        frequency,
        0.9,
        limits.get("rate", FREE),
        limits.get("acceleration", FREE),
        -reach,
        reach,
    )
    return SecondOrderAttitude(axis(0.5), axis(80 * degree))


def scenario(law=None, attitude=None):
    """On Mars, with a lift that grows with the angle of attack."""
    given = free_scenario()
    vehicle = dataclasses.replace(
        given.vehicle,
        aerodynamics=PolynomialAerodynamics((0.1, 1.0), (1.2, 0.0, 1.5)),
    )
    return dataclasses.replace(
        given,
        vehicle=vehicle,
        guidance=Turning() if law is None else law,
        attitude=lagging() if attitude is None else attitude,
    )


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


@pytest.mark.slow
def test_a_swift_attitude_is_an_ideal_one():
    """Of a bank and an angle of attack that change little: the error goes with the lag,
    2 damping / frequency."""
    law = BankProfile(PolynomialProfile([0.6, 0.2], 503.0, 6000.0), jnp.asarray(0.1))
    ideal = fly_compiled(scenario(law, IdealAttitude()), FixedStep(0.1))
    far = []
    for frequency in (2.0, 4.0):
        end = fly_compiled(scenario(law, lagging(frequency)), FixedStep(0.1))
        far.append(float(end.state.longitude - ideal.state.longitude))
    assert ideal.history is None and abs(far[1]) < 1e-4
    assert far[0] / far[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_gradients_reach_the_response():
    """Of where the flight ends, by the frequency of the bank, against differences."""

    def end(frequency):
        given = scenario(attitude=lagging(rate=5 * degree, acceleration=2 * degree))
        moved = with_leaf(
            given, lambda s: s.attitude.bank_response.frequency, frequency
        )
        return fly(moved, FixedStep(0.5)).state.longitude

    pushed = jax.jit(jax.jacfwd(end))(jnp.asarray(0.5))
    pulled = jax.jit(jax.grad(end))(jnp.asarray(0.5))
    value, h = jax.jit(end), 1e-4
    difference = (value(jnp.asarray(0.5 + h)) - value(jnp.asarray(0.5 - h))) / (2.0 * h)
    assert float(pulled) == pytest.approx(float(pushed), rel=1e-9)
    # Second order of the step, and a flight of order one to 1e-13.
    assert float(pushed) == pytest.approx(float(difference), rel=1e-5)


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


def trapezoid(given: Response, command, seconds, start):
    """Angle over time by another scheme, in plain numpy: acceleration within its limit,
    then the rate within its own, then the angle, by the mean of old and new rate."""
    step = 0.1 * STEP
    angle, rate = start
    f, d = float(given.frequency), float(given.damping)
    fastest, swiftest = float(given.rate_limit), float(given.acceleration_limit)
    lower, upper = float(given.lower), float(given.upper)
    wanted = np.clip(command, lower, upper)
    path = [angle]
    for _ in range(round(seconds / step)):
        wish = f * f * (wanted - angle) - 2.0 * d * f * rate
        after = rate + step * np.clip(wish, -swiftest, swiftest)
        after = np.clip(after, -fastest, fastest)
        angle = np.clip(angle + 0.5 * step * (rate + after), lower, upper)
        rate = after
        path.append(angle)
    return np.array(path)[::10]


@pytest.mark.parametrize(
    ("command", "start", "damping"),
    [
        (-60.0, 60.0, 1.0),  # a reversal
        (60.0, -75.0, 0.3),  # past its command
        (100.0, 0.0, 0.3),  # against the stop, and back into it
        (-78.0, 30.0, 0.1),  # over the stop and off it
    ],
)
def test_limits_act_on_acceleration_then_rate_then_angle(command, start, damping):
    """With the numbers of a winged vehicle: 80 deg, 5 deg/s, 1.7 deg/s2."""
    given = response(5 * degree, 1.7 * degree, 80 * degree, damping)
    ours = swings(given, command * degree, 90.0, (start * degree, 0.0)).angle
    flown = np.asarray(jax.vmap(given.within)(jnp.asarray(ours)))
    other = trapezoid(given, command * degree, 90.0, (start * degree, 0.0))
    # A limit is met within a step: so much is turned in half of one, at full rate.
    assert np.max(np.abs(flown - other)) < 0.5 * STEP * 5.0 * degree
    assert np.max(np.abs(flown)) <= 80 * degree


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
