"""Optimise a flight itself: numbers of a scenario, under constraints on how it flies."""

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._printed import in_words
from .._programs import kept
from .._setup import needs_float64
from .._warnings import ResultWarning
from ..addresses import replace_leaves
from ..flight.flight import Flight, fly
from ..flight.scenario import Scenario, check
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome, has_end
from ..parameters.maps import Ranges, linear_map_of
from ..parameters.parameters import Build, Parameters, itself, scenario_at
from ._constrained import Linearized, NoOptimumError, sequential_quadratic
from ._scaled_limits import ScaledLimits, parted, scaled_limits, what_is_wrong
from .flight_constraints import AlongPath, Constraint, Quantity


_flown = kept(fly)


@dataclasses.dataclass(frozen=True)
class Optimized:
    """The best flight that was found, and what holds it there."""

    scenario: Scenario
    parameters: Any
    """What was given, with the best values: the scenario, or what it is built from"""
    flight: Flight
    objective: float
    at_start: float
    """The objective where it began"""
    values: dict[str, np.ndarray]
    """Of the parameters, by address"""
    constraints: dict[str, np.ndarray]
    """Values of the constrained quantities; NaN for entries after the end"""
    prices: dict[str, np.ndarray]
    """By how much the best objective rises with the limit that binds, for each value: the
    multipliers, in the unit of the objective over that of the quantity. Positive where the
    least value binds, negative where the largest does, zero where none"""
    bound_prices: dict[str, np.ndarray]
    """Likewise of the bounds of the parameters, by address"""
    slope_left: float
    """Largest slope of the objective that the prices leave, as a share of the slope where
    it began, or of a thousandth of the objective if that is more: zero at an optimum"""
    iterations: int
    flights: int
    """That were flown with derivatives"""
    remarks: tuple[str, ...] = ()
    """What was warned of"""

    @property
    def active(self) -> dict[str, list[int]]:
        """The entries of constraints and of bounded parameters whose limits bind."""
        prices = {**self.prices, **self.bound_prices}
        found = {name: np.flatnonzero(x) for name, x in prices.items()}
        return {name: list(map(int, x)) for name, x in found.items() if x.size}


