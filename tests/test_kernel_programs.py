"""Kernels of small functions: each agrees with the function, mapped over runs by XLA."""

import re
import shutil
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jentry._batching import any_lane, side_by_side, where_due
from jentry._interpolation import interpolate, interpolate_surface
from jentry._linear_solve import solve_dense
from jentry.flight.loop import while_running
from jentry.kernel import NotInKernel, kernel_of, with_tangents


RUNS = 6

rng = np.random.default_rng(20261128)
X = rng.uniform(-2.0, 2.0, RUNS)
Y = rng.uniform(0.1, 3.0, RUNS)
I = np.array([0, 3, 7, -2, 1, 2])
V = rng.uniform(-1.0, 1.0, (RUNS, 4))
M = rng.uniform(-1.0, 1.0, (RUNS, 3, 3))
TABLE = jnp.asarray(rng.uniform(-1.0, 1.0, 9))
SURFACE = jnp.asarray(rng.uniform(-1.0, 1.0, (4, 5)))
GRID = jnp.linspace(-1.5, 1.5, 9)


def halvings(x):
    """Each flight has another number of iterations."""
    return lax.while_loop(
        lambda c: c[0] > 0.3, lambda c: (0.5 * c[0], c[1] + 1), (x, 0)
    )


def counted(x, y):
    def body(index, carry):
        a, b = carry
        return a + b * TABLE[index], b * 0.9

    return lax.fori_loop(0, 9, body, (x, y))


def rows(x):
    """A long loop over rows of a table, in reverse."""

    def body(carry, row):
        return carry * row[0] + row[1], None

    table = jnp.stack([TABLE, TABLE**2], axis=1)
    return lax.scan(body, x, table, reverse=True)[0]


def many_rows(x):
    """So many that the kernel has a loop over them."""
    table = jnp.linspace(0.5, 1.0, 500)
    act = lambda carry, row: (carry * row + 1.0, None)
    return lax.scan(act, x, table, reverse=True)[0], lax.scan(act, x, table)[0]


def stacked(x, v):
    def body(carry, given):
        return carry + given, carry * given

    return lax.scan(body, x, v)


def nested(x):
    def outer(carry):
        n, y = carry

        def inner(c):
            return c[0] + 1, 0.7 * c[1] + 0.1 * c[0]

        _, y = lax.while_loop(lambda c: c[0] < n, inner, (0, y))
        return n + 1, y

    return lax.while_loop(lambda c: c[0] < 5, outer, (0, x))[1]


def running(x, y):
    """The loop of a flight, with one answer for all flights."""

    def cycle(gain, carry):
        value, on = carry
        after = value - 0.1 * gain * value
        on_after = on & (jnp.abs(after) > 0.4)
        return jnp.where(on, after, value), on_after

    start = x, jnp.abs(x) > 0.4
    return while_running(cycle, lambda c: c[1], y, start, 200)


def due(x):
    return where_due(x > 1.0, lambda y: jnp.sin(y), x)


def branches(x, i):
    return lax.switch(i, [jnp.sin, jnp.cos, lambda y: 2.0 * y], x)


def chosen_at_once(x):
    """A flight answers for itself; a branch returns a constant."""
    return lax.cond(any_lane(x > 10.0), lambda y: (y, 1), lambda y: (0.0 * y, 2), x)


def network(v):
    weights = jnp.asarray(np.linspace(-1.0, 1.0, 20).reshape(5, 4))
    return jnp.tanh(weights @ v + 0.1)


def noise(x, i):
    key = jax.random.fold_in(jax.random.fold_in(jax.random.key(3), 7), i)
    more = jax.random.normal(key, dtype=float), jax.random.uniform(key, (2,), float)
    return x + more[0], more[1]


def bits_of_single_precision(i):
    key = jax.random.fold_in(jax.random.key(3), i)
    return jax.random.bits(key, (3,), "uint32")


def written(v, i, x):
    at = v.at[jnp.clip(i, 0, 3)].set(x)
    return at, v.at[i].add(x, mode="drop"), at.at[1:3].multiply(2.0)


def moved(v, i, x):
    part = lax.dynamic_slice(v, (i,), (2,))
    return part, lax.dynamic_update_slice(v, jnp.stack([x, -x]), (i,))


