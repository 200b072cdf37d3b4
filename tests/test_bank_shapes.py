"""Bank shapes of the predictor-corrector, and the bounded steps that correct them."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from predictor_correctors import number
from scipy.optimize import lsq_linear

from jentry.guidance import (
    ConstantBankShape,
    LinearBankShape,
    PrescribedBankShape,
    TwoEndedBankShape,
)
from jentry.guidance.bounded_step import least_squares_step
from jentry.guidance.predictor_corrector import _End, _with_effects
from jentry.onboard import PolynomialProfile
from jentry.units import degree


# Shapes


def test_constant_bank_goes_from_the_largest_to_wings_level():
    shape = ConstantBankShape(lowest=math.cos(100 * degree))
    for share, cosine in ((0.0, math.cos(100 * degree)), (1.0, 1.0)):
        found = shape.cos_bank(jnp.array([share]), number(3.0), number(0.0))
        assert float(found) == pytest.approx(cosine, abs=1e-15)


def test_linear_bank_is_a_line_of_the_angle_over_the_index():
    shape = LinearBankShape(end=2.0, final=60 * degree, largest=80 * degree)
    # A quarter of the way to wings level: 60 degrees now at 10, and 60 at the end.
    level = shape.cos_bank(jnp.array([0.25]), number(6.0), number(10.0))
    assert float(level) == pytest.approx(math.cos(60 * degree), abs=1e-15)
    # 20 degrees now: half of the way at 6, and all of it at the end and beyond.
    numbers = jnp.array([0.75])
    for index, angle in ((12.0, 20), (10.0, 20), (6.0, 40), (2.0, 60), (1.0, 60)):
        found = shape.cos_bank(numbers, number(index), number(10.0))
        assert float(found) == pytest.approx(math.cos(angle * degree), abs=1e-15)
    at_end = shape.cos_bank(numbers, number(2.0), number(2.0))
    assert float(at_end) == pytest.approx(math.cos(60 * degree), abs=1e-15)


def test_both_ends_of_a_bank_are_free():
    shape = TwoEndedBankShape(
        end=2.0, final=60 * degree, largest=80 * degree, first=0.5
    )
    np.testing.assert_allclose(shape.numbers, [0.5, 0.25], rtol=1e-14)
    found = shape.cos_bank(jnp.array([0.75, 0.25]), number(6.0), number(10.0))
    assert float(found) == pytest.approx(math.cos(40 * degree), abs=1e-15)


@pytest.mark.parametrize(
    ("share", "cosine"), [(0.0, 0.6), (1.0, 1.0), (0.5, 0.8), (-1.0, -0.2), (-0.5, 0.2)]
)
def test_given_bank_is_moved_to_either_side(share, cosine):
    shape = PrescribedBankShape(PolynomialProfile([0.6]), lowest=-0.2)
    found = shape.cos_bank(jnp.array([share]), number(1.0), number(0.0))
    assert float(found) == pytest.approx(cosine, abs=1e-15)


# Steps


def test_step_of_two_numbers_is_the_best_between_its_bounds():
    rng = np.random.default_rng(5)
    stepped = jax.jit(least_squares_step)
    on_edge = 0
    for _ in range(200):
        misses_, effects = rng.normal(size=2), rng.normal(size=(2, 2))
        lower, upper = -rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, 1.0, 2)
        found = stepped(*(jnp.asarray(x) for x in (misses_, effects, lower, upper)))
        best = lsq_linear(effects, -misses_, (lower, upper), tol=1e-14)
        left = np.sum((misses_ + effects @ np.asarray(found)) ** 2)
        # Not above what scipy finds, but for the tolerance of its own search.
        assert left <= 2.0 * best.cost + 1e-9
        assert np.all(found >= lower) and np.all(found <= upper)
        on_edge += best.cost > 1e-12
    assert 50 < on_edge < 199


def test_step_of_one_number_is_newtons_within_its_bounds():
    effects = jnp.array([[2.0]])
    for miss, step in ((-0.4, 0.2), (-4.0, 0.3), (4.0, -0.1)):
        found = least_squares_step(
            jnp.array([miss]), effects, jnp.array([-0.1]), jnp.array([0.3])
        )
        assert float(found[0]) == pytest.approx(step, abs=1e-15)


def test_a_number_without_effect_stays_where_it_is_best():
    # The second number moves nothing: the first one does what can be done.
    found = least_squares_step(
        jnp.array([1.0, 0.0]),
        jnp.array([[2.0, 0.0], [0.0, 0.0]]),
        jnp.array([-1.0, -1.0]),
        jnp.array([1.0, 1.0]),
    )
    assert float(found[0]) == pytest.approx(-0.5, abs=1e-15)
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize("in_turn", [False, True])
@pytest.mark.parametrize("count", [1, 2])
def test_effects_are_how_each_number_changes_the_misses(count, in_turn):
    def missed(numbers):
        both = jnp.stack([numbers[0] ** 3, numbers[0] * numbers[-1] ** 2])
        end = _End(numbers[0] > 1.0, numbers[0] > 2.0)
        return both[:count], end

    numbers = jnp.array([1.5, -0.7])[:count]
    misses, effects, end = _with_effects(missed, numbers, in_turn)
    a, b = 1.5, -0.7
    known = np.array([[3.0 * a**2, 0.0], [b**2, 2.0 * a * b]])[:count, :count]
    np.testing.assert_allclose(effects, known, rtol=1e-14)
    np.testing.assert_allclose(misses, [a**3, a * b**2][:count], rtol=1e-14)
    assert bool(end.is_there) and not bool(end.skips)
