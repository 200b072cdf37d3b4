"""Sharp switches are exact; smooth ones tend to them, and let gradients through."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ConstantBank, mars_planet, mars_scenario, mars_vehicle
from laws import error_gains, observer_law, state_feedback
from scipy import integrate, special

from jentry.addresses import field_metadata, leaves_by_address
from jentry.guidance import (
    AbstractSwitching,
    Sampled,
    Sharp,
    Smooth,
    SmoothReversals,
)
from jentry.guidance.drag_tracking import track
from jentry.motion import EntryState
from jentry.motion.index import EnergyIndex
from jentry.onboard import DragReference, PolynomialProfile, measure
from jentry.tuning.smoothing import smooth_switching
from jentry.units import degree, km


COMMANDS = np.r_[np.linspace(-4.0, 4.0, 4001), -1e300, -1e5, 1e5, 1e300]

WIDTHS = (1e-9, 1e-3, 0.05, 0.3, 1.0)

EXTREME = (-np.inf, -1e300, 1e300, np.inf)


@jax.jit
def limited(switching, commands):
    return jax.vmap(switching.limited)(commands)


@jax.jit
def slopes(switching, commands):
    return jax.vmap(jax.grad(switching.limited))(commands)


@jax.jit
def beyond(switching, excess, chosen, otherwise):
    over = jax.vmap(switching.beyond, in_axes=(0, None, None))
    return over(excess, chosen, otherwise)


def number(x):
    return jnp.asarray(x, dtype=float)


# The limits of the command.


def test_a_sharp_limit_clips():
    commands = np.r_[COMMANDS, EXTREME, -1.0, 1.0, -0.0]
    found = limited(Sharp(), jnp.asarray(commands))
    np.testing.assert_array_equal(found, np.clip(commands, -1.0, 1.0))
    assert np.isnan(Sharp().limited(number(np.nan)))


@pytest.mark.parametrize("command", [-1.5, -0.98, 0.0, 0.4, 1.0, 1.02, 1.3])
@pytest.mark.parametrize("width", [0.05, 0.3])
def test_a_smooth_limit_is_the_integral_of_two_logistic_steps(width, command):
    def slope(c):
        return special.expit((c + 1.0) / width) - special.expit((c - 1.0) / width)

    start = -1.0 - 45.0 * width
    corners = [c for c in (-1.0, 1.0) if c < command]
    integral, error = integrate.quad(
        slope, start, command, points=corners, epsabs=1e-13, epsrel=1e-13, limit=200
    )
    assert error < 1e-12
    found = Smooth(width).limited(number(command))
    np.testing.assert_allclose(found, integral - 1.0, rtol=0.0, atol=1e-12)  # the error
    gradient = jax.grad(Smooth(width).limited)(number(command))
    # Exponents of some tens, to rounding.
    np.testing.assert_allclose(gradient, slope(command), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_smooth_limit_tends_to_the_sharp_one(width):
    found = limited(Smooth(width), jnp.asarray(COMMANDS))
    away = np.abs(found - np.clip(COMMANDS, -1.0, 1.0))
    # At a limit a softplus is off by the width times log 2, and nowhere by more.
    assert away.max() <= width * np.log(2.0) + 4e-16
    if width < 0.1:
        # A few widths inside or outside it is off by the exponential of that.
        far = np.abs(np.abs(COMMANDS) - 1.0) > 40.0 * width
        assert far.any()
        assert away[far].max() < 1e-14  # rounding of the limits over the width


@pytest.mark.parametrize("width", WIDTHS)
def test_a_smooth_limit_is_never_left(width):
    commands = jnp.asarray(np.r_[COMMANDS, EXTREME])
    found = limited(Smooth(width), commands)
    assert np.isfinite(found).all()
    assert -1.0 <= found.min() and found.max() <= 1.0


@pytest.mark.parametrize("width", WIDTHS)
def test_a_smooth_limit_is_odd_and_rises(width):
    commands = jnp.asarray(COMMANDS[:4001])
    found = limited(Smooth(width), commands)
    # Rounding of a difference of numbers of order one.
    np.testing.assert_allclose(found, -found[::-1], rtol=0.0, atol=5e-15)
    assert np.all(np.diff(found) > -5e-15)


@pytest.mark.parametrize("width", WIDTHS)
def test_slope_of_a_smooth_limit_is_finite_wherever_the_command_is(width):
    found = slopes(Smooth(width), jnp.asarray(np.r_[COMMANDS, EXTREME]))
    assert np.isfinite(found).all()
    assert found.min() >= 0.0 and found.max() <= 1.0
    assert np.all(found[-4:] == 0.0)


def test_behind_a_smooth_limit_there_is_a_slope_and_behind_a_sharp_one_none():
    behind = jnp.asarray([-1.4, -1.1, 1.01, 1.1, 1.4])
    assert np.all(slopes(Sharp(), behind) == 0.0)
    found = slopes(Smooth(), behind)
    np.testing.assert_allclose(found, special.expit((1 - np.abs(behind)) / 0.05))
    assert np.all(found > 1e-4)


# The gate.


def test_a_sharp_gate_opens_at_once():
    excess = jnp.asarray([-np.inf, -1e-300, -0.0, 0.0, 1e-300, np.inf])
    found = beyond(Sharp(), excess, number(0.3), number(-0.8))
    np.testing.assert_array_equal(found, [-0.8, -0.8, 0.3, 0.3, 0.3, 0.3])
    # Nothing that is wrong with the other choice gets through.
    wrong = beyond(Sharp(), excess, number(0.3), number(np.nan))
    np.testing.assert_array_equal(wrong[2:], 0.3)


@pytest.mark.parametrize("width", [1e-9, 1e-3, 0.2, 5.0])
def test_a_smooth_gate_tends_to_the_sharp_one(width):
    excess = np.r_[np.linspace(-10.0, 10.0, 401), EXTREME]
    chosen, otherwise = number(0.3), number(-0.8)
    found = beyond(Smooth(gate=width), jnp.asarray(excess), chosen, otherwise)
    with np.errstate(over="ignore"):  # infinite, of which the share is zero or one
        share = special.expit(excess / width)
    # Two products of numbers below one.
    expected = 0.3 * share - 0.8 * (1.0 - share)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=4e-16)
    sharp = beyond(Sharp(), jnp.asarray(excess), chosen, otherwise)
    # exp(-40) of the difference between the two choices, and rounding.
    far = np.abs(excess) > 40.0 * width
    np.testing.assert_allclose(found[far], sharp[far], rtol=0.0, atol=4e-16)
    assert found[200] == pytest.approx(-0.25)  # at the gate: in the middle


def test_slope_at_the_gate_is_that_of_the_two_choices():
    for law, expected in ((Sharp(), 0.0), (Smooth(), 1.1 / (4 * 0.2))):
        slope = jax.grad(law.beyond)(number(0.0), number(0.3), number(-0.8))
        np.testing.assert_allclose(slope, expected, rtol=1e-15)


@pytest.mark.parametrize("field", ["command", "gate", "reversal"])
def test_widths_are_numbers_that_must_be_positive(field):
    assert field_metadata(Smooth(), field)["positive"]
    assert set(leaves_by_address(Smooth())) == {"command", "gate", "reversal"}
    assert set(leaves_by_address(SmoothReversals())) == {"reversal"}
    assert leaves_by_address(Sharp()) == {}


# Reversals.


def reversed_by(switching, signs, wanted, excess):
    given = (jnp.asarray(x, dtype=float) for x in (signs, wanted, excess))
    return jax.vmap(switching.reversed)(*given)


def test_a_sharp_reversal_is_at_once_and_has_no_derivative():
    excess = [-1e300, -1e-300, 0.0, 1e-300, 500.0, np.inf]
    found = reversed_by(Sharp(), [1.0] * 6, [-1.0] * 6, excess)
    np.testing.assert_array_equal(found, [1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    slope = jax.grad(Sharp().reversed, argnums=(0, 1, 2))
    assert slope(number(1.0), number(-1.0), number(5.0)) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("switching", [SmoothReversals(500.0), Smooth(reversal=500.0)])
def test_a_smooth_reversal_is_shared_out(switching):
    excess = np.array([-np.inf, -1.0, 0.0, 100.0, 250.0, 500.0, 1e300])
    share = np.array([0.0, 0.0, 0.0, 0.2, 0.5, 1.0, 1.0])
    for sign, wanted in ((1.0, -1.0), (-1.0, 1.0), (0.3, -1.0), (-1.0, -1.0)):
        found = reversed_by(switching, [sign] * 7, [wanted] * 7, excess)
        expected = (1.0 - share) * sign + share * wanted
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15)
        assert np.all(np.abs(found) <= 1.0)


def test_the_impulse_of_a_shared_reversal_moves_with_the_crossing():
    """That of a reversal one period after it, for a crossing at any time of a cycle; by
    the sharp law it stays, and jumps by a period."""
    moments = np.linspace(0.06, 4.96, 99)  # never a corner
    rate, cycles = 400.0, np.arange(10.0)

    def impulse(switching, crossing):
        sign, total = number(1.0), 0.0
        for time in cycles:
            excess = rate * (time - crossing)
            sign = switching.reversed(sign, number(-1.0), excess)
            total += sign
        return total

    smooth = jax.vmap(lambda t: impulse(SmoothReversals(rate), t))(jnp.asarray(moments))
    # One until a period after the crossing, and then minus one: of sums of ten.
    np.testing.assert_allclose(smooth, 2.0 * (moments + 1.0) - 10.0, atol=1e-13)
    slope = jax.vmap(jax.grad(lambda t: impulse(SmoothReversals(rate), t)))
    np.testing.assert_allclose(slope(jnp.asarray(moments)), 2.0, rtol=1e-13)
    sharp = jax.vmap(lambda t: impulse(Sharp(), t))(jnp.asarray(moments))
    # Half a period after it in the mean.
    np.testing.assert_allclose(sharp, 2.0 * np.floor(moments + 1.0) - 10.0, atol=1e-13)
    # At ninety-nine places of a staircase of five.
    assert np.mean(smooth - sharp) == pytest.approx(1.0, abs=0.05)


def test_limits_and_gate_beside_smooth_reversals_are_sharp():
    commands = jnp.asarray(COMMANDS)
    found = limited(SmoothReversals(), commands)
    np.testing.assert_array_equal(found, limited(Sharp(), commands))
    excess = jnp.asarray([-1.0, 0.0, 1.0])
    found = beyond(SmoothReversals(), excess, number(0.3), number(-0.8))
    np.testing.assert_array_equal(found, [-0.8, 0.3, 0.3])


# Laws.


def reference():
    """Some drag over energy, tracked from 4 m/s2 on."""
    drag = PolynomialProfile([20.0, -15.0], -5e6, -8e6)
    return DragReference(EnergyIndex(), drag, PolynomialProfile([0.5]), gate=4.0)


LAWS = {
    "state feedback": state_feedback,
    "observer": observer_law,
    "sampled state feedback": lambda r: Sampled(state_feedback(r), 1.0),
    "sampled observer": lambda r: Sampled(observer_law(r), 2.0),
}


def switchings(tree):
    is_one = lambda x: isinstance(x, AbstractSwitching)
    found = jax.tree.leaves(tree, is_leaf=is_one)
    return [x for x in found if is_one(x)]


@pytest.mark.parametrize("name", LAWS)
def test_switching_of_a_law_is_replaced_and_nothing_else(name):
    scenario = mars_scenario(LAWS[name](reference()))
    (before,) = switchings(scenario)
    assert isinstance(before, Sharp)
    smooth = smooth_switching(scenario)
    (after,) = switchings(smooth)
    assert eqx.tree_equal(after, Smooth())
    place = "guidance.law.switching" if "sampled" in name else "guidance.switching"
    leaves, others = leaves_by_address(smooth), leaves_by_address(scenario)
    new = {f"{place}.command": 0.05, f"{place}.gate": 0.2, f"{place}.reversal": 2e3}
    assert {a: leaves[a] for a in leaves if a not in others} == new
    assert all(leaves[a] is others[a] for a in others)
    assert switchings(scenario) == [before]  # as it was
    where = lambda s: s.guidance.law if "sampled" in name else s.guidance
    back = eqx.tree_at(lambda s: where(s).switching, smooth, before)
    assert eqx.tree_equal(back, scenario)


def test_widths_are_chosen_and_chosen_anew():
    scenario = mars_scenario(observer_law(reference()))
    wide = smooth_switching(scenario, Smooth(0.5, 3.0))
    assert eqx.tree_equal(wide.guidance.switching, Smooth(0.5, 3.0))
    assert eqx.tree_equal(smooth_switching(wide).guidance.switching, Smooth())


@pytest.mark.parametrize("law", [None, ConstantBank(0.5)])
def test_a_law_without_switching_is_refused(law):
    scenario = mars_scenario(law)
    name = type(scenario.guidance).__name__
    with pytest.raises(ValueError, match=f"{name} has no field .* AbstractSwitching"):
        smooth_switching(scenario)


def seen(state):
    planet, vehicle = mars_planet(), mars_vehicle()
    return measure(planet, vehicle, state, vehicle.trim_angle_of_attack)


@eqx.filter_jit
def of_gains(law, gains, state):
    """Cosine of the bank and its derivative with respect to the gains."""

    def cos_bank(gains):
        tuned = eqx.tree_at(lambda law: law.gains, law, gains)
        return tuned(jnp.zeros(()), seen(state), None)[0].cos_bank

    return eqx.filter_value_and_grad(cos_bank)(gains)


class Unlimited(AbstractSwitching):
    """Tells the command that a law would give."""

    shares_reversals = False

    def limited(self, command):
        return command

    def beyond(self, excess, chosen, otherwise):
        return chosen

    def reversed(self, sign, wanted, excess):
        return sign


def test_gains_of_a_law_that_is_clipped_have_a_gradient_with_smooth_switches():
    state = EntryState(35 * km, 0.0, 0.0, 4200.0, -9.8 * degree, 90 * degree)
    # Of which the sensed drag is 29 m/s2. Tracking 43 asks for a little too much lift.
    law = state_feedback(
        dataclasses.replace(reference(), drag=PolynomialProfile([43.08]))
    )

    def with_switching(switching):
        changed = eqx.tree_at(lambda law: law.switching, law, switching)
        return of_gains(changed, error_gains(), state)

    now = law.gains, law.reference, law.model, jnp.zeros(()), seen(state), None
    assert 1.1 < track(*now, Unlimited()).u < 1.2
    clipped, nothing = with_switching(Sharp())
    assert clipped == 1.0
    assert all(x == 0.0 for x in jax.tree.leaves(nothing))
    bent, gradient = with_switching(Smooth())
    # Two widths behind the limit: less than width * exp(-2) is left.
    assert 0.0 < clipped - bent < 0.05 * np.exp(-2.0)
    assert all(x != 0.0 and np.isfinite(x) for x in jax.tree.leaves(gradient))
    narrow, _ = with_switching(Smooth(1e-6, 1e-6))
    np.testing.assert_allclose(narrow, clipped, rtol=0.0, atol=1e-14)
