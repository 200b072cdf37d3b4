"""Steppers find a known minimum, and go on from what is stored as if never stopped."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
import pytest

from jentry.tuning.gradients import Evaluation
from jentry.tuning.record import CourseFile, Entry, restored
from jentry.tuning.steppers import Descent, Solver


SOLVERS = {
    "descent": lambda: Descent(optax.adam(0.2), False),
    "minimisation": lambda: Solver(optimistix.BFGS(1e-8, 1e-8)),
    "limited memory": lambda: Solver(optimistix.LBFGS(1e-8, 1e-8)),
}

STEPS = {
    "descent": 600,
    "minimisation": 120,
    "limited memory": 120,
}

START = {"a": jnp.asarray(-1.2), "b": jnp.asarray([1.0, 3.0])}

MINIMUM = {"a": 1.0, "b": np.array([1.0, -2.0])}


def residuals(free):
    """Of Rosenbrock's valley, and of a straight line beside it."""
    x, (y, z) = free["a"], free["b"]
    return jnp.stack([1.0 - x, 10.0 * (y - x * x), 0.5 * (z + 2.0)])


@jax.jit
def known(free):
    return jax.value_and_grad(lambda f: jnp.sum(residuals(f) ** 2))(free)


def evaluate(free, scale=1.0):
    """As from one flight of three residuals, all of them in another unit."""
    loss, gradient = known(free)
    gradient = jax.tree.map(lambda x: scale**2 * x, gradient)
    loss = scale**2 * float(loss)
    return Evaluation(loss, loss, gradient, 0, 0, {})


def points(stepper, steps, free=START, state=None, scale=1.0):
    """Where it goes, until it has converged; and its state after that."""
    visited, converged = [free], False
    while len(visited) <= steps and not converged:
        evaluation = evaluate(free, scale)
        if state is None:
            state = stepper.init(free, evaluation)
        free, state, converged = stepper.step(free, state, evaluation, free)
        visited.append(free)
    return visited, state, converged


@functools.cache
def found(name):
    return points(SOLVERS[name](), STEPS[name])


def same(first, second):
    """To the last bit."""
    assert jax.tree.structure(first) == jax.tree.structure(second)
    return all(
        np.asarray(a).tobytes() == np.asarray(b).tobytes()
        for a, b in zip(*map(jax.tree.leaves, (first, second)), strict=True)
    )


@pytest.mark.parametrize("name", SOLVERS)
def test_a_minimum_is_found(name):
    visited, _, converged = found(name)
    assert converged is (name != "descent")  # which never knows
    assert jax.tree.structure(visited[-1]) == jax.tree.structure(START)
    assert visited[-1]["b"].shape == (2,)
    losses = [float(known(free)[0]) for free in visited[-3:]]
    # Solvers stop at 1e-8 of their steps, along a valley that is 400 times as steep
    # across; adam creeps along it.
    atol = 0.1 if name == "descent" else 1e-6
    best = visited[-3:][int(np.argmin(losses))]
    for address, value in MINIMUM.items():
        np.testing.assert_allclose(best[address], value, rtol=0.0, atol=atol)


@pytest.mark.parametrize("name", SOLVERS)
def test_the_state_can_be_stored_and_gone_on_from(name, tmp_path):
    """After three steps, with the same points to the last bit."""
    stepper = SOLVERS[name]()
    visited, state, _ = points(stepper, 3)
    path = tmp_path / "record.npz"
    entry = Entry(0.0, 0.0, 0, 0, 0, 0.0, {}, {}, {})
    record = CourseFile(path, {})
    record.write([entry], visited[-1], state, False)
    _, following, leaves, _ = record.read()
    assert same(following, visited[-1])
    fresh = stepper.init(following, evaluate(following))
    stored = restored(fresh, leaves)
    numbers = [eqx.filter(x, eqx.is_array) for x in (stored, state)]
    assert same(*map(jax.tree.leaves, numbers))
    again, _, _ = points(stepper, 5, following, stored)
    assert same(again, found(name)[0][3:9])


