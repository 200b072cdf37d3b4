"""Solvers, which integrate the closed loop through one guidance cycle."""

import math
from collections.abc import Callable
from typing import TypeVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .._integrate import runge_kutta_step
from ..fields import Scalar


Y = TypeVar("Y", bound=PyTree)
VectorField = Callable[[Scalar, Y], Y]


class RungeKutta4(diffrax.AbstractSolver):
    """The classical fourth-order method, without dense output or error estimate.

    A general Runge-Kutta solver stores all its stages, which costs two to four times as
    much. Here each stage is added to the sum and is not stored.
    """

    term_structure = diffrax.AbstractTerm
    interpolation_cls = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 4

    def init(self, terms, t0, t1, y0, args):
        return None

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump

        def slope(t, y):
            return terms.vf(t, y, args)

        start, duration = jnp.asarray(t0), jnp.asarray(t1 - t0)
        y1 = runge_kutta_step(slope, start, y0, duration)
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful


class AbstractSolver(eqx.Module):
    """A method that `fly` uses to integrate the motion."""


class FixedStep(AbstractSolver):
    """Equal steps of a diffrax solver: fast, and differentiable in both modes.

    The step is the largest that does not exceed `step` and divides the guidance cycle and
    the interval of the history, if there is one. An observer limits the step: that of the
    drag-tracking law needs less than 2.8 epsilon with the paper's gains.
    """

    step: float | None = eqx.field(default=None, static=True)
    """Length of a step, s; None for that of the scenario, `Scenario.step`"""
    method: diffrax.AbstractSolver = RungeKutta4()

    def __check_init__(self):
        if self.step is not None and not 0.0 < self.step < math.inf:
            raise ValueError(f"step is {self.step} s: it must be positive and finite")

    def or_step(self, step: float) -> "FixedStep":
        """This solver, with the given step (s) if it has none."""
        return FixedStep(step, self.method) if self.step is None else self

    def steps_in(self, duration: float) -> int:
        """Number of steps in a duration (s)."""
        assert self.step is not None
        return max(1, math.ceil(duration / self.step - 1e-9))

    def advance(self, field: VectorField, time: Scalar, duration: Scalar, y: Y) -> Y:
        """Take one step. Reverse mode computes its stages again instead of storing them."""
        terms = diffrax.ODETerm(lambda t, y, args: field(jnp.asarray(t), y))

        def step(time: Scalar, duration: Scalar, y: Y) -> Y:
            end = time + duration
            y1, *_ = self.method.step(terms, time, end, y, None, None, False)
            return y1

        if not isinstance(self.method, RungeKutta4):  # it does not store its stages
            step = jax.checkpoint(step, prevent_cse=False)
        return step(time, duration, y)


class Adaptive(AbstractSolver):
    """`diffrax.diffeqsolve` with adaptive steps: slow, and accurate to a tolerance.

    It is the reference against which `FixedStep` is checked. It stops at every guidance
    cycle and finds the end with a root finder. A flight that needs more than `max_steps`
    in a cycle stops there, with `Outcome.NOT_FINITE`: so may one whose law has a memory
    with a derivative that jumps, as an integral that stops at a limit.
    """

    tolerance: float = eqx.field(default=1e-10, static=True)
    """Relative tolerance, and absolute tolerance in SI units and radians"""
    method: diffrax.AbstractAdaptiveSolver = diffrax.Dopri8()
    max_steps: int = eqx.field(default=4096, static=True)
    """Largest number of steps in one guidance cycle"""

    def __check_init__(self):
        if not 0.0 < self.tolerance < math.inf:
            raise ValueError(f"tolerance is {self.tolerance}: it must be positive")
        if self.max_steps < 1:
            raise ValueError(f"max_steps is {self.max_steps}: it must be 1 or more")
