"""The attitude response alone: its equation and its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from attitudes import DAMPING, FREQUENCY, STEP, response, swings

from jentry.motion import Response
from jentry.units import degree


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
