"""Losses are what their names say, and so are their derivatives."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.flight.flight import History
from jentry.flight.miss import Misses
from jentry.motion import ConstraintValues, Controls, EntryState
from jentry.tuning.losses import (
    BY_NAME,
    MeanSquare,
    OfDistance,
    ScaledMisses,
    bank_turns,
    conditional_value_at_risk,
    control_effort,
    excess,
    mean_square,
    power_mean,
    probability_outside,
    smooth_maximum,
)


RNG = np.random.default_rng(20261121)

VALUES = RNG.normal(0.3, 1.5, 37)
"""Of both signs, without ties"""

CLOSE = 1e-13
"""Relative; rounding of sums of some tens of numbers of order one."""


def cvar(values, share=0.05):
    """By the definition of Rockafellar and Uryasev: its minimum lies at a value."""
    return min(t + np.mean(np.maximum(values - t, 0.0)) / share for t in values)


def outside(values, half_widths, softness=0.1):
    """By the hyperbolic tangent, in which the soft step is (1 + tanh(x / 2)) / 2."""
    within = np.ones(np.shape(values[0]))
    for x, half in zip(values, half_widths, strict=True):
        within *= 0.5 + 0.5 * np.tanh(0.5 * (half - np.abs(x)) / (softness * half))
    return 1.0 - np.mean(within)


def misses_of(downrange, crossrange):
    one = lambda x, y: Misses(x, y, jnp.zeros(()), jnp.zeros(()))
    return jax.vmap(one)(jnp.asarray(downrange), jnp.asarray(crossrange))


# Each against numpy.


def test_mean_square():
    found = mean_square(jnp.asarray(VALUES))
    np.testing.assert_allclose(found, np.dot(VALUES, VALUES) / 37, rtol=CLOSE)


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0, 7.5])
def test_power_mean(power):
    found = power_mean(jnp.asarray(VALUES), power)
    expected = np.mean(np.abs(VALUES) ** power) ** (1.0 / power)
    np.testing.assert_allclose(found, expected, rtol=CLOSE)
    assert power_mean(jnp.zeros(3), power) == 0.0
    with pytest.raises(ValueError, match="power is 0.5: it must be at least 1"):
        power_mean(jnp.asarray(VALUES), 0.5)


@pytest.mark.parametrize("width", [1e-6, 0.01, 0.3, 5.0])
@pytest.mark.parametrize("shift", [0.0, -1e3, 1e3])
def test_smooth_maximum_is_at_the_largest_or_a_little_above(width, shift):
    values = VALUES + shift
    found = smooth_maximum(jnp.asarray(values), width)
    largest = values.max()
    shares = np.exp((values - largest) / width)
    # Rounding of numbers as large as the shift.
    rounding = 4e-13 if shift else 4e-15
    expected = largest + width * np.log(shares.sum())
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=rounding)
    assert largest - rounding <= found
    assert found <= largest + width * np.log(len(values)) + rounding


def test_smooth_maximum_of_equal_values_is_at_its_bound():
    found = smooth_maximum(jnp.full(8, 2.0), jnp.asarray(0.1))
    np.testing.assert_allclose(found, 2.0 + 0.1 * np.log(8.0), rtol=CLOSE)


@pytest.mark.parametrize("share", [1e-3, 1 / 37, 0.05, 0.1, 0.5, 0.999, 1.0])
def test_cvar_is_the_mean_of_the_worst(share):
    """The last of them counts in part, where the share ends between two flights."""
    found = conditional_value_at_risk(jnp.asarray(VALUES), share)
    np.testing.assert_allclose(found, cvar(VALUES, share), rtol=CLOSE)
    among = share * len(VALUES)
    whole = int(among + 1e-9)
    worst = np.sort(VALUES)[::-1]
    last = (among - whole) * worst[whole] if whole < len(worst) else 0.0
    by_sorting = (worst[:whole].sum() + last) / among
    np.testing.assert_allclose(found, by_sorting, rtol=CLOSE)


def test_cvar_is_a_twentieth_if_nothing_is_said():
    values = jnp.asarray(RNG.permutation(100.0 + np.arange(60.0)))
    assert conditional_value_at_risk(values) == 158.0  # mean of 159, 158 and 157


def test_cvar_goes_from_the_largest_to_the_mean():
    values = jnp.asarray(VALUES)
    assert conditional_value_at_risk(values, 1e-9) == VALUES.max()
    np.testing.assert_allclose(
        conditional_value_at_risk(values, 1.0), VALUES.mean(), rtol=CLOSE
    )


@pytest.mark.parametrize("share", [0.0, -0.1, 1.01, np.nan])
def test_cvar_of_no_share_is_an_error(share):
    with pytest.raises(ValueError, match=f"share is {share}: it must be above 0"):
        conditional_value_at_risk(jnp.asarray(VALUES), share)


@pytest.mark.parametrize("softness", [0.03, 0.1, 2.0])
def test_soft_probability_of_leaving_a_box(softness):
    box = (VALUES, 3.0 * VALUES[::-1])
    half_widths = (1.0, 4.0)
    values = tuple(jnp.asarray(x.copy()) for x in box)
    found = probability_outside(values, half_widths, softness)
    # One minus a mean: of its rounding, whatever is left.
    expected = outside(box, half_widths, softness)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=CLOSE)
    alone = probability_outside(values[0], 1.0, softness)
    np.testing.assert_allclose(alone, outside(box[:1], (1.0,), softness), atol=CLOSE)


def test_soft_probability_tends_to_the_share_outside():
    values = jnp.asarray(VALUES), jnp.asarray(VALUES**2)
    share = np.mean((np.abs(VALUES) > 1.0) | (VALUES**2 > 0.7))
    assert 0.2 < share < 0.8
    errors = [
        abs(probability_outside(values, (1.0, 0.7), softness) - share)
        for softness in (0.3, 0.03, 1e-4)
    ]
    assert errors[0] > errors[1] > errors[2]
    # No value is within a hundred times the softness of the border: rounding is left.
    assert errors[2] < CLOSE


def test_a_flight_on_the_border_counts_by_half():
    values = jnp.asarray([0.0, 2.0, -2.0, 40.0])
    # Two on the border, one outside; the one in the middle is out by exp(-10).
    found = probability_outside(values, 2.0)
    np.testing.assert_allclose(found, 0.25 * (2 * 0.5 + 1.0 + 4.54e-5), rtol=1e-8)


def test_excess_of_a_limit():
    peaks = jnp.asarray([3.0, 11.999, 12.0, 15.0, 24.0])
    # Over the limit of 12: by a quarter and by one.
    found = excess(peaks, 12.0)
    np.testing.assert_allclose(found, (0.25**2 + 1.0) / 5, rtol=CLOSE)
    assert excess(peaks, jnp.asarray(24.0)) == 0.0


# Control effort.

FLYING = 6
TIMES = np.array([0.0, 1.0, 2.5, 3.5, 4.0, 6.0])
COS_BANK = RNG.uniform(-1.0, 1.0, FLYING)
ANGLE_OF_ATTACK = RNG.uniform(-0.2, 0.2, FLYING)


def history(flying=FLYING, longest=9):
    """As a flight leaves it, NaN after its end; the sine changes its sign all the time."""

    def entry(time, angle_of_attack, cos_bank, sin_bank):
        controls = Controls(angle_of_attack, cos_bank, sin_bank)
        state = EntryState(*(time for _ in range(6)))
        return History(
            time, state, controls, None, ConstraintValues({"drag": time}), None
        )

    sine = np.sqrt(1.0 - COS_BANK**2) * (-1.0) ** np.arange(FLYING)
    columns = np.full((4, longest), np.nan)
    flown = np.stack([TIMES, ANGLE_OF_ATTACK, COS_BANK, sine])
    columns[:, :flying] = flown[:, :flying]
    return jax.vmap(entry)(*jnp.asarray(columns))


@pytest.mark.parametrize("flying", [2, 3, 6])
@pytest.mark.parametrize("after", [0, 1, 5])
def test_control_effort_is_the_mean_square_rate_until_the_end(flying, after):
    found = control_effort(history(flying, flying + after))
    interval = np.diff(TIMES[:flying])
    rates = [
        np.diff(c[:flying]) / interval for c in (COS_BANK, ANGLE_OF_ATTACK)
    ]  # held through an interval
    squares = rates[0] ** 2 + rates[1] ** 2
    expected = np.average(squares, weights=interval)
    np.testing.assert_allclose(found, expected, rtol=CLOSE)


def test_gradient_of_control_effort_stops_at_the_end_of_the_flight():
    gradient = jax.jit(jax.grad(control_effort))(history())
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient))
    for command in (gradient.controls.cos_bank, gradient.controls.angle_of_attack):
        assert np.all(command[:FLYING] != 0.0)
        assert np.all(command[FLYING:] == 0.0)
    assert np.all(gradient.controls.sin_bank == 0.0)

    # Of a sum of squares: by hand, from the rates to both sides of an entry.
    rate = np.diff(COS_BANK) / np.diff(TIMES)
    by_hand = 2.0 / TIMES[-1] * (np.r_[0.0, rate] - np.r_[rate, 0.0])
    np.testing.assert_allclose(gradient.controls.cos_bank[:FLYING], by_hand, rtol=CLOSE)


# Losses of misses.

MISSES = misses_of(1500.0 * VALUES, 400.0 * VALUES[::-1] ** 2)
SCALED = ScaledMisses((("downrange", 1000.0), ("crossrange", 500.0)))
RESIDUALS = 1.5 * VALUES, 0.8 * VALUES[::-1] ** 2
DISTANCE = np.hypot(*RESIDUALS)


def test_scaled_misses_are_those_that_are_named_over_their_scales():
    found = SCALED(MISSES)
    np.testing.assert_allclose(found, RESIDUALS, rtol=1e-15)  # one division more
    assert SCALED == ScaledMisses((("downrange", 1000.0), ("crossrange", 500.0)))
    assert hash(SCALED) == hash(ScaledMisses(SCALED.scales))


def test_mean_square_of_several_residuals():
    found = MeanSquare(SCALED)(MISSES)
    np.testing.assert_allclose(found, np.mean(DISTANCE**2), rtol=CLOSE)
    alone = MeanSquare(lambda misses: misses.downrange / 1000.0)(MISSES)
    np.testing.assert_allclose(alone, np.mean(RESIDUALS[0] ** 2), rtol=CLOSE)


def test_statistic_of_the_distance():
    found = OfDistance(jnp.max, SCALED)(MISSES)
    np.testing.assert_allclose(found, DISTANCE.max(), rtol=CLOSE)
    alone = OfDistance(jnp.mean, lambda misses: misses.downrange)(MISSES)
    np.testing.assert_allclose(alone, 1500.0 * np.abs(VALUES).mean(), rtol=CLOSE)


EXPECTED = {
    "mean-square": np.mean(DISTANCE**2),
    "power-mean": np.mean(DISTANCE**4) ** 0.25,
    "cvar": cvar(DISTANCE),
    "worst-case": 0.1 * np.log(np.sum(np.exp(DISTANCE / 0.1))),
    "outside": outside([DISTANCE], [1.0]),
}


@pytest.mark.parametrize("name", BY_NAME)
def test_losses_by_name(name):
    np.testing.assert_allclose(
        BY_NAME[name](SCALED)(MISSES), EXPECTED[name], rtol=CLOSE
    )


# Derivatives.

DIFFERENTIABLE = {
    "mean square": mean_square,
    "smooth maximum": lambda x: smooth_maximum(x, 0.3),
    "power mean": power_mean,
    "cvar": lambda x: conditional_value_at_risk(x, 0.1),
    "cvar of the magnitude": lambda x: conditional_value_at_risk(jnp.abs(x), 0.42),
    "outside": lambda x: probability_outside(x, 1.1, 0.3),
    "outside a box": lambda x: probability_outside((x, x[::-1]), (1.1, 2.0), 0.5),
    "excess": lambda x: excess(x, 0.7),
    **{
        name: lambda x, make=make: make(SCALED)(misses_of(1e3 * x, 200.0 * x[::-1]))
        for name, make in BY_NAME.items()
    },
}


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_derivatives_are_those_of_central_differences(name):
    """And finite where all misses are zero, or so small that their squares are."""
    loss = DIFFERENTIABLE[name]
    gradient = jax.jit(jax.grad(loss))
    step = 1e-5 * np.eye(len(VALUES))
    ahead, behind = jax.jit(jax.vmap(jax.vmap(loss)))(
        jnp.asarray([VALUES + step, VALUES - step])
    )
    np.testing.assert_allclose(
        gradient(jnp.asarray(VALUES)),
        (ahead - behind) / 2e-5,
        # Third derivatives times the step's square, and rounding over the step. No two
        # values, and no value and a corner, are as near to each other as the step.
        rtol=1e-6,
        atol=1e-8,
    )
    assert np.isfinite(gradient(jnp.zeros_like(VALUES))).all()
    assert np.isfinite(gradient(jnp.asarray(1e-200 * VALUES))).all()


@pytest.mark.parametrize("name", BY_NAME)
def test_a_flight_that_hits_pulls_nowhere(name):
    """A loss of distances has a corner there, and is even about it."""
    misses = misses_of([0.0, 900.0], [0.0, -700.0])
    gradient = jax.jit(jax.grad(BY_NAME[name](SCALED)))(misses)
    assert gradient.downrange[0] == gradient.crossrange[0] == 0.0


def test_flights_that_do_not_matter_have_no_gradient():
    flights = 140
    values = jnp.asarray(RNG.normal(size=flights))
    gradient = jax.jit(jax.grad(conditional_value_at_risk))(values)
    worst = np.argsort(values)[-flights // 20 :]
    assert set(np.flatnonzero(gradient)) == set(worst)
    # One in twenty: the weights are the reciprocal of how many there are.
    np.testing.assert_allclose(gradient[worst], 20 / flights, rtol=CLOSE)
    below = jax.jit(jax.grad(lambda x: excess(x, 1.0)))(values)
    assert np.array_equal(below != 0.0, values > 1.0)


def test_a_miss_that_the_target_does_not_have_is_an_error():
    from jentry.flight.miss import Misses
    from jentry.tuning.losses import ScaledMisses

    missed = Misses(*(jnp.asarray(x) for x in (1.0, 2.0, 3.0, 4.0)))
    with pytest.raises(ValueError, match="the target has no heading"):
        ScaledMisses((("heading", 1.0),))(missed)


class Turned(NamedTuple):
    """What a neural law holds, as far as its turns are concerned."""

    bank: jax.Array


def turning(bank, time):
    """A history with banks of a neural law."""

    def entry(time, bank):
        state, still = EntryState(*(time for _ in range(6))), Controls(time, time, time)
        return time, state, still, ConstraintValues({"drag": time}), bank

    time, state, controls, values, banks = jax.vmap(entry)(time, bank)
    return History(time, state, controls, None, values, Turned(banks))


def test_turns_of_the_bank_are_those_of_their_formula():
    """Root mean square of the differences, up to the end of the flight."""
    bank = jnp.asarray([0.1, 0.5, -0.2, -0.2, 3.0, 9.0])
    time = jnp.asarray([0.0, 2.0, 4.0, 6.0, np.nan, np.nan])
    expected = np.sqrt((0.4**2 + 0.7**2 + 0.0) / 3.0)
    assert float(bank_turns(turning(bank, time))) == pytest.approx(expected, rel=1e-9)
    still = jnp.full(6, 0.3)
    value, slope = jax.value_and_grad(lambda b: bank_turns(turning(b, time)))(still)
    assert float(value) < 1e-5 and np.all(np.isfinite(slope))


def test_turns_are_of_one_flight():
    two = jax.vmap(turning)(jnp.zeros((2, 3)), jnp.zeros((2, 3)))
    with pytest.raises(ValueError, match="the turns are of one flight"):
        bank_turns(two)
