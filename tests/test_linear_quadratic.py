"""Finite-horizon regulation: collocation, Riccati's equation and closed forms."""

import functools
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jentry._collocation import interpolate
from jentry._linear_solve import solve_dense
from jentry.onboard.linear_quadratic import (
    Weights,
    collocated_plan,
    cost_to_go,
    riccati_cost_to_go,
)


END = 3.0
SPLIT = 1.3


def weights(n, m, final=4.0):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    control = np.diag(1.0 + np.arange(m)) + 0.2 * np.ones((m, m))
    return Weights(
        jnp.asarray(root @ root.T), jnp.asarray(control), jnp.asarray(final * np.eye(n))
    )


def smooth(n, m):
    """Smoothly time-varying, of which some modes are unstable."""
    rng = np.random.default_rng(10 * n + m)
    a, da = rng.normal(size=(2, n, n))
    b, db = rng.normal(size=(2, n, m))

    def system(part, t):
        wave = jnp.sin(1.3 * t)
        return jnp.asarray(a + 0.5 * da * wave), jnp.asarray(b + 0.5 * db * wave**2)

    return system


def jumping(n, m, split=True):
    before, after = smooth(n, m), smooth(n, m)

    def system(part, t):
        a, b = before(0, t)
        a2, b2 = after(0, t + 1.0)
        late = (part == 1) if split else (t >= SPLIT)
        return jnp.where(late, a2, a), jnp.where(late, b2, b)

    return system


def by_scipy(system, w, ends):
    """Riccati's equation once more, by scipy, each part with its own side of a jump."""
    q, r, s = (np.asarray(x) for x in (w.states, w.controls, w.final))
    n = len(q)
    system = jax.jit(system)
    for part in reversed(range(len(ends) - 1)):
        start, end = map(float, ends[part : part + 2])

        def slope(t, y, part=part):
            a, b = map(np.asarray, system(part, t))
            s = y.reshape(n, n)
            push = s @ b @ np.linalg.solve(r, b.T @ s)
            return -(a.T @ s + s @ a - push + q).ravel()

        span = (end, start)
        s = solve_ivp(slope, span, s.ravel(), "DOP853", rtol=1e-11, atol=1e-11).y
        s = s[:, -1].reshape(n, n)
    return s


@pytest.mark.parametrize(("n", "m"), [(1, 1), (3, 1), (4, 2)])
def test_three_ways(n, m):
    """The bar is 1e-6; the collocation of a smooth system is at the others' tolerance."""
    system, w, ends = smooth(n, m), weights(n, m), jnp.array([0.0, END])
    expected = by_scipy(system, w, ends)
    size = np.max(np.abs(expected))
    for found in (
        cost_to_go(system, w, ends, 40),
        riccati_cost_to_go(system, w, ends),
    ):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8 * size)
    gain = w.gain(cost_to_go(system, w, ends, 40), system(0, 0.0)[1])
    b = np.asarray(system(0, 0.0)[1])
    np.testing.assert_allclose(
        gain, np.linalg.solve(np.asarray(w.controls), b.T @ expected), rtol=1e-6
    )


def test_closed_form():
    """dx/dt = a x + b u: S by its roots, Bryson and Ho."""
    a, b, q, r, final = 0.4, 1.5, 2.0, 0.5, 3.0
    w = Weights(jnp.array([[q]]), jnp.array([[r]]), jnp.array([[final]]))
    found = cost_to_go(
        lambda part, t: (jnp.array([[a]]), jnp.array([[b]])),
        w,
        jnp.array([0.0, END]),
        30,
    )
    f = b * b / r
    root = np.sqrt(a * a + f * q)
    high, low = (a + root) / f, (a - root) / f
    share = (final - high) / (final - low) * np.exp(-2.0 * root * END)
    assert float(found[0, 0]) == pytest.approx(
        (high - low * share) / (1 - share), 1e-12
    )


@pytest.mark.parametrize("n", [2, 3])
def test_split_at_a_jump(n):
    system, w = jumping(n, 1), weights(n, 1)
    ends = jnp.array([0.0, SPLIT, END])
    expected = by_scipy(system, w, ends)
    size = np.max(np.abs(expected))
    for found in (
        cost_to_go(system, w, ends, 30),
        riccati_cost_to_go(system, w, ends),
        # Shorter parts, lower degrees; one of no length.
        cost_to_go(
            lambda part, t: system(jnp.where(part > 2, 1, 0), t),
            w,
            jnp.array([0.0, 0.4, 0.4, SPLIT, 1.8, 2.4, END]),
            14,
        ),
    ):
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-8 * size)
    # Without the split the polynomials go across the jump, and are not good for much.
    across = cost_to_go(jumping(n, 1, split=False), w, jnp.array([0.0, END]), 30)
    assert np.max(np.abs(across - expected)) > 1e-5 * size


