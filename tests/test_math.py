"""Small numerical functions: accuracy, and gradients where they have a limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._math import (
    arccos,
    arcsin,
    derivatives_along,
    horner,
    root,
    safe_arccos,
    safe_sqrt,
    sincos,
)


def test_sincos_is_accurate_where_angles_lie():
    angles = np.concatenate(
        [np.linspace(-10.0, 10.0, 20001), np.arange(-8, 9) * np.pi / 4]
    )
    sine, cosine = jax.jit(jax.vmap(sincos))(angles)
    # Its own promise: a few roundings of numbers up to one (2.2e-16 each).
    np.testing.assert_allclose(sine, np.sin(angles), rtol=0.0, atol=2e-15)
    np.testing.assert_allclose(cosine, np.cos(angles), rtol=0.0, atol=2e-15)


@pytest.mark.optimized
def test_sincos_is_accurate_after_many_turns(key):
    """With little optimization JAX 0.11 does not fuse a product and a sum."""
    angles = 1e3 + np.asarray(jax.random.uniform(key, (2000,), minval=-5.0, maxval=5.0))
    sine, cosine = jax.jit(jax.vmap(sincos))(angles)
    # The same promise: two-part pi/2 reduces angles of a few thousand without loss.
    np.testing.assert_allclose(sine, np.sin(angles), rtol=0.0, atol=2e-15)
    np.testing.assert_allclose(cosine, np.cos(angles), rtol=0.0, atol=2e-15)


def test_sincos_lies_on_the_unit_circle():
    sine, cosine = jax.jit(jax.vmap(sincos))(jnp.linspace(-10.0, 10.0, 4001))
    # Two squares of numbers that are each good to a few roundings.
    np.testing.assert_allclose(sine**2 + cosine**2, 1.0, rtol=0.0, atol=4e-15)


@pytest.mark.parametrize(
    ("ours", "exact", "bound"), [(arcsin, np.arcsin, 5e-16), (arccos, np.arccos, 8e-16)]
)
@pytest.mark.optimized
def test_arcs_are_accurate(ours, exact, bound):
    """As users have it: products and sums are fused."""
    near = 10.0 ** np.linspace(-16.0, 0.0, 4001)
    x = np.concatenate([np.linspace(-1.0, 1.0, 40001), 1.0 - near, near - 1.0, near])
    x = np.concatenate([x, [0.0, 0.5, -0.5, np.nextafter(0.5, 1.0)]])
    angle = np.asarray(jax.jit(jax.vmap(ours))(x), np.longdouble)
    true = exact(x.astype(np.longdouble))
    assert np.max(np.abs(angle - true)) < bound
    # Small angles are not lost either.
    small = (np.abs(true) > 0.0) & (np.abs(true) < 1e-3)
    assert np.sum(small) > 100
    assert np.max(np.abs(angle / np.where(small, true, 1.0) - 1.0)[small]) < 8e-16


@pytest.mark.parametrize(("ours", "sign"), [(arcsin, 1.0), (arccos, -1.0)])
@pytest.mark.parametrize("x", [-0.9, -0.5, 0.0, 0.3, 0.999])
def test_derivatives_of_arcs(ours, sign, x):
    # The closed forms, to some roundings.
    first = sign / np.sqrt(1.0 - x**2)
    second = sign * x / (1.0 - x**2) ** 1.5
    x = jnp.asarray(x)
    assert jax.jvp(ours, (x,), (jnp.ones(()),))[1] == pytest.approx(first, rel=1e-14)
    assert jax.grad(ours)(x) == pytest.approx(first, rel=1e-14)
    found = jax.jacfwd(jax.grad(ours))(x)
    assert found == pytest.approx(second, rel=1e-13, abs=1e-16)


@pytest.mark.parametrize("ours", [arcsin, arccos])
@pytest.mark.parametrize("x", [np.nan, 1.0 + 1e-12, -2.0])
def test_arcs_of_what_has_none(ours, x):
    assert np.isnan(ours(jnp.asarray(x)))


@pytest.mark.parametrize("angle", [-3.0, 0.0, np.pi / 4, 1.5, 7.0])
def test_sincos_derivatives(angle):
    angle = jnp.asarray(angle)
    sine, cosine = sincos(angle)
    forward = jax.jacfwd(sincos)(angle)
    reverse = jax.jacrev(sincos)(angle)
    second = jax.jacfwd(jax.jacfwd(sincos))(angle)
    # The rule returns the computed cosine and -sine themselves: equal to the last bit.
    assert forward == (cosine, -sine)
    assert reverse == (cosine, -sine)
    assert second == (-sine, -cosine)


@pytest.mark.parametrize(
    ("function", "x", "value", "slope"),
    [
        (safe_sqrt, 4.0, 2.0, 0.25),
        (safe_sqrt, 0.0, 0.0, 0.0),
        (safe_sqrt, -1.0, 0.0, 0.0),
        (safe_arccos, 0.5, np.pi / 3, -1.0 / np.sqrt(0.75)),
        (safe_arccos, 1.0, 0.0, 0.0),
        (safe_arccos, -1.0, np.pi, 0.0),
        (safe_arccos, 1.5, 0.0, 0.0),
        (safe_arccos, -1.5, np.pi, 0.0),
    ],
)
def test_safe_functions_and_their_gradients_at_the_limits(function, x, value, slope):
    x = jnp.asarray(x)
    found, gradient = jax.value_and_grad(function)(x)
    # Rounding of one library call.
    np.testing.assert_allclose(found, value, rtol=1e-15)
    np.testing.assert_allclose(gradient, slope, rtol=1e-15)
    assert jax.jacfwd(function)(x) == gradient


def test_horner_takes_the_highest_power_first():
    # Small whole numbers: exact.
    assert horner([2.0, -3.0, 5.0], 4.0) == 2.0 * 16.0 - 3.0 * 4.0 + 5.0


def test_derivatives_along_a_flow():
    """A pendulum: of y = sin(angle) the derivatives follow by hand."""
    angle, rate = 0.7, -0.3

    def flow(point):
        return point[1], -jnp.sin(point[0])

    y, first, second = derivatives_along(flow, lambda p: jnp.sin(p[0]), (angle, rate))
    sine, cosine = np.sin(angle), np.cos(angle)
    # A handful of operations on numbers of order one.
    np.testing.assert_allclose(y, sine, rtol=1e-15)
    np.testing.assert_allclose(first, cosine * rate, rtol=1e-15)
    np.testing.assert_allclose(second, -sine * rate**2 - cosine * sine, rtol=1e-15)


def test_root_of_zero_has_no_slope_in_any_mode():
    """Also in a loop, where reverse mode linearizes what is already linearized."""

    def looped(x):
        body = lambda y, _: (root(y * y) + y**3, None)
        return jax.lax.scan(body, x, None, length=2)[0]

    modes = jax.jacfwd, jax.jacrev
    for function in (lambda x: root(x * x) + x**3, looped):
        for first in modes:
            assert jax.jit(first(function))(0.0) == 0.0
            for second in modes:
                assert jax.jit(second(first(function)))(0.0) == 0.0
    assert jnp.isnan(root(jnp.asarray(-1.0)))
    assert jnp.isnan(jax.grad(root)(-1.0))
    np.testing.assert_allclose(jax.grad(root)(4.0), 0.25)
    np.testing.assert_allclose(jax.grad(jax.grad(root))(4.0), -1.0 / 32.0)
