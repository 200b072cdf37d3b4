"""How a law believes that a bank is turned."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.flight import FixedStep
from jentry.motion import Response
from jentry.motion.attitude import Swing
from jentry.onboard import BankTurning
from jentry.units import degree


RATE, ACCELERATION = 5.0, 1.7
"""deg/s and deg/s2"""

TURNING = BankTurning(RATE * degree, ACCELERATION * degree)


@jax.jit
def flown(angle, rate, wanted, times, reverses_in):
    bank = Swing(angle * degree, rate * degree)
    at = lambda time: TURNING.flown(bank, wanted * degree, time, reverses_in)
    return jax.vmap(at)(times) / degree


def turned(angle, rate, wanted, times, reverses_in):
    """In short steps: towards what is commanded, where it stops; a reversal begins at
    rest."""
    step, path = 1e-3, []
    grid = np.arange(0.0, times[-1] + 2 * step, step)
    for time in grid:
        path.append(angle)
        target = -wanted if time >= reverses_in else wanted
        if 0.0 <= time - reverses_in < step or angle == target:
            rate = 0.0
        if angle == target:
            continue
        way = np.sign(target - angle)
        change = np.clip(RATE - way * rate, -ACCELERATION * step, ACCELERATION * step)
        before, rate = rate, rate + way * change
        moved = angle + 0.5 * (before + rate) * step
        angle = target if way * (target - moved) <= 0.0 else moved
    return np.interp(times, grid, path)


@pytest.mark.parametrize(
    ("angle", "rate", "wanted", "reverses_in"),
    [
        (60.0, 0.0, -60.0, np.inf),
        (-30.0, 0.0, -20.0, np.inf),
        (40.0, -5.0, -50.0, np.inf),
        (40.0, 3.0, -50.0, np.inf),  # still turning the other way
        (45.0, 0.0, 45.0, 12.0),
        (30.0, 5.0, 60.0, 20.0),
        (50.0, 0.0, 50.0, 0.0),
        (-50.0, 0.0, 50.0, 5.0),  # before the turn is finished
        (-50.0, 0.0, 50.0, 12.0),  # and when the other side has been reached
        (-60.0, 9.0, 60.0, np.inf),  # faster than is believed to be possible
    ],
)
def test_a_bank_turns_by_the_acceleration_up_to_the_rate(
    angle, rate, wanted, reverses_in
):
    times = np.linspace(0.0, 50.0, 101)
    found = flown(angle, rate, wanted, jnp.asarray(times), reverses_in)
    expected = turned(angle, rate, wanted, times, reverses_in)
    # Where it begins and stops lies within a step of 1e-3 s, at 5 deg/s.
    np.testing.assert_allclose(found, expected, atol=0.01)
    assert found[-1] == pytest.approx(wanted if reverses_in > 50.0 else -wanted)


def test_a_reversal_is_that_of_the_attitude_but_for_its_end():
    """Of the RLV. The integral of the bank tells by how much time it ends early."""
    response = Response(0.6, 1.0, RATE * degree, ACCELERATION * degree, -1.4, 1.4)
    step, bank = 0.02, 50.0
    at = jnp.asarray(0.0), jnp.asarray(step)
    field = lambda time, swing: response.turn(swing, jnp.asarray(-bank * degree))

    def advance(swing, _):
        after = FixedStep(step).advance(field, *at, swing)
        return after, after.angle / degree

    start = Swing(jnp.asarray(bank * degree), jnp.asarray(0.0))
    _, actual = jax.lax.scan(advance, start, length=2500)
    times = step * jnp.arange(1, 2501)
    believed = flown(bank, 0.0, -bank, times, np.inf)
    before = times < 18.0  # from where the bank is slowed down, 17 degrees before
    np.testing.assert_allclose(believed[before], actual[before], atol=0.3)
    late = step * float(jnp.sum(actual - believed)) / (2.0 * bank)
    assert 0.05 < late < 0.3


def test_what_is_commanded_may_go_on_changing():
    """Slower than the bank turns: it is followed at once where it has been met."""
    times = jnp.array([0.0, 10.0, 20.0, 40.0])
    wanted = 30.0 + 0.5 * times
    bank = Swing(jnp.asarray(30.0 * degree), jnp.asarray(0.0))
    found = [
        TURNING.flown(bank, w * degree, t) for w, t in zip(wanted, times, strict=True)
    ]
    np.testing.assert_allclose(np.array(found) / degree, wanted, atol=1e-12)
