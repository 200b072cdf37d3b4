"""Flights side by side: one answer for all, and loops that `vmap` goes through once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf
from jax import lax
from jax.test_util import check_grads

from jentry import _integrate, _newton
from jentry._batching import any_lane, side_by_side, where_due
from jentry.flight import loop
from jentry.missions import find_mission
from jentry.motion import Controls
from jentry.onboard import OnboardModel, propagation


def one(x):
    return jnp.asarray(x, dtype=float)


@pytest.fixture
def passes():
    """A function that changes nothing, and how often `vmap` has come to it."""
    seen = []

    @jax.custom_batching.custom_vmap
    def marked(x):
        return x

    @marked.def_vmap
    def _(axis_size, in_batched, x):
        seen.append(in_batched)
        return x, in_batched[0]

    return marked, seen


MANY = np.linspace(0.5, 2.0, 5)


def test_one_answer_for_all():
    some = jax.vmap(any_lane)(jnp.array([False, True, False]))
    assert some.tolist() == [True, True, True]
    assert not np.any(jax.vmap(any_lane)(jnp.zeros(3, bool)))


def test_what_is_due_for_one_is_computed_and_changes_no_other():
    act = lambda x: {"a": 2.0 * x["a"]}
    given = {"a": jnp.arange(3.0)}
    found = jax.vmap(lambda due, x: where_due(due, act, x))
    due = jnp.array([False, True, False])
    assert found(due, given)["a"].tolist() == [0.0, 2.0, 2.0]


def test_the_numbers_are_the_same_and_each_is_one_for_each_flight():
    tree = {"a": one(1.5), "b": (jnp.arange(3), jnp.asarray(True)), "c": None}

    def alike(x):
        return side_by_side(tree | {"x": x})

    found = jax.vmap(alike, out_axes=0)(jnp.arange(5.0))
    shapes = jax.tree.map(jnp.shape, found)
    assert shapes == {"a": (5,), "b": ((5, 3), (5,)), "c": None, "x": (5,)}
    assert np.all(found["a"] == 1.5) and found["x"].tolist() == [0, 1, 2, 3, 4]
    assert found["b"][0].dtype == tree["b"][0].dtype and found["b"][1].dtype == bool
    assert np.array_equal(found["b"][0][3], [0, 1, 2])
    alone = alike(one(2.0))
    assert alone["x"] == 2.0 and alone["b"][0].tolist() == [0, 1, 2]


def test_what_it_is_by_is_enough_and_stays_out_of_it(passes):
    marked, seen = passes

    def alike(by):
        return marked(side_by_side(one(1.0), {"by": by, "name": "no number"}))

    assert np.all(jax.vmap(alike)(MANY) == 1.0)
    assert seen == [[True]]
    jax.vmap(lambda x: marked(side_by_side(one(1.0))) + x)(MANY)
    assert seen == [[True]]  # Nothing differs, and `vmap` does not come by.


def test_it_is_nothing_in_what_is_compiled():
    def f(x):
        return jnp.sin(side_by_side((x, one(1.0)))[0])

    compiled = jax.jit(jax.vmap(f)).lower(MANY).compile().as_text()
    plain = jax.jit(jax.vmap(jnp.sin)).lower(MANY).compile().as_text()
    operations = lambda text: text.count(" = ")
    assert operations(compiled) == operations(plain)


@pytest.mark.parametrize("axes", [(0, None), (1, 0)])
def test_along_any_axis(axes):
    x, y = jnp.arange(6.0).reshape(2, 3), one(4.0)
    x, y = (x.T, y) if axes[1] is None else (x, jnp.full(3, 4.0))
    a, b = jax.vmap(lambda x, y: side_by_side((x, y)), axes)(x, y)
    assert (
        a.tolist() == [[0.0, 3.0], [1.0, 4.0], [2.0, 5.0]] and b.tolist() == [4.0] * 3
    )


def cubes(x):
    a, b, _ = side_by_side((x, x**2, jnp.arange(2)), x)
    return a * b


def test_derivatives_of_any_order_and_in_both_modes():
    for function in (cubes, jax.jit(cubes), jax.checkpoint(cubes)):
        check_grads(function, (one(1.3),), order=3, rtol=1e-5)
    assert float(jax.grad(jax.grad(cubes))(one(1.3))) == pytest.approx(6.0 * 1.3)
    of_many = jax.grad(lambda x: jnp.sum(jax.vmap(cubes)(x)))(MANY)
    np.testing.assert_allclose(of_many, 3.0 * MANY**2, rtol=1e-14)
    np.testing.assert_allclose(
        jax.vmap(jax.jacrev(jax.grad(cubes)))(MANY), 6.0 * MANY, rtol=1e-14
    )


def test_what_is_not_varied_has_no_derivative():
    _, tangents = jax.jvp(
        lambda x: side_by_side((x, one(2.0))), (one(1.0),), (one(3.0),)
    )
    assert [float(t) for t in tangents] == [3.0, 0.0]


# The loops. How often `vmap` goes through them is compared with what it takes where they
# are left as they are; and with a loop of which all differs from the start.


def passes_without(monkeypatch, seen, module, act):
    """How often `act` goes through it, as it is and without."""
    seen.clear()
    act()
    known = len(seen)
    seen.clear()
    with monkeypatch.context() as without:
        without.setattr(module, "side_by_side", lambda tree, by=None: tree)
        act()
    return known, len(seen)


def test_of_a_step_of_runge_kutta(passes, monkeypatch):
    marked, seen = passes

    def step(rate):
        y = {"a": rate, "b": one(2.0)}
        slope = lambda x, y: {"a": marked(rate * y["b"]), "b": -y["a"]}
        return _integrate.runge_kutta_step(slope, one(0.0), y, 0.1)["a"]

    found = jax.vmap(step)(MANY)
    np.testing.assert_array_equal(found[2], step(one(MANY[2])))
    act = lambda: jax.vmap(step)(MANY)
    known, without = passes_without(monkeypatch, seen, _integrate, act)

    @jax.checkpoint
    def stage(x, _):
        return marked(x), None

    seen.clear()
    jax.vmap(lambda x: lax.scan(stage, x, length=4)[0])(MANY)
    assert 1 <= known == len(seen) < without


@pytest.mark.parametrize("falls", [False, True])
def test_of_newton(passes, monkeypatch, falls):
    marked, seen = passes

    def root(c):
        value = lambda x: (marked(c - x**2), -2.0 * x)
        return _newton.newton(
            value, 0.5 + 0.5 * c, 6, lower=0.0, upper=4.0, falls=falls
        ).x

    np.testing.assert_allclose(jax.vmap(root)(MANY), np.sqrt(MANY), rtol=1e-6)
    act = lambda: jax.vmap(root)(MANY)
    known, without = passes_without(monkeypatch, seen, _newton, act)
    assert 1 <= known < without


def test_of_a_flight(passes, monkeypatch):
    marked, seen = passes

    def end(push):
        def cycle(push, y):
            return y[0] + 1.0, y[1] + push * y[0], marked(y[2] + y[1])

        nothing = one(0.0)
        running = lambda y: y[0] < 4.0
        start = nothing, nothing, nothing
        return loop.while_running(cycle, running, push, start, 9)

    _, found, _ = jax.vmap(end)(MANY)
    # 0 + 1 + 2 + 3.
    np.testing.assert_allclose(found, 6.0 * MANY, rtol=1e-15)
    act = lambda: jax.vmap(end)(MANY)
    known, without = passes_without(monkeypatch, seen, loop, act)
    assert 1 <= known < without


def test_of_a_prediction(passes, monkeypatch):
    marked, seen = passes
    scenario = find_mission("mars-range-tracking").scenario(
        "predictor-corrector", world="in-plane"
    )
    model = OnboardModel(scenario.planet, scenario.vehicle)

    def end(scale):
        start = with_leaf(
            scenario.initial_state, lambda s: s.velocity, 5500.0 + 100.0 * scale
        )

        command = lambda time, state: Controls.from_bank(one(1.0), one(0.0))
        ends = (lambda state: marked(state.velocity + state.altitude) - 5000.0,)
        there = propagation.propagate(model, start, command, ends, step=20.0, steps=16)
        return there.state.altitude

    act = lambda: jax.make_jaxpr(jax.vmap(end))(MANY)
    known, without = passes_without(monkeypatch, seen, propagation, act)
    assert 1 <= known < without
