"""Profiles over their index, on and beyond their grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.onboard import PolynomialProfile, quintic_profile


def test_a_polynomial_has_the_lowest_power_first_over_origin_and_span():
    profile = PolynomialProfile([0.6, -0.2, 0.05, 0.3], 500.0, -250.0)
    polynomial = np.polynomial.Polynomial([0.6, -0.2, 0.05, 0.3])
    for index in (400.0, 500.0, 1125.0):
        z = (index - 500.0) / -250.0
        expected = [polynomial.deriv(n)(z) / (-250.0) ** n for n in range(3)]
        found = profile.with_derivatives(jnp.asarray(index))
        # Rounding.
        np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-18)
        assert float(profile(jnp.asarray(index))) == float(found[0])


@pytest.mark.parametrize("spacing", [0.25, -0.25])
def test_a_quintic_goes_on_as_a_parabola_on_both_sides(spacing):
    """Also where the index falls along the grid."""
    start = jnp.asarray(1.0)
    nodes = start + spacing * jnp.arange(9)
    value, first, second = jnp.sin(nodes), jnp.cos(nodes), -jnp.sin(nodes)
    profile = quintic_profile(start, jnp.asarray(spacing), value, first, second)
    found = jax.jit(lambda index: profile.with_derivatives(index))
    for node, outwards in ((0, -np.sign(spacing)), (8, np.sign(spacing))):
        for far in (0.1, 3.0):
            d = far * outwards
            at = float(nodes[node])
            y, y1, y2 = np.sin(at), np.cos(at), -np.sin(at)
            expected = [y + d * y1 + 0.5 * d * d * y2, y1 + d * y2, y2]
            # Rounding over the square of the spacing.
            np.testing.assert_allclose(
                found(jnp.asarray(at + d)), expected, rtol=1e-11, atol=1e-12
            )