@needs_float64
def optimize(
    start: Any,
    where: Callable[[Any], Any] | None,
    objective: Quantity,
    constraints: Mapping[str, Constraint] | None = None,
    *,
    build: Build = itself,
    ranges: Ranges | None = None,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    tolerance: float = 1e-9,
    iterations: int = 1000,
) -> Optimized:
    """Make an objective of one flight small, within constraints on the flight.

    The unknowns are any numbers of the scenario: the coefficients of an angle of attack
    and of a bank, see `free_controls`, or the gains of a law. Each step flies with the
    exact derivatives of objective and constraints through the flight, its end included,
    in forward mode. SLSQP finds an optimum near the start, which need not be the best.

    **Arguments:**

    - `start`: the scenario where it begins; or, with `build`, any pytree of numbers.
    - `where`: lens to the leaves of it to vary, of any shape; None for all.
    - `objective`: a number of scenario and flight. To make one large, give its negative.
    - `constraints`: by name.
    - `build`: takes the start to the scenario that is flown, in terms of jax.numpy.
    - `ranges`: by address `Bounds(lower, upper)`, or the `Scale(size)` of a number that
      may be any. The scale is a quarter of the way between bounds, or else the size of
      the leaf. Numbers that their field restricts stay within that.
    - `solver`, `history`: as for `fly`.
    - `tolerance`: of the objective, in units of what a step by one scale along its slope
      changes at the start, or of a thousandth of its value if that is more; and of the
      constraints, in units of their scales.
    - `iterations`: of SLSQP, at most.

    Define functions once, at module level: others are compiled anew. Of an `eqx.Module`
    as the objective the arrays are not part of the program.

    **Raises:** `ValueError` for what cannot be varied, for a start whose flight has no end
    or numbers that are not finite, and where no optimum is found, with the constraints
    that are not met. **Warns** of a flight that does not end as it should, and of a limit
    of `within_limits` that is exceeded between the entries of the history.

        best = optimize(
            free_controls(scenario, bank=-60 * deg, angle_of_attack=17 * deg),
            control_coefficients,
            lambda s, f: -f.state.latitude,
            {"altitude": Constraint(lambda s, f: f.state.altitude, equals=24.4 * km)},
        )
        best.flight.state.latitude / deg, best.active
    """
    asked = dict(constraints or {})
    parameters = Parameters.of(start, where, ranges, build, linear_map_of)
    check(scenario_at(parameters, parameters.at_start))
    quantities = tuple((name, each.quantity) for name, each in asked.items())
    problem = _Problem(parameters, objective, quantities, solver, history)
    limits = scaled_limits(parameters, asked, problem.shapes())
    first = _seen(problem, jnp.zeros_like(limits.x.lower))
    _require_finite(problem, first, limits)
    # At an optimum already there is no slope to measure by.
    least = _LEAST_SLOPE * abs(float(first.value))
    scale = max(float(np.linalg.norm(first.slope)), least) or 1.0
    flights = 0

    def linearized(x: np.ndarray) -> Linearized:
        nonlocal flights
        flights += 1
        seen = jax.tree.map(np.asarray, _seen(problem, jnp.asarray(x)))
        over = seen.over
        return Linearized(
            seen.value / scale,
            seen.slope / scale,
            np.where(over, limits.inside, seen.values / limits.sizes),
            np.where(over[:, None], 0.0, seen.rows / limits.sizes[:, None]),
        )

    try:
        found = sequential_quadratic(
            linearized, np.zeros_like(limits.x.lower), limits.x, tolerance, iterations
        )
    except NoOptimumError as error:
        why = what_is_wrong(limits, linearized(error.x))
        raise ValueError(f"no optimum is found: {error}; {why}") from error

    free = parted(parameters, jnp.asarray(found.x))
    values = parameters.values(free)
    best = scenario_at(parameters, values)
    flight = _flown(best, solver, history)
    seen = jax.tree.map(np.asarray, _seen(problem, jnp.asarray(found.x)))
    remarks = _remarks(best, flight, quantities)
    if found.slope_left > _SLOPE_LEFT:
        remarks.append(
            f"{100.0 * found.slope_left:.2g} % of the slope of the objective at the start "
            "is left: this is not quite the optimum; take a smaller tolerance"
        )
    for remark in remarks:
        warnings.warn(remark, ResultWarning, stacklevel=3)
    return Optimized(
        scenario=best,
        parameters=replace_leaves(parameters.start, values),
        flight=flight,
        objective=float(seen.value),
        at_start=float(first.value),
        values=jax.tree.map(np.asarray, values),
        constraints=limits.named(np.where(seen.over, np.nan, seen.values)),
        prices=limits.named(found.constraints * scale / limits.sizes),
        bound_prices={
            address: np.asarray(x)
            for address, x in parted(
                parameters, found.bounds * scale / limits.scales
            ).items()
        },
        slope_left=found.slope_left,
        iterations=found.iterations,
        flights=flights,
        remarks=tuple(remarks),
    )


class _Problem(eqx.Module):
    """What is flown and what is looked at of it, as a function of free numbers."""

    parameters: Parameters
    objective: Quantity
    quantities: tuple[tuple[str, Quantity], ...] = eqx.field(static=True)
    solver: AbstractSolver
    history: float | None = eqx.field(static=True)

    def flown(self, x: Float[Array, " n"]) -> tuple[Scenario, Flight]:
        scenario = self.parameters.scenario(parted(self.parameters, x))
        return scenario, fly(scenario, self.solver, self.history)

    def outputs(self, x: Float[Array, " n"]) -> tuple[tuple[Array, Array], Array]:
        """The objective, the constrained values, and which of these are after the end."""
        scenario, flight = self.flown(x)
        value = jnp.asarray(self.objective(scenario, flight), float)
        if value.shape != ():
            raise ValueError(
                f"the objective has shape {value.shape}: it must be one number"
            )
        value = jnp.where(has_end(flight.outcome), value, jnp.nan)
        values, over = [jnp.zeros(0)], [jnp.zeros(0, bool)]
        for _, given in self.constrained(scenario, flight):
            after = jnp.zeros(given.shape, bool)
            history = flight.history
            if history is not None and given.shape[:1] == history.time.shape:
                after = after | jnp.isnan(history.time).reshape(
                    (-1,) + (1,) * (given.ndim - 1)
                )
            values.append(jnp.ravel(given))
            over.append(jnp.ravel(after))
        return (value, jnp.concatenate(values)), jnp.concatenate(over)

    def shapes(self) -> list[tuple[int, ...]]:
        """Of the constrained values."""
        values = jax.eval_shape(self._at_start)
        return [value.shape for value in values]

    def _at_start(self) -> list[Array]:
        maps = self.parameters.maps.values()
        x = jnp.zeros(sum(each.start.size for each in maps))
        return [value for _, value in self.constrained(*self.flown(x))]

    def constrained(
        self, scenario: Scenario, flight: Flight
    ) -> list[tuple[str, Array]]:
        return [
            (name, jnp.asarray(quantity(scenario, flight), float))
            for name, quantity in self.quantities
        ]