def test_the_first_step_of_descent_is_that_of_its_optimizer():
    visited, _, _ = points(Descent(optax.sgd(1e-3), False), 1)
    gradient = known(START)[1]
    expected = jax.tree.map(lambda x, g: x - 1e-3 * g, START, gradient)
    for address, value in expected.items():
        np.testing.assert_allclose(visited[1][address], value, rtol=1e-15)


@pytest.mark.parametrize("name", ["minimisation", "limited memory"])
@pytest.mark.parametrize("scale", [1e-5, 1e4])
def test_the_unit_of_the_loss_makes_no_difference(name, scale):
    """A solver begins with a step or a damping of one, whatever the loss is counted in."""
    visited, _, _ = points(SOLVERS[name](), 6, scale=scale)
    for ours, theirs in zip(visited, found(name)[0], strict=False):
        for address in START:
            # Rounding, which some steps through a curved valley make larger.
            np.testing.assert_allclose(
                ours[address], theirs[address], rtol=1e-7, atol=1e-9
            )


@pytest.mark.parametrize("name", SOLVERS)
def test_at_a_minimum_nothing_moves(name):
    """And no step is taken over a gradient of zero."""
    at_rest = {a: jnp.asarray(x) for a, x in MINIMUM.items()}
    visited, _, _ = points(SOLVERS[name](), 3, at_rest)
    assert all(same(free, at_rest) for free in visited)


def failure(at, **changes):
    """Of all flights, unless told otherwise."""
    nothing = jax.tree.map(jnp.zeros_like, START)
    given = {"loss": np.inf, "followed": np.inf, "failed": 1}
    given = {"gradient": nothing, "gradients_failed": 0, "gradient_shares": {}} | given
    return Evaluation(**(given | changes))


@pytest.mark.parametrize("name", ["minimisation", "limited memory"])
@pytest.mark.parametrize("changes", [{}, {"loss": 0.0, "followed": 0.0}])
def test_a_solver_turns_back_from_where_flights_fail(name, changes):
    """However small the loss of those that are left; and finds the minimum all the same."""
    stepper = SOLVERS[name]()
    (_, tried), state, _ = points(stepper, 1)
    failed = failure(tried, **changes)
    back, state, converged = stepper.step(tried, state, failed, START)
    assert not converged

    def distance(free):
        return max(float(np.max(np.abs(free[a] - START[a]))) for a in START)

    assert 0.0 < distance(back) < distance(tried)
    visited, _, converged = points(stepper, STEPS[name], back, state)
    assert converged
    np.testing.assert_allclose(visited[-1]["a"], 1.0, rtol=0.0, atol=1e-6)


def test_descent_goes_back_halfway_and_begins_anew():
    stepper = SOLVERS["descent"]()
    visited, state, _ = points(stepper, 3)
    tried = visited[-1]
    back, state, _ = stepper.step(tried, state, failure(tried), START)
    for address, start in START.items():
        expected = 0.5 * (start + tried[address])
        np.testing.assert_allclose(back[address], expected, rtol=1e-15)
    assert same(state, stepper.init(back, evaluate(back)))


def test_a_gradient_of_zero_is_nothing_to_a_descent_with_fresh_draws():
    nothing = jax.tree.map(jnp.zeros_like, START)
    for fresh, moves in ((False, True), (True, False)):
        stepper = Descent(optax.sgd(0.1), fresh)
        state = stepper.init(START, evaluate(START))
        flat = Evaluation(1.0, 1.0, nothing, 0, 0, {})
        after, _, _ = stepper.step(
            START, state, flat, {a: 0.0 * x for a, x in START.items()}
        )
        assert same(after, START) is not moves


@pytest.mark.parametrize(
    "optimizer",
    [
        optimistix.NelderMead(1e-6, 1e-6),
        optimistix.BestSoFarMinimiser(optimistix.BFGS(1e-6, 1e-6)),
    ],
)
def test_a_solver_that_looks_elsewhere_is_refused(optimizer):
    with pytest.raises(ValueError, match="does not evaluate one point at a time"):
        Solver(optimizer).init(START, evaluate(START))


def test_a_line_search_of_optax_is_refused():
    stepper = Descent(optax.lbfgs(), False)
    state = stepper.init(START, evaluate(START))
    with pytest.raises(ValueError, match="optimistix.LBFGS"):
        stepper.step(START, state, evaluate(START), START)
