"""The Runge-Kutta method that flights and predictions share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import erfi

from jentry._integrate import runge_kutta, runge_kutta_step


def one(x):
    return jnp.asarray(x, dtype=float)


def test_steps_are_of_fourth_order_and_end_at_the_end():
    """y' = 1 - x y, from 0.3 at 0.2 to 1.7, whose solution has an error function."""

    def error(steps, start=0.2, end=1.7):
        y = runge_kutta(lambda x, y: 1.0 - x * y, start, end, one(0.3), steps)
        scaled = 0.3 * np.exp(0.5 * start**2)
        grown = np.sqrt(np.pi / 2) * (erfi(end / 2**0.5) - erfi(start / 2**0.5))
        return float(y) - (scaled + grown) * np.exp(-0.5 * end**2)

    ratios = [error(n) / error(2 * n) for n in (32, 64, 128)]
    np.testing.assert_allclose(ratios, 16.0, rtol=0.05)
    assert abs(error(256)) < 1e-10


def test_backwards_is_the_way_back():
    """Of y' = x, of which the method makes no error, with a pytree for y."""
    y = {"a": one(0.0), "b": (one(1.0),)}
    there = runge_kutta(lambda x, y: {"a": x, "b": (2.0 * x,)}, 1.0, 3.0, y, 3)
    assert float(there["a"]) == pytest.approx(4.0, rel=1e-15)
    assert float(there["b"][0]) == pytest.approx(9.0, rel=1e-15)
    back = runge_kutta(lambda x, y: {"a": x, "b": (2.0 * x,)}, 3.0, 1.0, there, 3)
    assert float(back["b"][0]) == pytest.approx(1.0, rel=1e-14)


def test_derivatives_forwards_and_backwards():
    """Of one step of y' = a y, a polynomial of fourth degree in a."""

    def stepped(a):
        return runge_kutta_step(lambda x, y: a * y, one(0.0), one(2.0), 0.5)

    a = one(0.8)
    z = 0.5 * 0.8
    exact = 2.0 * 0.5 * (1.0 + z + z**2 / 2.0 + z**3 / 6.0)
    second = 2.0 * 0.25 * (1.0 + z + z**2 / 2.0)
    for first in (jax.jacfwd(stepped), jax.grad(stepped)):
        assert float(first(a)) == pytest.approx(exact, rel=1e-13)
    assert float(jax.jacfwd(jax.grad(stepped))(a)) == pytest.approx(second, rel=1e-13)
