"""The ways to compute the gradient of a tuning run, and the warnings about it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cheap_tuning import ADDRESS, BEST, scenario, tuned
from helpers import with_leaf

from jentry.guidance import AbstractContinuousLaw
from jentry.motion import Controls
from jentry.tuning import (
    AutomaticDifferentiation,
    Bounds,
    CentralDifferences,
)
from jentry.units import degree


pytestmark = pytest.mark.optimized  # of few programs each flies thousands of flights


class Stepped(AbstractContinuousLaw[None]):
    """A bank angle (rad) of which half is rounded to milliradians, as jumps do it: its
    derivative is half of what it does."""

    bank_angle: jax.Array

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        rounded = jax.lax.stop_gradient(jnp.round(self.bank_angle * 1e3) / 1e3)
        bank_angle = 0.5 * (self.bank_angle + rounded)
        controls = 0.0 * bank_angle, jnp.cos(bank_angle), jnp.sin(bank_angle)
        return Controls(*controls), None


def stepped():
    law = Stepped(jnp.asarray(50 * degree))
    return eqx.tree_at(lambda s: s.guidance, scenario(), law)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_gradient_that_a_difference_contradicts_is_warned_of(tmp_path):
    record = tmp_path / "record.npz"
    with pytest.warns(UserWarning, match="a difference of the loss along it"):
        result = tuned(start=stepped(), steps=1, path=record)
    (entry,) = result.course
    # By the width of its differences: 35 steps, give or take one at each end.
    assert entry.difference == pytest.approx(2.0 * entry.gradient_norm, rel=0.05)
    assert len(result.remarks) == 1 and "difference" in result.remarks[0]
    # A run that is resumed knows it still, and does not warn again.
    again = tuned(start=stepped(), steps=1, path=record)
    assert again.remarks == result.remarks
    smooth = tuned(steps=1)
    first = smooth.course[0]
    # Of a third derivative, times the square of a step of 2 %.
    assert first.difference == pytest.approx(first.gradient_norm, rel=1e-2)
    assert smooth.remarks == ()


@pytest.mark.slow
def test_differences_see_the_jumps():
    """Twice the gradient that the derivatives have; and no one warns."""
    result = tuned(start=stepped(), gradient=CentralDifferences(), steps=25)
    exact = tuned(steps=1).course[0]
    first = result.course[0]
    # The law without steps, of which one more or less is in 35.
    assert first.gradient_norm == pytest.approx(exact.gradient_norm, rel=0.05)
    assert 0.0 < first.gradient_error < first.gradient_norm
    assert result.remarks == ()
    assert float(result.values[ADDRESS]) == pytest.approx(BEST, abs=0.01)


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_start_next_to_a_bound_is_warned_of():
    bounds = Bounds(50 * degree - 1e-5, 60 * degree)
    with pytest.warns(UserWarning, match="starts within 0.0057 % of one of its bounds"):
        result = tuned(ranges={ADDRESS: bounds}, steps=1)
    assert len(result.remarks) == 1


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_forward_and_reverse_take_the_same_steps():
    forward, reverse = (
        tuned("adam", steps=4, gradient=AutomaticDifferentiation(forward))
        for forward in (True, False)
    )
    losses = [[e.loss for e in r.course] for r in (forward, reverse)]
    np.testing.assert_allclose(*losses, rtol=1e-9)  # rounding, through four steps


def twice_as_far(scenario):
    """A surrogate that is not like the law at all: its gradient points elsewhere."""
    return with_leaf(
        scenario, lambda s: s.target.downrange, 2.0 * scenario.target.downrange
    )


@pytest.mark.optimized(False)
@pytest.mark.slow
def test_a_surrogate_is_followed_and_the_exact_law_judges():
    result = tuned(
        "adam", steps=8, gradient=AutomaticDifferentiation(surrogate=twice_as_far)
    )
    exact = tuned("adam", steps=8)
    assert result.course[0].loss == exact.course[0].loss
    assert result.course[0].gradient_norm != exact.course[0].gradient_norm
    losses = [entry.loss for entry in result.course]
    assert losses[result.best] == min(losses)