def test_plan_is_the_optimal_motion():
    """States and costates obey (31) anywhere, and the ends are those given."""
    system, w, degree = smooth(3, 1), weights(3, 1), 45
    made = collocated_plan(functools.partial(system, 0), w, 0.0, END, degree)
    np.testing.assert_array_equal(made.states[0], np.eye(3))
    np.testing.assert_allclose(
        made.costates[-1], w.final @ made.states[-1], rtol=1e-12, atol=1e-14
    )

    def column(values, t):
        """Of the polynomials through the nodes, with its rate (1/s)."""
        x = jnp.asarray(2.0 * t / END - 1.0)
        rates = jax.jvp(
            interpolate, (values, x), (0.0 * values, jnp.asarray(2.0 / END))
        )
        return jnp.stack(rates)

    every = jax.jit(jax.vmap(jax.vmap(column, (1, None), 1), (2, None), 2))
    for t in np.linspace(0.0, END, 23):  # between the nodes, and at both ends
        a, b = map(np.asarray, system(0, t))
        (x, x_rate), (c, c_rate) = (
            np.asarray(every(part, t)) for part in (made.states, made.costates)
        )
        push = b @ np.linalg.solve(np.asarray(w.controls), b.T @ c)
        np.testing.assert_allclose(x_rate, a @ x - push, rtol=0.0, atol=1e-7)
        costs = -np.asarray(w.states) @ x - a.T @ c
        np.testing.assert_allclose(c_rate, costs, rtol=0.0, atol=1e-6)
    # What is commanded is -R^-1 B' of the costates.
    b = np.stack([np.asarray(system(0, t)[1]) for t in np.linspace(0.0, END, 2)])
    for k, place in enumerate((0, -1)):
        np.testing.assert_allclose(
            made.controls[place],
            -np.linalg.solve(
                np.asarray(w.controls), b[k].T @ np.asarray(made.costates[place])
            ),
            rtol=1e-10,
            atol=1e-12,
        )
    # The cost to go is symmetric, and positive.
    s = np.asarray(made.costates[0])
    np.testing.assert_allclose(s, s.T, rtol=1e-8)
    assert np.all(np.linalg.eigvalsh(0.5 * (s + s.T)) > 0.0)


def test_derivative_in_the_weights_and_batches():
    """What tuning needs; against central differences."""
    system, ends = smooth(2, 1), jnp.array([0.0, END])

    def cost(log_r):
        w = weights(2, 1)
        w = Weights(w.states, jnp.exp(log_r)[None, None], w.final)
        return cost_to_go(system, w, ends, 24)[0, 1]

    at = jnp.asarray(0.3)
    differences = (cost(at + 1e-5) - cost(at - 1e-5)) / 2e-5
    for mode in (jax.grad, jax.jacfwd):
        assert float(mode(cost)(at)) == pytest.approx(float(differences), rel=1e-6)
    many = jax.jit(jax.vmap(cost))(jnp.array([0.1, 0.3, 0.9]))
    assert float(many[1]) == pytest.approx(float(cost(at)), rel=1e-10)


def test_weights_that_are_none():
    eye = jnp.eye(3)
    with pytest.raises(ValueError, match="states has shape .3, 2."):
        Weights(jnp.ones((3, 2)), jnp.eye(1), eye)
    with pytest.raises(
        ValueError, match=r"states has shape \(3, 3\) and final \(2, 2\)"
    ):
        Weights(eye, jnp.eye(1), jnp.eye(2))
    with pytest.raises(ValueError, match="a horizon has a start and an end"):
        cost_to_go(smooth(3, 1), weights(3, 1), jnp.zeros(1))


_ON_TWO_DEVICES = """
import jentry

jentry.setup(workers=2)

import jax
import jax.numpy as jnp
from jentry._linear_solve import solve_dense
from jentry.campaign.batch import over_runs


def again_and_again(shared, run):
    matrix = shared + jnp.diag(jnp.sin(run + jnp.arange(60.0)))

    def once(x, _):
        right = jnp.ones((60, 3)) + x
        return jnp.tanh(solve_dense(matrix + x * 1e-3, right)[0, 0]), None

    return jax.lax.scan(once, 0.0 * run, length=50)[0]


matrix = 60.0 * jnp.eye(60) + jnp.outer(jnp.arange(60.0), jnp.ones(60))
print(len(jax.devices()), over_runs(again_and_again, matrix, jnp.arange(256.0)).shape)
"""


@pytest.mark.slow
def test_a_batch_on_two_devices_ends():
    """LAPACK, given a batch in a program on two devices, waits for ever."""
    call = [sys.executable, "-c", _ON_TWO_DEVICES]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120)
    assert done.stdout.split("\n")[0] == "2 (256,)", done.stderr


def test_dense_solution_and_its_derivatives():
    """One system and batches of them, forward and reverse, against numpy's inverse."""
    rng = np.random.default_rng(1)
    matrices = rng.normal(size=(3, 4, 4)) + 4.0 * np.eye(4)
    rights, changes = rng.normal(size=(3, 4, 2)), rng.normal(size=(3, 4, 4))
    inverse = np.linalg.inv(matrices)
    many = jax.vmap(solve_dense)
    given = jnp.asarray(matrices), jnp.asarray(rights)
    np.testing.assert_allclose(many(*given), inverse @ rights, rtol=1e-12)
    _, moved = jax.jvp(lambda m: many(m, given[1]), given[:1], (jnp.asarray(changes),))
    expected = -inverse @ changes @ inverse @ rights
    np.testing.assert_allclose(moved, expected, rtol=1e-11)
    slope = jax.grad(lambda m: jnp.sum(many(m, given[1]) ** 2))(given[0])
    pulled = np.swapaxes(inverse, 1, 2) @ (2.0 * inverse @ rights)
    expected = -pulled @ np.swapaxes(inverse @ rights, 1, 2)
    np.testing.assert_allclose(slope, expected, rtol=1e-10)
