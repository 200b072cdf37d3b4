"""Steppers of tuning: optimizers of optax and minimisers of optimistix.

A stepper chooses the next point to evaluate; it does not fly. Optimistix needs only value
and gradient at the point that it evaluates. It therefore gets a linear function that has
this value and gradient, and takes one step.
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
"""Approximate length of the first step of a solver, in free numbers. The solver knows no
curvature yet, and all flights may fail at a point that is farther away"""


class AbstractStepper(eqx.Module):
    """Chooses the next point to evaluate from an evaluated point."""

    @abstractmethod
    def init(self, free: Free, evaluation: Evaluation) -> PyTree:
        """State before the first step. It may depend on the evaluation by shapes only."""

    @abstractmethod
    def step(
        self, free: Free, state: PyTree, evaluation: Evaluation, best: Free
    ) -> tuple[Free, PyTree, bool]:
        """The next point, the state, and whether the stepper has converged.

        `best` is the best point so far.
        """


class Descent(AbstractStepper):
    """An optax optimizer.

    At a point without a gradient it goes halfway back to the best point, and starts again
    with a new state.
    """

    optimizer: optax.GradientTransformation = eqx.field(static=True)
    fresh_draws: bool = eqx.field(static=True)
    """Whether each step has new draws. A gradient of zero may then be due to the draws"""

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
                "this optimizer must evaluate the loss itself, like the line searches of "
                "optax: use optimistix.LBFGS instead"
            ) from error
        return optax.apply_updates(free, updates), state, False


class SolverState(eqx.Module):
    """State of a minimiser of optimistix."""

    size: Array
    """Divisor of loss and gradient: the minimiser does not know the unit of the loss"""
    failed: Array
    """Number of failed flights at the start. A point with more of them is rejected"""
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
                f"{type(self.solver).__name__} does not evaluate one point at a time: "
                "use another solver, such as optimistix.LBFGS"
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
            # Large, so that the point is rejected; with infinity differences become NaN.
            value = jnp.asarray(1e100)
            slope = jax.tree.map(jnp.zeros_like, slope)
        value, slope = jax.tree.map(lambda x: x / state.size, (value, slope))
        following, state, done = _step(self.solver, (value, slope, free), state)
        return following, state, bool(done)


_OPTIONS = {"jac": "bwd"}
"""Represents the Jacobian as arrays, which can be stored, and not as a program"""


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
