"""Optimises one flight: numbers of its scenario, under constraints on the flight."""

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
from .._programs import cached
from .._setup import needs_float64
from .._warnings import ResultWarning
from ..addresses import replace_leaves
from ..flight.flight import Flight, fly
from ..flight.scenario import Scenario
from ..flight.scenario_checks import check
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Outcome, has_end
from ..parameters.maps import Ranges, linear_map_of
from ..parameters.parameters import Build, Parameters, itself, scenario_at
from ._constrained import Linearized, NoOptimumError, sequential_quadratic
from ._scaled_limits import ScaledLimits, parted, scaled_limits, what_is_wrong
from .flight_constraints import AlongPath, Constraint, Quantity


_flown = cached(fly)


@dataclasses.dataclass(frozen=True)
class Optimized:
    """The optimal flight that was found, with the Lagrange multipliers of its limits."""

    scenario: Scenario
    parameters: Any
    """The `start` of `optimize` with the best values: the scenario, or the pytree from
    which it is built"""
    flight: Flight
    objective: float
    at_start: float
    """The objective at the start"""
    values: dict[str, np.ndarray]
    """Values of the parameters, by address"""
    constraints: dict[str, np.ndarray]
    """Values of the constrained quantities; NaN for entries after the end"""
    multipliers: dict[str, np.ndarray]
    """Prices of the constraints, which are their multipliers: the derivative of the best
    objective with respect to the limit that binds, for each value, in the unit of the
    objective over that of the quantity. They are positive where the least value binds,
    negative where the largest value binds, and zero where no limit binds"""
    bound_multipliers: dict[str, np.ndarray]
    """Prices of the bounds of the parameters, by address"""
    slope_left: float
    """Largest slope of the objective that the multipliers do not balance; zero at an
    optimum. It is a share of the slope at the start, or of a thousandth of the objective if
    that is larger"""
    iterations: int
    flights: int
    """Number of flights that were flown with derivatives"""
    remarks: tuple[str, ...] = ()
    """Texts of the warnings"""

    @property
    def active(self) -> dict[str, list[int]]:
        """Entries of constraints and parameters at which a limit or a bound binds."""
        multipliers = {**self.multipliers, **self.bound_multipliers}
        found = {name: np.flatnonzero(x) for name, x in multipliers.items()}
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
    """Minimise an objective of one flight, within constraints on the flight.

    The unknowns are any numbers of the scenario: the coefficients of a bank and of an angle
    of attack, see `free_controls`, or the gains of a law. Each step flies with the exact
    derivatives of objective and constraints through the flight and its end, in forward
    mode. SLSQP finds a local optimum near the start, which need not be the global one.

    **Arguments:**

    - `start`: the scenario at which the search starts; or, with `build`, any pytree of
      numbers.
    - `where`: lens to the leaves of `start` to vary, of any shape; None for all leaves.
    - `objective`: function of scenario and flight that returns one number. To maximise it,
      pass its negative.
    - `constraints`: constraints by name.
    - `build`: function from `start` to the scenario, written with jax.numpy.
    - `ranges`: by address `Bounds(lower, upper)`, or `Scale(size)` for an unbounded number.
      The default scale is a quarter of the distance between the bounds, or else the size of
      the leaf. Numbers stay within the range of their field.
    - `solver`, `history`: as for `fly`.
    - `tolerance`: tolerance of the constraints in units of their scales, and of the
      objective. The unit for the objective is its change by a step of one scale along its
      slope at the start, or a thousandth of its value if that is larger.
    - `iterations`: largest number of iterations of SLSQP.

    Define functions once, at module level: another function is compiled again. If the
    objective is an `eqx.Module`, its arrays are not part of the compiled program.

    **Raises:** `ValueError` for leaves that cannot be varied, for a start whose flight has
    no end or numbers that are not finite, and if no optimum is found, with the constraints
    that are not met. **Warns** of a flight that does not reach its end condition, and of a
    limit of `within_limits` that is exceeded between the entries of the history.

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
    # A start that is already an optimum has no slope that could be the scale.
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
        multipliers=limits.named(found.constraints * scale / limits.sizes),
        bound_multipliers={
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
    """The flight, its objective and its constraints as functions of free numbers."""

    parameters: Parameters
    objective: Quantity
    quantities: tuple[tuple[str, Quantity], ...] = eqx.field(static=True)
    solver: AbstractSolver
    history: float | None = eqx.field(static=True)

    def flown(self, x: Float[Array, " n"]) -> tuple[Scenario, Flight]:
        scenario = self.parameters.scenario(parted(self.parameters, x))
        return scenario, fly(scenario, self.solver, self.history)

    def outputs(self, x: Float[Array, " n"]) -> tuple[tuple[Array, Array], Array]:
        """The objective, the constrained values, and which values are after the end."""
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
        """Shapes of the constrained values."""
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


@cached
def _seen(problem: _Problem, x: Float[Array, " n"]) -> _Seen:
    def along(direction):
        return jax.jvp(problem.outputs, (x,), (direction,), has_aux=True)

    (value, values), (slope, rows), over = jax.vmap(along, out_axes=(None, -1, None))(
        jnp.eye(x.size)
    )
    return _Seen(value, slope, values, rows, over)


def _require_finite(problem: _Problem, seen: _Seen, limits: ScaledLimits) -> None:
    """Refuse a start without an end, or with numbers that are not finite."""
    values = np.where(seen.over, 0.0, seen.values)
    rows = np.where(np.asarray(seen.over)[:, None], 0.0, seen.rows)
    if all(np.all(np.isfinite(x)) for x in (seen.value, seen.slope, values, rows)):
        return
    _, flight = eqx.filter_jit(problem.flown)(jnp.zeros(np.shape(seen.slope)))
    if not has_end(flight.outcome):
        outcome = Outcome(int(flight.outcome)).message
        raise ValueError(
            f"the flight at the start cannot be used, it {outcome}: start elsewhere"
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
"""Least slope of the objective by which it is scaled, as a share of its value for a step of
one scale"""

_SLOPE_LEFT = 1e-3
"""Remaining slope above which there is a warning, as a share of the slope at the start"""

_MORE = 1e-3
"""Share of a limit by which a peak may exceed it between two entries without a warning"""


def _remarks(
    scenario: Scenario, flight: Flight, quantities: Iterable[tuple[str, Quantity]]
) -> list[str]:
    """Warnings about the best flight."""
    found = []
    outcome = Outcome(int(flight.outcome))
    if outcome != Outcome.REACHED:
        name = scenario.termination.names[int(flight.ended_by)]
        found.append(
            f"the best flight ends by {name}, {outcome.message}: add a constraint so that "
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