def beyond(v, x, i):
    """Places before the first and after the last number."""
    return (
        *(lax.dynamic_slice(v, (i + k,), (2,)) for k in (-20, 20)),
        *(lax.dynamic_update_slice(v, x[None], (i + k,)) for k in (-20, 20)),
        *(TABLE.at[i + k].get(mode="clip") for k in (-20, 20)),
    )


def read(v, m, i):
    return v[i], v.at[i].get(mode="fill", fill_value=9.0), m[:, i % 3], m[i % 3, 1]


def of_tables(x, y, i):
    return (
        TABLE[i],
        TABLE.at[i].get(mode="fill"),
        SURFACE[i % 4, 2:],
        interpolate(GRID, TABLE, x),
        interpolate(GRID, TABLE * y, x),
        interpolate_surface(GRID[:4], GRID[:5], SURFACE, x, y),
    )


def shapes(v, m, x):
    both = jnp.concatenate([v, m[0]])
    return (
        both[::-2],
        jnp.pad(v, (1, 2), constant_values=3.0),
        lax.pad(v, x, [(1, -1, 2)]),
        m.T.reshape(9)[2:7],
        jnp.stack([v, v * x])[..., None],
        jnp.split(both, [2, 5]),
        jnp.broadcast_to(x, (2, 3)),
        jnp.squeeze(m[:, :1]),
    )


def sums(v, m):
    return (
        *(f(m, axis=1) for f in (jnp.sum, jnp.prod, jnp.max, jnp.min, jnp.argmax)),
        *(f(v) for f in (jnp.argmin, jnp.cumsum, jnp.cumprod, jnp.mean)),
        lax.cummax(v, reverse=True),
        lax.cummin(v),
        jnp.any(v > 0.5),
        jnp.all(v > -0.9),
        m @ m,
        jnp.einsum("ij,j->i", m, v[:3]),
        jnp.argmax(jnp.where(v > 0.0, v, jnp.nan)),
    )


def rounds(x):
    halves = jnp.round(2.0 * x) / 2.0
    return (
        jnp.round(halves),
        lax.round(halves, lax.RoundingMethod.AWAY_FROM_ZERO),
        jnp.floor(x),
        jnp.ceil(x),
        jnp.sign(halves),
        jnp.trunc(x).astype(int),
    )


def elementary(x, y, i):
    unit = 0.4 * x
    return (
        *(f(x) for f in (jnp.sin, jnp.cos, jnp.tan, jnp.exp, jnp.tanh, jnp.abs)),
        *(f(y) for f in (jnp.log, jnp.sqrt, jnp.cbrt, lax.rsqrt, jnp.log1p, jnp.expm1)),
        *(f(unit) for f in (jnp.arcsin, jnp.arccos, jnp.arctan, lax.erf_inv)),
        *(f(x) for f in (jnp.sinh, jnp.cosh, jnp.arcsinh, jax.nn.sigmoid, jnp.square)),
        jnp.arctan2(x, y),
        y**x,
        x**3,
        y ** (-2),
        jnp.fmod(x, y),
        jnp.mod(i, 3),
        jnp.clip(x, -1.0, 1.0),
        jnp.where(x > 0.0, x, y),
        jnp.isfinite(x / (y - y)),
        (x > 0.0) ^ (y > 1.0),
        ~(x > 0.0),
        i << 2,
        i >> 1,
        lax.nextafter(x, y),
        x.astype(jnp.float32),
        lax.bitcast_convert_type(x, jnp.int64),
        1.0 * x,
        jnp.searchsorted(TABLE.sort(), x),
        jnp.array([1, 2, 3])[i % 3],
    )


def slopes(x):
    """From JAX 0.11 on these have an operation of their own, 1 - x^2."""
    unit = 0.4 * x
    return [jax.grad(f)(unit) for f in (jnp.arcsin, jnp.arccos, jnp.arctanh, jnp.tanh)]


def taken_apart(v, m):
    """From JAX 0.11 on these have an operation of their own, which makes rows of arrays."""
    first, second, *others = v
    return first * second, others, jnp.unstack(m), jnp.unstack(m, axis=1)


def solved(m, v):
    without_pivot = jnp.stack([jnp.zeros(2), v[:2]]).T + jnp.array(
        [[0.0, 3.0], [1.0, 0.0]]
    )
    return (
        solve_dense(m, v[:3, None]),
        jnp.linalg.solve(m.T, v[:3]),
        solve_dense(without_pivot, v[:2, None]),
    )


