"""Minimise a function of some numbers under equations and bounds, to the last digits.

SLSQP of scipy finds which bounds are active; Newton's method on the conditions of Karush,
Kuhn and Tucker, with exact second derivatives, does the rest and gives the multipliers.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree


_ROUNDS = 50
"""Changes of what is active, after SLSQP; it takes none or a few"""

_STEPS = 30
"""Newton steps with the same bounds active; four do"""

_ROUNDING = 1e-13
"""Of a step of Newton's method, in units of the largest number: converged"""


class Optimum(NamedTuple):
    """A minimum, with what holds it there."""

    x: np.ndarray
    """(n,)"""
    value: float
    equations: np.ndarray
    """Multipliers of the equations, (m,): the rise of the minimum for each unit by which
    what must be zero is allowed to be larger is their negative"""
    bounds: np.ndarray
    """Multipliers of the bounds, (n,): by how much the minimum rises with the bound that is
    active; positive at lower ones, negative at upper ones, zero where none is"""
    iterations: int
    """Of SLSQP"""


class NoOptimumError(ValueError):
    """No minimum was found."""


Objective = Callable[[Any, Array], Array]
"""Of the problem and x of shape (n,)"""


def minimise(
    objective: Objective,
    equations: Objective,
    problem: PyTree,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> Optimum:
    """The x between bounds with the least value of `objective(problem, x)`.

    **Arguments:**

    - `objective`: gives a number; `equations` gives numbers of shape (m,), all of which
      must be zero. Both twice differentiable, defined at module level, and in units in
      which x and they are about one.
    - `problem`: a pytree of arrays: all else that they need.
    - `start`, `lower`, `upper`: (n,); the bounds may be infinite.

    **Raises:** `NoOptimumError`, with the words of SLSQP, where it finds none.
    """
    import scipy.optimize

    @functools.lru_cache(maxsize=4)  # SLSQP asks for each of these at the same x
    def known(x: bytes):
        values = _values_and_slopes(
            objective, equations, problem, jnp.asarray(np.frombuffer(x))
        )
        return jax.tree.map(np.asarray, values)

    def at(x: np.ndarray):
        return known(np.asarray(x, float).tobytes())

    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    found = scipy.optimize.minimize(
        lambda x: float(at(x)[0]),
        np.clip(start, lower, upper),
        jac=lambda x: at(x)[1],
        bounds=list(zip(lower, upper, strict=True)),
        constraints={
            "type": "eq",
            "fun": lambda x: at(x)[2],
            "jac": lambda x: at(x)[3],
        },
        method="SLSQP",
        options={"maxiter": 1000, "ftol": 1e-12},
    )
    if not found.success or not np.all(np.isfinite(found.x)):
        raise NoOptimumError(f"SLSQP: {found.message}, after {found.nit} iterations")
    x = np.clip(found.x, lower, upper)
    active = np.where(x <= lower, -1, np.where(x >= upper, 1, 0))
    for _ in range(_ROUNDS):
        x, multipliers, push = _stationary(
            objective, equations, problem, x, active, lower, upper
        )
        # What is crossed becomes active, and what pulls where it should push no longer is.
        crossed = np.where(x < lower, -1, np.where(x > upper, 1, 0))
        pulls = active * push > 0.0
        after = np.where(active == 0, crossed, np.where(pulls, 0, active))
        if np.array_equal(after, active):
            value = float(at(x)[0])
            bounds = np.where(active != 0, push, 0.0)
            return Optimum(x, value, multipliers, bounds, int(found.nit))
        active, x = after, np.clip(x, lower, upper)
    raise NoOptimumError(f"the active bounds still change after {_ROUNDS} rounds")


def _stationary(objective, equations, problem, x, active, lower, upper):
    """Newton's method with active bounds: x, multipliers, and the slope that is left."""

    def lagrangian(x: np.ndarray, multipliers: np.ndarray):
        numbers = jnp.asarray(x), jnp.asarray(multipliers)
        return _lagrangian(objective, equations, problem, *numbers)

    free = active == 0
    x = np.where(active < 0, lower, np.where(active > 0, upper, x))
    _, slope, _, rows = jax.tree.map(
        np.asarray,
        _values_and_slopes(objective, equations, problem, jnp.asarray(x)),
    )
    multipliers = np.linalg.lstsq(rows[:, free].T, -slope[free])[0]
    for _ in range(_STEPS):
        slope, curvature, left, rows = jax.tree.map(
            np.asarray, lagrangian(x, multipliers)
        )
        count = len(left)
        matrix = np.block(
            [
                [curvature[np.ix_(free, free)], rows[:, free].T],
                [rows[:, free], np.zeros((count, count))],
            ]
        )
        step = np.linalg.lstsq(matrix, -np.concatenate([slope[free], left]))[0]
        if not np.all(np.isfinite(step)):
            break
        x = x.copy()
        x[free] += step[: np.sum(free)]
        multipliers = multipliers + step[np.sum(free) :]
        if np.max(np.abs(step[: np.sum(free)]), initial=0.0) <= _ROUNDING * np.max(
            np.abs(x)
        ):
            slope, _, _, _ = jax.tree.map(np.asarray, lagrangian(x, multipliers))
            return x, multipliers, slope
    raise NoOptimumError("Newton's method does not converge at what SLSQP has found")


@eqx.filter_jit
def _values_and_slopes(objective, equations, problem, x):
    value, slope = jax.value_and_grad(objective, argnums=1)(problem, x)
    return value, slope, equations(problem, x), jax.jacrev(equations, 1)(problem, x)


@eqx.filter_jit
def _lagrangian(objective, equations, problem, x, multipliers):
    """Slope and curvature of the Lagrangian in x; the equations and their rows."""

    def lagrangian(x):
        return objective(problem, x) + multipliers @ equations(problem, x)

    rows = jax.jacrev(equations, 1)(problem, x)
    slope = jax.grad(lagrangian)(x)
    return slope, jax.hessian(lagrangian)(x), equations(problem, x), rows
