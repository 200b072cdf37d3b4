"""A linear system solved by functions of its own and differentiated by its equations."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._linear_solve import linear_solve


def matrix(p):
    a, b = p["a"], p["b"]
    return jnp.stack(
        [
            jnp.stack([2.0 + a * a, b, 0.3 * a]),
            jnp.stack([jnp.sin(b), 3.0 + a, a * b]),
            jnp.stack([0.1 * b * b, -a, 4.0 + jnp.cos(a)]),
        ]
    )


def numpy_matrix(a, b):
    return np.array(
        [
            [2.0 + a * a, b, 0.3 * a],
            [np.sin(b), 3.0 + a, a * b],
            [0.1 * b * b, -a, 4.0 + np.cos(a)],
        ]
    )


@pytest.fixture
def solved():
    """Solution of the system, and how often each of its functions was traced."""
    calls = {"equations": 0, "solve": 0, "transpose_solve": 0}

    # x in two leaves of other shapes, as the parts of a flight are.
    def joined(x):
        return jnp.concatenate([x["first"], x["rest"][None]])

    def parted(x):
        return {"first": x[:2], "rest": x[2]}

    def equations(p, x):
        calls["equations"] += 1
        return parted(matrix(p) @ joined(x))

    # Neither is differentiated: what stands here need not have a derivative.
    def solve(p, b):
        calls["solve"] += 1
        return parted(jax.lax.stop_gradient(jnp.linalg.solve(matrix(p), joined(b))))

    def transpose_solve(p, b):
        calls["transpose_solve"] += 1
        found = jnp.linalg.solve(matrix(p).T, joined(b))
        return parted(jax.lax.stop_gradient(found))

    def x_of(p, b):
        return joined(linear_solve(equations, solve, transpose_solve, p, parted(b)))

    return x_of, calls


PLACES = {"a": 0.7, "b": -0.4}
RIGHT = np.array([1.0, -2.0, 0.5])


def places(*values):
    return dict(zip("ab", map(jnp.asarray, values), strict=True))


def solution(a, b, right=RIGHT):
    return np.linalg.solve(numpy_matrix(a, b), right)


def test_the_solution(solved):
    x_of, _ = solved
    for compiled in (x_of, jax.jit(x_of)):
        x = compiled(places(0.7, -0.4), jnp.asarray(RIGHT))
        np.testing.assert_allclose(x, solution(0.7, -0.4), rtol=1e-14)


def exact(p, b):
    """The same through a differentiable solver."""
    return jnp.linalg.solve(matrix(p), b)


JACOBIANS = {"forward": jax.jacfwd, "reverse": jax.jacrev}


@pytest.mark.slow
@pytest.mark.parametrize("first", JACOBIANS)
@pytest.mark.parametrize("second", JACOBIANS)
def test_derivatives_of_places_and_right_hand_sides(solved, first, second):
    x_of, _ = solved
    given = places(0.7, -0.4), jnp.asarray(RIGHT)
    both = (0, 1)
    for order in (
        lambda f: JACOBIANS[first](f, both),
        lambda f: JACOBIANS[second](JACOBIANS[first](f, both), both),
        lambda f: jax.jacfwd(JACOBIANS[second](JACOBIANS[first](f, both), both), both),
    ):
        ours, theirs = (jax.jit(order(f))(*given) for f in (x_of, exact))
        jax.tree.map(
            functools.partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-12),
            ours,
            theirs,
        )


@pytest.mark.slow
@pytest.mark.parametrize("batched", ["places", "right", "one place", "all", "nested"])
@pytest.mark.parametrize("jacobian", ["none", *JACOBIANS])
def test_batches(solved, batched, jacobian):
    x_of, _ = solved
    a, b = jnp.linspace(0.1, 0.9, 4), jnp.linspace(-0.5, 0.8, 4)
    rights = jnp.asarray(RIGHT)[None] + jnp.arange(12.0).reshape(4, 3)
    axes, given = {
        "places": (({"a": 0, "b": 0}, None), (places(a, b), rights[0])),
        "right": ((None, 1), (places(a[0], b[0]), rights.T)),
        "one place": (({"a": None, "b": 0}, None), (places(a[0], b), rights[0])),
        "all": ((0, 0), (places(a, b), rights)),
        "nested": ((0, None), (places(a, b), rights)),
    }[batched]

    def of(f):
        f = f if jacobian == "none" else JACOBIANS[jacobian](f, (0, 1))
        if batched == "nested":
            f = jax.vmap(f, (None, 0))
        return jax.jit(jax.vmap(f, axes))(*given)

    jax.tree.map(
        functools.partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-13),
        of(x_of),
        of(exact),
    )


def test_batches_along_last_axes(solved):
    """A vmap of a vmap, the outer one along the second axis of places and right."""
    x_of, _ = solved
    a, b = (
        np.linspace(0.1, 0.9, 6).reshape(2, 3),
        np.linspace(-0.5, 0.8, 6).reshape(2, 3),
    )
    rights = RIGHT[:, None] + np.arange(9.0).reshape(3, 3)
    inner = jax.vmap(x_of, (0, None))
    found = jax.jit(jax.vmap(inner, (1, 1)))(places(a, b), jnp.asarray(rights))
    for i, j in np.ndindex(2, 3):
        expected = solution(a[i, j], b[i, j], rights[:, j])
        np.testing.assert_allclose(found[j, i], expected, rtol=1e-13)


def test_right_hand_sides_in_columns():
    """Of one leaf: those above are cut in parts, which moves their axis to the front."""
    places = jnp.asarray(numpy_matrix(0.7, -0.4))
    rights = RIGHT[:, None] + np.arange(9.0).reshape(3, 3)

    def x_of(right):
        return linear_solve(
            lambda p, x: p @ x,
            lambda p, b: jnp.linalg.solve(p, b),
            lambda p, b: jnp.linalg.solve(p.T, b),
            places,
            right,
        )

    found = jax.jit(jax.vmap(x_of, 1, 1))(jnp.asarray(rights))
    np.testing.assert_allclose(found, np.linalg.solve(places, rights), rtol=1e-13)


def test_a_gradient_of_a_batch(solved):
    x_of, _ = solved
    rights = jnp.asarray(RIGHT)[None] + jnp.arange(12.0).reshape(4, 3)

    def total(f):
        return lambda p: jnp.sum(jax.vmap(f, (None, 0))(p, rights) ** 3)

    ours, theirs = (jax.grad(total(f))(places(0.7, -0.4)) for f in (x_of, exact))
    for name in "ab":
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-12)


def test_inside_a_loop_and_computed_again(solved):
    """The rules hold behind `scan` and `checkpoint`, where JAX cuts programs in parts."""
    x_of, _ = solved

    def chained(f):
        @jax.checkpoint
        def step(b, a):
            x = f(places(a, -0.4), b)
            return x, jnp.sum(x)

        def loss(b):
            return jnp.sum(jax.lax.scan(step, b, jnp.linspace(0.1, 0.9, 5))[1])

        return jax.jit(jax.grad(loss))(jnp.asarray(RIGHT))

    np.testing.assert_allclose(chained(x_of), chained(exact), rtol=1e-12)


@pytest.mark.parametrize(
    "derivative, used",
    [
        (lambda f: f, {"solve"}),
        (jax.jacfwd, {"solve"}),
        (jax.jacrev, {"transpose_solve"}),
    ],
)
def test_only_what_is_used_is_traced(solved, derivative, used):
    """A derivative with respect to the right-hand sides needs no equations."""
    x_of, calls = solved
    p = places(0.7, -0.4)
    jax.jit(derivative(lambda b: x_of(p, b))).lower(jnp.asarray(RIGHT))
    assert {name for name, count in calls.items() if count} == used