def known(x):
    """Outputs that do not vary, and truths."""
    return x, jnp.sum(TABLE), jnp.arange(3), x > 0.0, jnp.asarray(True)


def nothing_lost(x, i):
    """What is not finite, and numbers beyond arrays, as XLA has them."""
    return x / 0.0, jnp.log(x - 5.0), TABLE[i + 40], jnp.nan * x, 0.0 * (x / 0.0)


def limits(x, i):
    """Where C alone has no result, or another one than XLA."""
    beyond = jnp.stack([x / 0.0, 1e300 * x, jnp.nan * x, 3.7 * x, -x / 0.0])
    zero, least = i * 0, i * 0 + jnp.iinfo(jnp.int64).min
    words = i.astype(jnp.uint32)
    types = jnp.int32, jnp.int64, jnp.uint32, jnp.uint64
    return (
        *(lax.convert_element_type(beyond, dtype) for dtype in types),
        *(f(i, zero) for f in (lax.div, lax.rem)),
        *(f(least, zero - 1) for f in (lax.div, lax.rem)),
        *(f(words, words * 0) for f in (lax.div, lax.rem)),
        *(f(words, words + 30) for f in (lax.shift_left, lax.shift_right_logical)),
        *(f(i, abs(i) + 62) for f in (lax.shift_left, lax.shift_right_arithmetic)),
        lax.shift_right_logical(i, abs(i) + 60),
        *(f(x, beyond[2]) for f in (jnp.maximum, jnp.minimum)),
        *(f(beyond[2], x) for f in (jnp.maximum, jnp.minimum)),
        jnp.sign(beyond),
        lax.clamp(-1.0, beyond, 1.0),
        lax.rem(x, 0.7 + 0.0 * x),
        jnp.abs(i),
        ~i,
        i.astype(bool),
        x.astype(bool),
        (x > 0.0).astype(float),
    )


def exchanged(x, y):
    """A loop whose numbers change places."""
    return lax.fori_loop(0, 301, lambda i, c: (c[1], c[0] + 1.0, c[1]), (x, y, x))


def alike(x, v):
    return side_by_side((x, v), 2.0 * x)


def with_custom_rules(x):
    @jax.custom_jvp
    def f(x):
        return jnp.where(x > 0.0, jnp.sqrt(jnp.abs(x)), 0.0)

    f.defjvp(lambda p, t: (f(*p), 2.0 * t[0]))
    return jax.checkpoint(f)(x), jax.jit(f)(x) + jax.grad(f)(x)


PROGRAMS = {
    halvings: (X,),
    counted: (X, Y),
    rows: (X,),
    many_rows: (X,),
    stacked: (X, V),
    nested: (X,),
    running: (X, Y),
    due: (X,),
    branches: (X, I),
    chosen_at_once: (X,),
    network: (V,),
    noise: (X, I + 5),
    bits_of_single_precision: (I + 5,),
    written: (V, I, X),
    moved: (V, I, X),
    beyond: (V, X, I),
    read: (V, M, I),
    of_tables: (X, Y, I),
    shapes: (V, M, X),
    sums: (V, M),
    rounds: (X,),
    elementary: (X, Y, I),
    slopes: (X,),
    taken_apart: (V, M),
    solved: (M, V),
    known: (X,),
    nothing_lost: (X, I),
    limits: (X, I),
    exchanged: (X, Y),
    alike: (X, V),
    with_custom_rules: (X,),
}


def of_kernel(function, runs, form):
    if form == "c" and shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    act = lambda run: function(*run)
    example = jax.tree.map(lambda x: x[0], runs)
    return kernel_of(act, example, form=form)(runs)


