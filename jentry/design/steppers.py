"""How tuning goes on from what it knows: first-order descent, or least squares."""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jaxtyping import Array, PyTree

from .evaluation import Evaluation
from .parameters import Free


class AbstractStepper(eqx.Module):
    """Goes from an evaluated point to the next one to evaluate."""

    @abstractmethod
    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        """State before the first step."""

    @abstractmethod
    def step(
        self, free: Free, state: PyTree, evaluation: Evaluation
    ) -> tuple[Free, PyTree, bool]:
        """The next point, the state, and whether the stepper has converged."""


class Descent(AbstractStepper):
    """An optax optimizer."""

    optimizer: optax.GradientTransformation = eqx.field(static=True)

    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        return self.optimizer.init(free)

    def step(self, free, state, evaluation):
        updates, state = self.optimizer.update(evaluation.gradient, state, free)
        return optax.apply_updates(free, updates), state, False


class _MinimisationState(eqx.Module):
    size: Array
    """Norm of the gradient at the start, by which the loss is divided: the first step of
    a solver that knows no curvature yet is then of length one"""
    not_finite: Array
    """Flights that were not at the start: a point with more is taken for a bad one"""
    accepted: Free
    solver: Any


class Minimisation(AbstractStepper):
    """An optimistix minimiser, such as `BFGS`, step by step from outside.

    It is shown loss and gradient as a linear function, which at the point where it looks
    is all that it asks for.
    """

    solver: optimistix.AbstractMinimiser = eqx.field(static=True)

    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        known = jnp.asarray(evaluation.loss), evaluation.gradient, free
        structure = jax.eval_shape(lambda: known[0])
        state = self.solver.init(_plane, free, known, {}, structure, None, frozenset())
        size = optax.tree.norm(evaluation.gradient)
        size = jnp.where(size > 0.0, size, 1.0)
        return _MinimisationState(size, jnp.asarray(evaluation.not_finite), free, state)

    def step(self, free, state, evaluation):
        worse = evaluation.not_finite > int(state.not_finite)
        loss = jnp.asarray(np.inf if worse else evaluation.loss)
        given = loss, evaluation.gradient
        known = *jax.tree.map(lambda x: x / state.size, given), free
        following, state, done = _minimisation_step(self.solver, known, state)
        return following, state, bool(done)


def _plane(free: Free, known) -> tuple[Array, None]:
    loss, gradient, here = known
    moved = jax.tree.map(lambda g, a, b: jnp.sum(g * (a - b)), gradient, free, here)
    return loss + sum(jax.tree.leaves(moved)), None


@eqx.filter_jit
def _minimisation_step(solver, known, state: _MinimisationState):
    given = known, {}
    accepted, inner, _ = solver.step(
        _plane, state.accepted, *given, state.solver, frozenset()
    )
    done, _ = solver.terminate(_plane, accepted, *given, inner, frozenset())
    after = _MinimisationState(state.size, state.not_finite, accepted, inner)
    return inner.y_eval, after, done


class _LeastSquaresState(eqx.Module):
    size: Array
    """Norm of the Jacobian at the start, by which all is divided: a solver begins with a
    damping of one, which is then of the size of the curvature"""
    accepted: Free
    solver: Any


class LeastSquares(AbstractStepper):
    """An optimistix solver, such as `LevenbergMarquardt`, step by step from outside.

    It is shown the flights' residuals and their Jacobian as a linear function, which at
    the point where it looks is all that it asks for.
    """

    solver: optimistix.AbstractLeastSquaresSolver = eqx.field(static=True)

    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        structure = jax.eval_shape(lambda: evaluation.residuals)
        known = evaluation.residuals, evaluation.jacobian, free
        state = self.solver.init(
            _linear, free, known, _OPTIONS, structure, None, frozenset()
        )
        slopes = jax.tree.leaves(evaluation.jacobian)
        size = jnp.sqrt(sum(jnp.sum(slope**2) for slope in slopes))
        return _LeastSquaresState(jnp.where(size > 0.0, size, 1.0), free, state)

    def step(self, free, state, evaluation):
        given = evaluation.residuals, evaluation.jacobian
        known = *jax.tree.map(lambda x: x / state.size, given), free
        following, state, done = _least_squares_step(self.solver, known, state)
        return following, state, bool(done)


_OPTIONS = {"jac": "bwd"}
"""Keeps the Jacobian as arrays, which can be stored, and not as a program"""


def _linear(free: Free, known) -> tuple[Array, None]:
    residuals, jacobian, here = known
    moved = [
        jnp.tensordot(
            jacobian[address], free[address] - here[address], here[address].ndim
        )
        for address in here
    ]
    return residuals + sum(moved), None


@eqx.filter_jit
def _least_squares_step(solver, known, state: _LeastSquaresState):
    given = known, _OPTIONS
    accepted, inner, _ = solver.step(
        _linear, state.accepted, *given, state.solver, frozenset()
    )
    done, _ = solver.terminate(_linear, accepted, *given, inner, frozenset())
    return inner.y_eval, _LeastSquaresState(state.size, accepted, inner), done
