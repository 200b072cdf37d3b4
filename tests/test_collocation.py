"""Legendre-Gauss-Lobatto collocation, against closed forms and against numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import legendre

from jentry._collocation import interpolate, legendre_gauss_lobatto


DEGREES = [1, 2, 3, 7, 16, 30, 45]


@pytest.mark.parametrize("degree", DEGREES)
def test_nodes_and_weights(degree):
    """Ends and zeros of P', by numpy; the weights from (38) of no more than P."""
    made = legendre_gauss_lobatto(degree)
    of_degree = legendre.Legendre.basis(degree)
    inside = of_degree.deriv().roots() if degree > 1 else []
    expected = np.concatenate([[-1.0], np.sort(np.real(inside)), [1.0]])
    # The roots are eigenvalues: good to some roundings times the degree.
    np.testing.assert_allclose(made.nodes, expected, atol=1e-13)
    np.testing.assert_array_equal(made.nodes, -made.nodes[::-1])
    weights = 2.0 / (degree * (degree + 1.0) * of_degree(made.nodes) ** 2)
    np.testing.assert_allclose(made.weights, weights, rtol=1e-12)


@pytest.mark.parametrize("degree", DEGREES)
def test_exact_for_polynomials(degree):
    """The quadrature up to degree 2 N - 1, and not beyond; the derivatives up to N."""
    made = legendre_gauss_lobatto(degree)
    rng = np.random.default_rng(degree)
    whole = legendre.Legendre(rng.normal(size=2 * degree))
    assert made.weights @ whole(made.nodes) == pytest.approx(
        2.0 * whole.coef[0], abs=1e-13
    )
    square = legendre.Legendre.basis(degree)(made.nodes) ** 2
    exact = 2.0 / (2.0 * degree + 1.0)
    assert made.weights @ square == pytest.approx(2.0 / degree, rel=1e-12)
    assert abs(2.0 / degree - exact) > 1e-4
    curve = legendre.Legendre(rng.normal(size=degree + 1))
    values = curve(made.nodes)
    for matrix, order in ((made.first, 1), (made.second, 2)):
        expected = curve.deriv(order)(made.nodes)
        floor = np.finfo(float).eps * np.max(np.sum(np.abs(matrix), axis=1))
        bound = 10.0 * floor * np.max(np.abs(values))
        np.testing.assert_allclose(matrix @ values, expected, rtol=0.0, atol=bound)
        assert np.max(np.abs(np.sum(matrix, axis=1))) <= floor


def test_exponential_at_thirty():
    """To 1e-11, of the largest value: what the rounding of the values leaves of the
    second derivative at the ends is 7e-12."""
    made = legendre_gauss_lobatto(30)
    values = np.exp(made.nodes)
    for derivative in (made.first @ values, made.second @ values):
        assert np.max(np.abs(derivative - values)) < 1e-11 * np.e
    assert made.weights @ values == pytest.approx(np.e - 1.0 / np.e, rel=1e-15)
    anywhere = np.linspace(-1.0, 1.0, 401)
    curve = interpolate
    for order, bound in ((0, 2e-15), (1, 1e-12), (2, 1e-11)):
        at = jax.jit(jax.vmap(curve, (None, 0)))
        found = at(jnp.asarray(values), jnp.asarray(anywhere))
        np.testing.assert_allclose(
            found, np.exp(anywhere), rtol=0.0, atol=bound * np.e, err_msg=str(order)
        )
        curve = jax.grad(curve, argnums=1)


def test_interpolation_at_and_beside_the_nodes():
    """Values and slopes there, and as many digits a hair beside."""
    made = legendre_gauss_lobatto(12)
    curve = legendre.Legendre(np.random.default_rng(0).normal(size=13))
    values = jnp.asarray(curve(made.nodes))
    at = jax.jit(jax.vmap(jax.value_and_grad(interpolate, argnums=1), (None, 0)))
    for beside in (0.0, 1e-16, 1e-13, 1e-9):
        x = np.clip(made.nodes + beside, -1.0, 1.0)
        value, slope = at(values, jnp.asarray(x))
        np.testing.assert_allclose(value, curve(x), rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(slope, curve.deriv()(x), rtol=0.0, atol=1e-11)


def test_interpolation_is_linear_in_the_values():
    values = jnp.asarray(np.random.default_rng(1).normal(size=8))
    x = jnp.asarray(0.3)
    shares = jax.grad(interpolate)(values, x)
    assert interpolate(values, x) == pytest.approx(float(shares @ values), rel=1e-14)
    assert float(jnp.sum(shares)) == pytest.approx(1.0, rel=1e-14)
    both = jax.jacfwd(jax.grad(interpolate), argnums=1)(values, x)
    assert float(both @ values) == pytest.approx(
        float(jax.grad(interpolate, argnums=1)(values, x)), rel=1e-12
    )


def test_matrices_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        legendre_gauss_lobatto(4).first[0, 0] = 1.0


@pytest.mark.parametrize("degree", [0, -3])
def test_degree_that_is_none(degree):
    with pytest.raises(ValueError, match=f"degree is {degree}"):
        legendre_gauss_lobatto(degree)
