"""How tuning goes on from what it knows: optimizers of optax and minimisers of optimistix.

A stepper says where to look next; flying is left to others. Optimistix asks for nothing
but value and slope at the point where it looks, so it is given a linear function that has
them there, and steps once.
"""

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jaxtyping import Array, PyTree

from ..parameters.parameters import Free
from .gradients import Evaluation


_FIRST = 1.0
"""Length of the first step of a solver, in free numbers, about. It knows no curvature
yet, and farther out all flights may have gone astray"""


class AbstractStepper(eqx.Module):
    """Goes from an evaluated point to the next one to evaluate."""

    @abstractmethod
    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        """State before the first step; of the evaluation only the shapes may matter."""

    @abstractmethod
    def step(
        self, free: Free, state: PyTree, evaluation: Evaluation, best: Free
    ) -> tuple[Free, PyTree, bool]:
        """The next point, the state, and whether the stepper has converged.

        `best` is the best point so far.
        """


class Descent(AbstractStepper):
    """An optax optimizer. From where no gradient is to be had it goes back halfway to the
    best point, and begins anew."""

    optimizer: optax.GradientTransformation = eqx.field(static=True)
    fresh_draws: bool = eqx.field(static=True)
    """So that a gradient of zero tells nothing of the point"""

    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        return self.optimizer.init(free)

    def step(self, free, state, evaluation, best):
        slope = any(np.any(np.asarray(g)) for g in evaluation.gradient.values())
        lost = not slope and not self.fresh_draws
        if not np.isfinite(evaluation.followed) or lost:
            halfway = jax.tree.map(lambda a, b: 0.5 * (a + b), free, best)
            return halfway, self.optimizer.init(halfway), False
        optimizer = optax.with_extra_args_support(self.optimizer)
        try:
            updates, state = optimizer.update(
                evaluation.gradient,
                state,
                free,
                value=jnp.asarray(evaluation.followed),
                grad=evaluation.gradient,
            )
        except TypeError as error:
            if "value_fn" not in str(error):
                raise
            raise ValueError(
                "this optimizer wants to evaluate the loss itself, as line searches of "
                "optax do: take optimistix.LBFGS in its place"
            ) from error
        return optax.apply_updates(free, updates), state, False


class SolverState(eqx.Module):
    """Of a minimiser of optimistix."""

    size: Array
    """By which all that it is shown is divided: it does not know the unit of a loss"""
    failed: Array
    """Flights that were at the start: a point with more is taken for a bad one"""
    accepted: Free
    inner: Any


class Solver(AbstractStepper):
    """A minimiser of optimistix."""

    solver: optimistix.AbstractMinimiser

    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        value, slope = jnp.asarray(evaluation.followed), evaluation.gradient
        known = value, slope, free
        structure = jax.eval_shape(lambda: value)
        inner = self.solver.init(
            _linear, free, known, _OPTIONS, structure, None, frozenset()
        )
        if not hasattr(inner, "y_eval"):
            raise ValueError(
                f"{type(self.solver).__name__} does not look at one point at a time: "
                "take another solver, such as optimistix.LBFGS"
            )
        # The first step is the gradient.
        size = float(optax.tree.norm(slope)) / _FIRST
        size = size if np.isfinite(size) and size > 0.0 else 1.0
        return SolverState(
            jnp.asarray(size), jnp.asarray(evaluation.failed), free, inner
        )

    def step(self, free, state, evaluation, best):
        value, slope = jnp.asarray(evaluation.followed), evaluation.gradient
        if evaluation.failed > int(state.failed) or not jnp.isfinite(value):
            # To be rejected; an infinite loss would make differences that are none.
            value = jnp.asarray(1e100)
            slope = jax.tree.map(jnp.zeros_like, slope)
        value, slope = jax.tree.map(lambda x: x / state.size, (value, slope))
        following, state, done = _step(self.solver, (value, slope, free), state)
        return following, state, bool(done)


_OPTIONS = {"jac": "bwd"}
"""Keeps the Jacobian as arrays, which can be stored, and not as a program"""


def _linear(free: Free, known) -> tuple[Array, None]:
    value, slope, here = known
    moved = [
        jnp.tensordot(slope[address], free[address] - here[address], here[address].ndim)
        for address in here
    ]
    return value + sum(moved), None


@eqx.filter_jit
def _step(solver, known, state: SolverState):
    given = known, _OPTIONS
    accepted, inner, _ = solver.step(
        _linear, state.accepted, *given, state.inner, frozenset()
    )
    done, _ = solver.terminate(_linear, accepted, *given, inner, frozenset())
    after = SolverState(state.size, state.failed, accepted, inner)
    return inner.y_eval, after, done
