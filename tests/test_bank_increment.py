"""The increment that an angle-of-attack law adds to the bank."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from composed_laws import Asking, at_start, steady

from jentry.guidance import BankLimits, FixedSide, compose
from jentry.guidance.composition import _banked_more
from jentry.units import degree


@pytest.mark.parametrize("largest", [80.0, 180.0])
@pytest.mark.parametrize("increment", [-30.0, -1.0, 0.0, 5.0, 30.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_increment_changes_the_magnitude_and_keeps_the_side(side, increment, largest):
    angles = jnp.asarray([0.0, 1.0, 20.0, 65.0, 90.0, 150.0, 180.0]) * degree
    limits = jnp.asarray(increment * degree), jnp.asarray(largest * degree)
    given = jnp.cos(angles), side * jnp.sqrt(1.0 - jnp.cos(angles) ** 2)
    change = jax.jit(jax.vmap(_banked_more, in_axes=(0, 0, None, None)))
    cosine, sine = change(*given, *limits)
    wanted = np.clip(angles + increment * degree, 0.0, largest * degree)
    # Where the bank is level, an arc cosine has half of the digits.
    np.testing.assert_allclose(cosine, np.cos(wanted), atol=1e-8)
    np.testing.assert_allclose(sine, side * np.sin(wanted), atol=1e-8)


def test_increment_of_a_shared_reversal_keeps_its_share():
    cosine, sine = _banked_more(
        *map(jnp.asarray, (0.5, -0.3 * np.sqrt(0.75), 0.2, np.pi))
    )
    np.testing.assert_allclose(cosine, np.cos(np.pi / 3 + 0.2), rtol=1e-14)
    np.testing.assert_allclose(sine, -0.3 * np.sin(np.pi / 3 + 0.2), rtol=1e-14)


@pytest.mark.parametrize("asked", [-40.0, -5.0, 0.0, 7.0, 40.0])
@pytest.mark.parametrize("left", [False, True])
def test_increment_is_limited_and_then_the_bank(asked, left):
    side = -1.0 if left else 1.0
    bank = steady(np.cos(np.radians(70.0)), lateral=FixedSide(left))
    limits = BankLimits(12 * degree, 80 * degree)
    found = at_start(compose(Asking(asked * degree), bank, limits))
    wanted = min(70.0 + np.clip(asked, -12.0, 12.0), 80.0)
    assert float(found.bank_angle) / degree == pytest.approx(side * wanted, abs=1e-9)
    assert float(found.angle_of_attack) == 0.1


def test_a_level_bank_is_increased_to_the_side_of_its_law():
    for left, side in ((False, 1.0), (True, -1.0)):
        law = compose(Asking(0.2), steady(1.5, lateral=FixedSide(left)))
        assert float(at_start(law).bank_angle) == pytest.approx(side * 0.2, rel=1e-14)


def test_by_default_nothing_limits_the_increment():
    found = at_start(compose(Asking(2.5), steady(0.0)))
    assert float(found.bank_angle) == pytest.approx(np.pi)
    found = at_start(compose(Asking(1.2), steady(0.0)))
    assert float(found.bank_angle) == pytest.approx(0.5 * np.pi + 1.2, rel=1e-14)