def assert_same(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("form", ["xla", "c"])
@pytest.mark.parametrize("function", PROGRAMS, ids=lambda f: f.__name__)
def test_a_kernel_agrees_with_xla(function, form):
    runs = tuple(map(jnp.asarray, PROGRAMS[function]))
    expected = jax.jit(jax.vmap(function))(*runs)
    assert_same(of_kernel(function, runs, form), expected)


def test_tangents_in_the_loop_are_those_of_the_flight():
    """By `jax.jvp` of the function itself, whose loop has a rule of its own."""

    def function(x, y):
        value, on = running(x, y)
        return value * interpolate(GRID, TABLE, x), on

    x, y = jnp.asarray(X), jnp.asarray(Y)
    along = jnp.stack([jnp.eye(2)] * RUNS)
    runs = (x, y), (along[:, 0], along[:, 1])
    push = with_tangents(lambda run: function(*run))
    example = jax.tree.map(lambda a: a[0], runs)
    for form in ("xla", "c") if shutil.which("cc") else ("xla",):
        out, tangents = kernel_of(push, example, form=form)(runs)
        assert_same(out, jax.vmap(function)(x, y))
        assert tangents[1] is None
        for number, (dx, dy) in enumerate(np.eye(2)):
            jvp = lambda x, y, dx=dx, dy=dy: jax.jvp(
                lambda *a: function(*a)[0], (x, y), (dx, dy)
            )[1]
            np.testing.assert_allclose(
                tangents[0][:, number], jax.vmap(jvp)(x, y), rtol=1e-11, atol=1e-12
            )


REFUSED = {
    "sort": (lambda v: jnp.sort(v), "operation 'sort'"),
    "many_rows": (
        lambda v: lax.scan(lambda c, i: (c, c * i), v[0], jnp.arange(65.0))[1],
        "a loop of 65 iterations with an array of a flight for each; a kernel takes 64",
    ),
    # Its line is that of `_linear_solve`, where the system is solved.
    "large_system": (
        lambda v: solve_dense(jnp.eye(13) * v[0], jnp.ones((13, 1))),
        "solves 13 equations for each flight; a kernel solves 12",
    ),
    "large_array": (
        lambda v: jnp.outer(jnp.arange(80.0), jnp.arange(80.0) * v[0])[
            (10 * v[1]).astype(int), (10 * v[2]).astype(int)
        ],
        "takes 6400 selections; a kernel takes 4096",
    ),
    "seed": (
        lambda v: jax.random.uniform(jax.random.key((9 * v[0]).astype(int))),
        "makes a random key of a number that varies: fold it in",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_kernel_cannot_do_is_refused_with_its_line(name):
    function, why = REFUSED[name]
    with pytest.raises(NotInKernel) as refused:
        of_kernel(function, (jnp.asarray(V),), "xla")
    assert why in str(refused.value)
    assert re.search(r"\(/.*\.py:\d+\)$", str(refused.value))


def test_a_known_loop_is_computed_when_the_kernel_is_made():
    """It leaves no loop in the kernel."""
    function = lambda x: x + halvings(3.0)[0]
    act = kernel_of(lambda run: function(*run), (1.0,), form="xla")
    assert "while[" not in str(jax.make_jaxpr(act)((jnp.ones(4),)))


def test_what_flights_share_is_a_table_and_not_an_argument():
    """The numbers that a function closes over are those of its making."""
    box = eqx.filter_jit(lambda run: run * TABLE[2])
    found = kernel_of(box, 1.0, form="xla")(jnp.ones(3))
    np.testing.assert_array_equal(found, np.full(3, TABLE[2]))


def test_runs_have_the_structure_of_the_example():
    kernel = kernel_of(lambda run: run["x"], {"x": 1.0}, form="xla")
    with pytest.raises(ValueError, match="runs have the structure .*must be that of"):
        kernel({"x": jnp.ones(2), "y": jnp.ones(2)})


def test_a_kernel_in_c_needs_a_compiler(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(RuntimeError, match="needs a compiler: there is no cc here"):
        kernel_of(jnp.sin, 1.0, form="c")


def test_a_kernel_for_a_gpu_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(RuntimeError, match="needs CuPy: pip install 'jentry.cuda.'"):
        kernel_of(jnp.sin, 1.0)


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_the_inverse_of_erf_is_exact_to_its_ends():
    """XLA's, by a polynomial, is off by 1e-10 of its value near 1."""
    from scipy.special import erfinv

    near = 1.0 - 10.0 ** -np.linspace(0.01, 15.9, 60)
    y = np.concatenate([near, -near, [1e-9, 1e-300, 0.0, 0.5, 1.0, -1.0, 1.5]])
    found = kernel_of(lax.erf_inv, 1.0, form="c")(jnp.asarray(y))
    np.testing.assert_allclose(found, erfinv(y), rtol=1e-15)


def test_what_c_has_no_type_for_is_refused_with_its_line():
    half = lambda x: (2.0 * x).astype(jnp.float16)
    with pytest.raises(
        NotInKernel, match=r"of type float16 \(.*test_kernel_programs.py"
    ):
        kernel_of(half, 1.0, form="c")
