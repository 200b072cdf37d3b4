"""Derivatives of any order and mode of the loop over cycles."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jentry.flight.loop import while_running, while_running_with_history


CYCLES = 12
"""At most; the loops below stop after seven to nine of them"""


class Toy(eqx.Module):
    """A carry with a number, a vector, a count and a flag."""

    x: jax.Array
    vector: jax.Array
    count: jax.Array
    running: jax.Array


def toy_cycle(parameters, carry):
    rate, matrix = parameters
    x = carry.x * (1.0 + rate * jnp.cos(carry.vector[0]))
    vector = jnp.tanh(matrix @ carry.vector) + 0.1 * rate**2 * carry.x
    after = Toy(x, vector, carry.count + 1, x < 5.0)
    return jax.tree.map(lambda a, b: jnp.where(carry.running, a, b), after, carry)


def toy_start(z):
    """Parameters and first carry from five numbers."""
    matrix = jnp.stack([z[:2], z[1:3]])
    carry = Toy(z[3], z[2:4] * z[4], jnp.asarray(0), jnp.asarray(True))
    return (z[4], matrix), carry


def toy(z):
    carry = while_running(toy_cycle, lambda c: c.running, *toy_start(z), CYCLES)
    return jnp.stack([carry.x, *carry.vector])


def toy_with_history(z, every=1):
    last, path = while_running_with_history(
        toy_cycle, lambda c: c.running, *toy_start(z), CYCLES, every
    )
    return of_history(last, path)


def toy_begin(parameters, carry):
    """The first half of a cycle; of zeros, as behind the end, it has no derivative."""
    rate, _ = parameters
    vector = carry.vector + jnp.array([0.2, -0.3]) * rate * jnp.sqrt(carry.x)
    begun = eqx.tree_at(lambda c: (c.vector, c.count), carry, (vector, carry.count + 7))
    return jax.tree.map(lambda a, b: jnp.where(carry.running, a, b), begun, carry)


def toy_begun(z, every=1):
    last, path = while_running_with_history(
        toy_cycle, lambda c: c.running, *toy_start(z), CYCLES, every, toy_begin
    )
    return of_history(last, path)


def of_history(last, path):
    x = jnp.where(path.running, path.x, 0.0)
    return jnp.stack([last.x, jnp.sum(x**2), jnp.sum(x * path.vector[:, 1])])


def scanned(z):
    """The same by `lax.scan`, which JAX differentiates itself."""
    parameters, carry = toy_start(z)
    cycle = lambda carry, _: (toy_cycle(parameters, carry), None)
    carry, _ = lax.scan(cycle, carry, length=CYCLES)
    return jnp.stack([carry.x, *carry.vector])


def scanned_with_history(z, every=1):
    parameters, carry = toy_start(z)
    cycle = lambda carry, _: (toy_cycle(parameters, carry), carry)
    last, path = lax.scan(cycle, carry, length=CYCLES)
    return of_history(last, jax.tree.map(lambda x: x[::every], path))


def scanned_begun(z, every=1):
    parameters, carry = toy_start(z)

    def cycle(carry, _):
        begun = toy_begin(parameters, carry)
        return toy_cycle(parameters, begun), begun

    last, path = lax.scan(cycle, carry, length=CYCLES)
    return of_history(last, jax.tree.map(lambda x: x[::every], path))


Z = jnp.array([0.8, 0.3, -0.5, 0.6, 0.35])
MODES = {"forward": jax.jacfwd, "reverse": jax.jacrev}
LOOPS = {
    "end": (toy, scanned),
    "history": (toy_with_history, scanned_with_history),
    "every third": (
        lambda z: toy_with_history(z, 3),
        lambda z: scanned_with_history(z, 3),
    ),
    "begun": (toy_begun, scanned_begun),
    "every second begun": (
        lambda z: toy_begun(z, 2),
        lambda z: scanned_begun(z, 2),
    ),
}


@pytest.mark.parametrize("every", [1, 2, 3, 5, CYCLES, CYCLES + 1])
def test_starts_of_some_cycles(every):
    """The same entries, as far as the loop went, and the same end."""
    last, path = while_running_with_history(
        toy_cycle, lambda c: c.running, *toy_start(Z), CYCLES
    )
    again, some = while_running_with_history(
        toy_cycle, lambda c: c.running, *toy_start(Z), CYCLES, every
    )
    assert eqx.tree_equal(again, last)
    assert len(some.x) == -(-CYCLES // every)
    whole = jax.tree.map(lambda x: x[::every], path)
    assert eqx.tree_equal(some, whole)
    first = jax.jacfwd(lambda z: toy_with_history(z, every))(Z)
    truth = jax.jacfwd(lambda z: scanned_with_history(z, every))(Z)
    np.testing.assert_allclose(first, truth, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("every", [1, 2, 5, CYCLES + 1])
@pytest.mark.parametrize("mode", MODES)
def test_what_cycles_begin_with(mode, every):
    """Kept as their first part leaves it, flown once, with derivatives."""

    def both(f):
        return jax.jit(lambda z: (f(z, every), MODES[mode](f)(z, every)))(Z)

    for ours, truth in zip(both(toy_begun), both(scanned_begun), strict=True):
        np.testing.assert_allclose(ours, truth, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("begin", [None, toy_begin])
def test_counts_and_flags_of_what_cycles_begin_with(begin):
    """They are the same whether somebody differentiates or not."""

    def counted(z):
        _, path = while_running_with_history(
            toy_cycle, lambda c: c.running, *toy_start(z), CYCLES, 2, begin
        )
        return path.x, (path.count, path.running)

    _, flown = counted(Z)
    _, _, linearized = jax.jvp(counted, (Z,), (jnp.ones(5),), has_aux=True)
    assert int(flown[0][2]) == (4 if begin is None else 5 * 7 + 4)
    assert eqx.tree_equal(flown, linearized)


@pytest.mark.parametrize("every", [2, 3, 4])
def test_no_more_cycles_than_asked_for(every):
    """Where it is that number that stops the loop, and no multiple of `every`."""
    loop = while_running_with_history
    runs = lambda c: c.running
    last, path = loop(toy_cycle, runs, *toy_start(Z), 5)
    again, some = loop(toy_cycle, runs, *toy_start(Z), 5, every)
    assert bool(last.running) and int(last.count) == 5
    assert eqx.tree_equal(again, last)
    assert eqx.tree_equal(some, jax.tree.map(lambda x: x[::every], path))


def test_the_toy_stops_within_its_cycles():
    _, path = while_running_with_history(
        toy_cycle, lambda c: c.running, *toy_start(Z), CYCLES
    )
    assert 7 <= int(path.running.sum()) <= 9


@functools.cache
def hessian_of_scan(loop):
    """By JAX alone, compiled once for all orders of the modes."""
    _, truth = LOOPS[loop]
    return jax.jit(jax.jacfwd(jax.jacfwd(truth)))


@pytest.mark.slow
@pytest.mark.parametrize("outer", MODES)
@pytest.mark.parametrize("inner", MODES)
@pytest.mark.parametrize("loop", LOOPS)
def test_second_derivatives_of_the_loop(loop, inner, outer):
    ours, _ = LOOPS[loop]
    found = jax.jit(MODES[outer](MODES[inner](ours)))(Z)
    # Rounding of a dozen cycles, relative to the largest.
    expected = hessian_of_scan(loop)(Z)
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=1e-13 * np.abs(expected).max()
    )


@pytest.mark.slow
def test_third_derivatives_of_the_loop():
    expected = jax.jit(jax.jacfwd(jax.jacfwd(jax.jacfwd(scanned))))(Z)
    found = jax.jit(jax.jacfwd(jax.jacrev(jax.jacfwd(toy))))(Z)
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=1e-13 * np.abs(expected).max()
    )


@pytest.mark.slow
def test_second_derivatives_of_a_batch_of_loops():
    """Loops that stop after different numbers of cycles, side by side."""
    batch = Z[None] + jnp.outer(
        jnp.linspace(-0.05, 0.05, 5), jnp.array([1, -1, 1, 1, 2.0])
    )
    found = jax.jit(jax.vmap(jax.jacfwd(jax.jacrev(toy))))(batch)
    expected = np.stack([hessian_of_scan("end")(z) for z in batch])
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=1e-13 * np.abs(expected).max()
    )


def test_an_iterated_directional_derivative_is_not_zero():
    """`jvp` of `jvp`, which used to be zero without a word."""
    tangent = jnp.arange(1.0, 6.0) / 5.0

    def twice(f):
        once = lambda z: jax.jvp(f, (z,), (tangent,))[1]
        return jax.jit(lambda z: jax.jvp(once, (z,), (tangent,))[1])(Z)

    ours, truth = twice(toy), twice(scanned)
    np.testing.assert_allclose(ours, truth, rtol=1e-12)
    assert np.abs(truth).min() > 1e-3
