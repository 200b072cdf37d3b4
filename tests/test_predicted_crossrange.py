"""Bank reversals by the predicted crossrange."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_planet
from lateral_states import ORIGIN, TIME, seen
from scipy.optimize import brentq

from jentry.guidance import Destination, PredictedCrossrange
from jentry.guidance.lateral import PredictedPassage


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
    logic = PredictedCrossrange(factor=factor, predicts_reversals=True)
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
    logic = PredictedCrossrange(**changes, predicts_reversals=True)
    before = logic.init(seen(ORIGIN))
    side = logic.update(TIME, seen(ORIGIN), before, towards(kept, reversed_now))
    assert float(side.reversals) == 0.0
    assert float(logic.reverses_at(side)) == np.inf


def test_after_a_reversal_the_next_one_turns_back():
    """The two errors have changed their places."""
    logic = PredictedCrossrange(factor=3.0, predicts_reversals=True)
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
