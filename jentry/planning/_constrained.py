"""Minimises a function under equations, limits and bounds.

SLSQP of scipy needs first derivatives. If there are only equations and bounds, and exact
second derivatives, Newton's method on the Karush-Kuhn-Tucker conditions refines its result
to rounding.
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
"""Largest number of changes of the active set after SLSQP; usually none or a few"""

_STEPS = 30
"""Largest number of Newton steps with one active set; usually four"""

_ROUNDING = 1e-13
"""Newton step at convergence, as a share of the largest number of x"""


class Linearized(NamedTuple):
    """A problem at one point, with its first derivatives, as numpy arrays."""

    value: float
    slope: np.ndarray
    """(n,)"""
    constraints: np.ndarray
    """(m,)"""
    rows: np.ndarray
    """(m, n): derivatives of the constraints"""

    @property
    def is_finite(self) -> bool:
        return all(np.all(np.isfinite(x)) for x in self)


class Limits(NamedTuple):
    """Limits of x and of the constraints; infinite where there is no limit.

    A constraint with equal limits is an equation.
    """

    lower: np.ndarray
    """(n,)"""
    upper: np.ndarray
    """(n,)"""
    least: np.ndarray
    """(m,)"""
    most: np.ndarray
    """(m,)"""


class Optimum(NamedTuple):
    """A minimum, with its Lagrange multipliers."""

    x: np.ndarray
    """(n,)"""
    value: float
    constraints: np.ndarray
    """(m,) Prices of the constraints, which are their multipliers: the derivative of the
    minimum with respect to the limit that binds. A price is positive where the least value
    binds, negative where the largest value binds, of either sign for an equation, and zero
    where no limit binds"""
    bounds: np.ndarray
    """(n,) Prices of the bounds of x"""
    iterations: int
    """Number of iterations of SLSQP"""
    slope_left: float
    """Largest component of the slope that the multipliers do not balance; zero at a
    minimum"""


class NoOptimumError(ValueError):
    """No minimum was found."""

    def __init__(self, message: str, x: np.ndarray):
        super().__init__(message)
        self.x = x
        """The last point of the search"""


def sequential_quadratic(
    linearized: Callable[[np.ndarray], Linearized],
    start: np.ndarray,
    limits: Limits,
    tolerance: float = 1e-12,
    iterations: int = 1000,
    met: float = 1e-6,
) -> Optimum:
    """The x within limits that has the least value, by SLSQP of scipy.

    **Arguments:**

    - `linearized`: the problem at a point, in units in which x, value and constraints are
      about one. Where it is not finite, SLSQP shortens its step.
    - `tolerance`: of the value, and of the summed violations of the constraints.
    - `met`: largest violation of a constraint that is accepted, whatever SLSQP reports.

    **Raises:** `NoOptimumError` with the message of SLSQP if it finds no minimum.
    """
    import scipy.optimize

    lower, upper, least, most = (np.asarray(x, float) for x in limits)
    equal = least == most
    above, below = ~equal & np.isfinite(least), ~equal & np.isfinite(most)

    @functools.lru_cache(maxsize=4)  # SLSQP asks for each of these at the same x
    def known(x: bytes) -> Linearized:
        return linearized(np.frombuffer(x))

    def at(x: np.ndarray) -> Linearized:
        return known(np.asarray(x, float).tobytes())

    def value(x: np.ndarray) -> float:
        return float(at(x).value) if at(x).is_finite else np.inf

    def left(x: np.ndarray) -> np.ndarray:
        values = np.nan_to_num(at(x).constraints)
        return np.concatenate([(values - least)[above], (most - values)[below]])

    def rows_left(x: np.ndarray) -> np.ndarray:
        rows = at(x).rows
        return np.concatenate([rows[above], -rows[below]])

    limited = {"type": "ineq", "fun": left, "jac": rows_left}
    equated = {
        "type": "eq",
        "fun": lambda x: np.nan_to_num(at(x).constraints - least)[equal],
        "jac": lambda x: at(x).rows[equal],
    }
    found = scipy.optimize.minimize(
        value,
        np.clip(start, lower, upper),
        jac=lambda x: at(x).slope,
        bounds=list(zip(lower, upper, strict=True)),
        constraints=[equated, limited],
        method="SLSQP",
        options={"maxiter": iterations, "ftol": tolerance},
    )
    if not found.success or not np.all(np.isfinite(found.x)):
        raise NoOptimumError(
            f"SLSQP: {found.message}, after {found.nit} iterations", found.x
        )
    x = np.clip(found.x, lower, upper)
    values = at(x).constraints
    if not at(x).is_finite or np.any((values < least - met) | (values > most + met)):
        raise NoOptimumError("SLSQP reports success at a point that is no solution", x)
    return _priced(at(x), x, limits, int(found.nit))


_BINDS = 1e-6
"""Distance from a limit below which the limit binds, in the units of the problem"""

_NO_PRICE = 1e-12
"""Price below which it is rounding, in the units of the problem"""


def _priced(
    here: Linearized, x: np.ndarray, limits: Limits, iterations: int
) -> Optimum:
    """The optimum at a point, with the multipliers that balance the slope best."""
    import scipy.optimize

    lower, upper, least, most = limits
    low, high = np.concatenate([least, lower]), np.concatenate([most, upper])
    values = np.concatenate([here.constraints, x])
    at_least = values - low < _BINDS
    at_most = high - values < _BINDS
    binding = at_least | at_most
    rows = np.concatenate([here.rows, np.eye(len(x))])[binding]
    signs = (
        np.where(at_most, -np.inf, 0.0)[binding],
        np.where(at_least, np.inf, 0.0)[binding],
    )
    multipliers, left = np.zeros(len(values)), here.slope
    if np.any(binding):
        # Not the default method: it does not converge with so many similar rows.
        solved = scipy.optimize.lsq_linear(rows.T, here.slope, signs, method="bvls")
        multipliers[binding] = np.where(np.abs(solved.x) > _NO_PRICE, solved.x, 0.0)
        left = here.slope - rows.T @ solved.x
    count = len(here.constraints)
    slope_left = float(np.max(np.abs(left), initial=0.0))
    parted = multipliers[:count], multipliers[count:]
    return Optimum(x, float(here.value), *parted, iterations, slope_left)


Objective = Callable[[Any, Array], Array]
"""Function of the problem and of x, which has shape (n,)"""


def minimise(
    objective: Objective,
    equations: Objective,
    problem: PyTree,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
) -> Optimum:
    """The x between bounds that minimises `objective(problem, x)`, exact to rounding.

    **Arguments:**

    - `objective`, `equations`: the objective returns a number, and the equations return
      numbers of shape (m,) that must all be zero. Both are twice differentiable, defined at
      module level, and in units in which x and the results are about one.
    - `problem`: a pytree of arrays with all further inputs of these two functions.
    - `start`, `lower`, `upper`: (n,); the bounds may be infinite.

    **Raises:** `NoOptimumError` if no minimum is found.
    """

    def linearized(x: np.ndarray) -> Linearized:
        values = _values_and_slopes(objective, equations, problem, jnp.asarray(x))
        return Linearized(*jax.tree.map(np.asarray, values))

    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    zero = np.zeros(len(linearized(np.asarray(start, float)).constraints))
    limits = Limits(lower, upper, zero, zero)
    # Newton's method solves the equations.
    found = sequential_quadratic(linearized, start, limits, met=np.inf)
    x = found.x
    active = np.where(x <= lower, -1, np.where(x >= upper, 1, 0))
    for _ in range(_ROUNDS):
        x, multipliers, push = _stationary(
            objective, equations, problem, x, active, lower, upper
        )
        # Crossed bounds become active. Bounds whose price has the wrong sign are released.
        crossed = np.where(x < lower, -1, np.where(x > upper, 1, 0))
        pulls = active * push > 0.0
        after = np.where(active == 0, crossed, np.where(pulls, 0, active))
        if np.array_equal(after, active):
            value = float(linearized(x).value)
            bounds = np.where(active != 0, push, 0.0)
            left = float(np.max(np.abs(push - bounds), initial=0.0))
            return Optimum(x, value, -multipliers, bounds, found.iterations, left)
        active, x = after, np.clip(x, lower, upper)
    raise NoOptimumError(f"the active bounds still change after {_ROUNDS} rounds", x)


def _stationary(objective, equations, problem, x, active, lower, upper):
    """Newton's method with active bounds: x, multipliers and the remaining slope."""

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
    raise NoOptimumError("Newton's method does not converge at what SLSQP has found", x)


@eqx.filter_jit
def _values_and_slopes(objective, equations, problem, x):
    value, slope = jax.value_and_grad(objective, argnums=1)(problem, x)
    return value, slope, equations(problem, x), jax.jacrev(equations, 1)(problem, x)


@eqx.filter_jit
def _lagrangian(objective, equations, problem, x, multipliers):
    """Slope and curvature of the Lagrangian in x, the equations, and their Jacobian."""

    def lagrangian(x):
        return objective(problem, x) + multipliers @ equations(problem, x)

    rows = jax.jacrev(equations, 1)(problem, x)
    slope = jax.grad(lagrangian)(x)
    return slope, jax.hessian(lagrangian)(x), equations(problem, x), rows
