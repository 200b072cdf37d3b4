"""Profiles over their index, on and beyond their grid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.onboard import PolynomialProfile, grid, quintic_profile, quintic_table
from jentry.onboard.profiles import _quintic


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


def exact(nodes):
    """An exponential that grows by e^8 along the nodes, and a sine."""
    rising = jnp.exp(4.0 * (nodes - 1.0))
    return {
        "rising": (rising, 4.0 * rising, 16.0 * rising),
        "wave": (jnp.sin(nodes), jnp.cos(nodes), -jnp.sin(nodes)),
    }


@pytest.mark.slow
@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize(("start", "end"), [(1.0, 3.0), (3.0, 1.0)])
def test_a_table_has_its_quantities_at_its_nodes_and_between(start, end, power):
    nodes = grid(jnp.asarray(start), jnp.asarray(end), 40, power)
    shares = (np.arange(41) / 40) ** power
    np.testing.assert_allclose(nodes, start + (end - start) * shares, rtol=1e-15)
    table = quintic_table(nodes, exact(nodes), power)
    read = jax.jit(jax.vmap(table.with_derivatives))
    between = 0.5 * (nodes[1:] + nodes[:-1])
    # At the nodes rounding over the square of the shortest interval, which is 2 / 1600.
    # Between them h^6 / 46080 of the sixth derivative for an h of 0.1, and for each
    # derivative about a ten over h more.
    for place, bounds in ((nodes, (1e-14, 1e-11, 1e-8)), (between, (1e-6, 1e-5, 1e-3))):
        found = read(place)
        for name, values in exact(place).items():
            for one, other, bound in zip(found[name], values, bounds, strict=True):
                close = bound * np.max(np.abs(other))
                np.testing.assert_allclose(one, other, rtol=0, atol=close)
        alone = jax.jit(jax.vmap(table.profile("wave").with_derivatives))(place)
        np.testing.assert_allclose(alone, found["wave"], rtol=0, atol=1e-12)


def test_short_intervals_at_first_serve_what_is_steep_there():
    @jax.jit
    def errors():
        found = []
        for power in (1, 2):
            nodes = grid(jnp.asarray(0.0), jnp.asarray(1.0), 20, power)
            y = jnp.exp(-30.0 * nodes)
            table = quintic_table(nodes, {"y": (y, -30.0 * y, 900.0 * y)}, power)
            x = jnp.linspace(0.0, 1.0, 2001)
            read = jax.vmap(table.with_derivatives)(x)["y"][0]
            found.append(jnp.max(jnp.abs(read - jnp.exp(-30.0 * x))))
        return found

    even, short = errors()
    assert short < 0.1 * even


def test_a_table_with_short_intervals_goes_on_as_a_parabola_on_both_sides():
    nodes = grid(jnp.asarray(0.0), jnp.asarray(2.0), 8, 2)
    table = quintic_table(nodes, exact(nodes), 2)
    for end, beyond in ((0.0, -0.01), (2.0, 0.3)):
        found = table.with_derivatives(jnp.asarray(end + beyond))["wave"]
        y, y1, y2 = np.sin(end), np.cos(end), -np.sin(end)
        expected = [y + beyond * y1 + 0.5 * beyond**2 * y2, y1 + beyond * y2, y2]
        # Rounding over the square of an interval of 1/32.
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)


def test_a_table_refuses_another_power_and_an_unknown_name():
    nodes = grid(jnp.asarray(0.0), jnp.asarray(2.0), 8)
    table = quintic_table(nodes, exact(nodes))
    with pytest.raises(ValueError, match="power is 3: it must be one of"):
        quintic_table(nodes, exact(nodes), 3)
    with pytest.raises(ValueError, match="no 'drag' in the table: it has rising, wave"):
        table.profile("drag")


def test_derivatives_of_a_quintic_over_all_that_it_is_made_of():
    """By numpy's polynomials: to the place up to the second order, to a coefficient, and
    of both, forward and reverse."""
    c, x = np.array([0.7, -1.1, 0.4, 2.0, -0.3, 1.5]), 0.6
    polynomial = np.polynomial.Polynomial(c[::-1])
    values = [polynomial.deriv(k)(x) if k else polynomial(x) for k in range(5)]
    factors = np.array([[1.0] * 6, [5, 4, 3, 2, 1, 0], [20, 12, 6, 2, 0, 0]])
    powers = factors * [
        [x ** (k - n) if k >= n else 0.0 for k in range(5, -1, -1)] for n in range(3)
    ]

    def read(x, c):
        return jnp.stack(_quintic(x, *c))

    at = jnp.asarray(x), jnp.asarray(c)
    for derivative in (jax.jacfwd, jax.jacrev):
        over_x, over_c = jax.jit(derivative(read, argnums=(0, 1)))(*at)
        np.testing.assert_allclose(over_x, values[1:4], rtol=1e-14)
        np.testing.assert_allclose(over_c, powers, rtol=1e-14)
    twice, mixed = jax.jit(jax.jacfwd(jax.jacrev(read), argnums=(0, 1)))(*at)
    np.testing.assert_allclose(twice, values[2:5], rtol=1e-14)
    np.testing.assert_allclose(mixed[:2], powers[1:], rtol=1e-14)