class _Seen(NamedTuple):
    """Objective and constrained values at one point, with their derivatives."""

    value: Any
    slope: Any
    """(n,)"""
    values: Any
    """(m,)"""
    rows: Any
    """(m, n)"""
    over: Any
    """(m,) Which values are after the end of the flight"""


@kept
def _seen(problem: _Problem, x: Float[Array, " n"]) -> _Seen:
    def along(direction):
        return jax.jvp(problem.outputs, (x,), (direction,), has_aux=True)

    (value, values), (slope, rows), over = jax.vmap(along, out_axes=(None, -1, None))(
        jnp.eye(x.size)
    )
    return _Seen(value, slope, values, rows, over)


def _require_finite(problem: _Problem, seen: _Seen, limits: ScaledLimits) -> None:
    """Refuse a start that says nothing."""
    values = np.where(seen.over, 0.0, seen.values)
    rows = np.where(np.asarray(seen.over)[:, None], 0.0, seen.rows)
    if all(np.all(np.isfinite(x)) for x in (seen.value, seen.slope, values, rows)):
        return
    _, flight = eqx.filter_jit(problem.flown)(jnp.zeros(np.shape(seen.slope)))
    if not has_end(flight.outcome):
        outcome = Outcome(int(flight.outcome)).message
        raise ValueError(
            f"the flight at the start says nothing, {outcome}: start elsewhere"
        )
    whole = [np.isfinite(values), *np.isfinite(rows.T)]
    odd = [name for name, x in limits.named(~np.all(whole, 0)).items() if np.any(x)]
    whole_objective = np.isfinite(seen.value) and np.all(np.isfinite(seen.slope))
    what = f"constraint {odd[0]}" if whole_objective else "objective"
    raise ValueError(
        f"the {what}, or its derivative, is not finite at the start: start elsewhere, or "
        "look at the function there"
    )


_LEAST_SLOPE = 1e-3
"""Of the objective, as a share of its value for a step by one scale"""

_SLOPE_LEFT = 1e-3
"""As a share of the slope at the start: more is worth a word"""

_MORE = 1e-3
"""Share of a limit by which a peak may exceed it between two entries without a word"""


def _remarks(
    scenario: Scenario, flight: Flight, quantities: Iterable[tuple[str, Quantity]]
) -> list[str]:
    """Sentences about the best flight that a reader must know."""
    found = []
    outcome = Outcome(int(flight.outcome))
    if outcome != Outcome.REACHED:
        name = scenario.termination.names[int(flight.ended_by)]
        found.append(
            f"the best flight ends by {name}, {outcome.message}: make it a constraint that "
            "it ends elsewhere"
        )
    for _, quantity in quantities:
        if isinstance(quantity, AlongPath):
            peak = float(flight.peaks[quantity.name])
            limit = scenario.constraints[quantity.name].limit
            assert limit is not None
            if peak > float(limit) + _MORE * (abs(float(limit)) or 1.0):
                found.append(
                    f"{in_words(quantity.name)} peaks at {peak:.6g} between the entries of "
                    f"the history, and its limit is {float(limit):.6g}: take a shorter "
                    "interval for the history"
                )
    return found
