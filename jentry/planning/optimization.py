"""Optimise a flight itself: numbers of a scenario, under constraints on how it flies."""

import dataclasses
import math
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
from ..motion.constraints import AbstractConstraint
from ..tuning.maps import Linear, Ranges, linear_map_of
from ..tuning.parameters import Build, Parameters, itself, scenario_at
from ._constrained import Limits, Linearized, NoOptimumError, sequential_quadratic


Quantity = Callable[[Scenario, Flight], Any]
"""Of a scenario and its flight: a number, or one for each entry of the history"""


@dataclasses.dataclass(frozen=True)
class Constraint:
    """What a flight has to keep: a quantity of it equals a value, or lies between two.

        Constraint(lambda s, f: f.state.altitude, equals=24.4 * km)
        Constraint(lambda s, f: f.peaks.load_factor, at_most=2.5)

    A quantity of the history is kept at each of its entries. That is better than to keep
    the peak, which is at another place in every flight.
    """

    quantity: Quantity
    equals: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    scale: float | None = None
    """How much of the quantity counts as a lot; the larger of the values, if not given"""

    def __post_init__(self):
        equal, least, most = self.equals, self.at_least, self.at_most
        for name in ("equals", "at_least", "at_most"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ValueError(f"{name} is {value}: it must be a finite number")
        if equal is None and least is None and most is None:
            raise ValueError(
                "a constraint has no value to keep: give equals=, at_least= or at_most="
            )
        if equal is not None and (least is not None or most is not None):
            raise ValueError(
                f"a constraint is to equal {equal}, and to be at least {least} or at most "
                f"{most}: give the one or the other"
            )
        if least is not None and most is not None and not least < most:
            raise ValueError(
                f"a constraint is to be at least {least} and at most {most}: the first "
                "must be the smaller; for one value give equals="
            )
        if self.scale is not None and not 0.0 < self.scale < np.inf:
            raise ValueError(f"scale is {self.scale}: it must be finite and above zero")
        if self.size == 0.0:
            raise ValueError(
                "a constraint is to be kept at 0, which does not tell how much is a lot: "
                "give scale=, in the unit of the quantity"
            )

    @property
    def least(self) -> float:
        """Infinite where there is none."""
        return _first(self.equals, self.at_least, -np.inf)

    @property
    def most(self) -> float:
        """Infinite where there is none."""
        return _first(self.equals, self.at_most, np.inf)

    @property
    def size(self) -> float:
        """What the quantity is divided by."""
        values = np.abs([self.least, self.most])
        return _first(self.scale, float(np.max(values[np.isfinite(values)])))


def _first(*values: float | None) -> float:
    return next(float(value) for value in values if value is not None)


@dataclasses.dataclass(frozen=True)
class AlongPath:
    """A path constraint at each entry of the history; of an integral the last value."""

    name: str

    def __call__(self, scenario: Scenario, flight: Flight) -> Array:
        if not isinstance(scenario.constraints[self.name], AbstractConstraint):
            return flight.peaks[self.name]
        if flight.history is None:
            raise ValueError(
                f"{self.name} is to be kept along the path, at each entry of the history: "
                "give an interval, such as history=5.0"
            )
        return flight.history.constraints[self.name]


def within_limits(scenario: Scenario) -> dict[str, Constraint]:
    """The limits of the path constraints of a scenario, as constraints of `optimize`.

    They are kept at each entry of the history, so `optimize` needs one.

    **Raises:** `ValueError` where no path constraint has a limit.
    """
    limits = {n: c.limit for n, c in scenario.constraints.items()}
    found = {n: float(limit) for n, limit in limits.items() if limit is not None}
    if not found:
        raise ValueError(
            "no path constraint of the scenario has a limit: give one, such as "
            'constraints={**scenario.constraints, "heat_rate": HeatRate(1e6)}'
        )
    # What has a limit of zero, such as the equilibrium glide, is in units that are a lot.
    return {
        name: Constraint(AlongPath(name), at_most=limit, scale=abs(limit) or 1.0)
        for name, limit in found.items()
    }


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

    Define functions once, at module level: others are compiled anew.

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
    limits = _limits(problem, asked)
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
        why = _what_is_wrong(limits, linearized(error.x))
        raise ValueError(f"no optimum is found: {error}; {why}") from error

    free = _parted(parameters, jnp.asarray(found.x))
    values = parameters.values(free)
    best = scenario_at(parameters, values)
    flight = kept(fly)(best, solver, history)
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
            for address, x in _parted(
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
    objective: Quantity = eqx.field(static=True)
    quantities: tuple[tuple[str, Quantity], ...] = eqx.field(static=True)
    solver: AbstractSolver
    history: float | None = eqx.field(static=True)

    def flown(self, x: Float[Array, " n"]) -> tuple[Scenario, Flight]:
        scenario = self.parameters.scenario(_parted(self.parameters, x))
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


def _parted(parameters: Parameters, x: Any) -> dict[str, Any]:
    """Free numbers by address, out of one row of them."""
    parted, first = {}, 0
    for address, each in _in_order(parameters):
        parted[address] = x[first : first + each.start.size].reshape(each.start.shape)
        first += each.start.size
    return parted


def _in_order(parameters: Parameters) -> list[tuple[str, Linear]]:
    """The maps as they follow each other in a row: JAX sorts a dictionary, too."""
    maps = sorted(parameters.maps.items())
    return [(address, each) for address, each in maps if isinstance(each, Linear)]


class _Scaled(NamedTuple):
    """The limits of all values in a row, and whose they are."""

    x: Limits
    """In units of the scales"""
    scales: np.ndarray
    """(n,) of the parameters"""
    sizes: np.ndarray
    """(m,)"""
    inside: np.ndarray
    """(m,) Values within the limits, in units of the sizes"""
    names: list[str]
    shapes: list[tuple[int, ...]]

    def named(self, row: np.ndarray) -> dict[str, np.ndarray]:
        named, first = {}, 0
        for name, shape in zip(self.names, self.shapes, strict=True):
            size = math.prod(shape)
            named[name] = row[first : first + size].reshape(shape)
            first += size
        return named


def _limits(problem: _Problem, asked: Mapping[str, Constraint]) -> _Scaled:
    maps = [each for _, each in _in_order(problem.parameters)]

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([np.ravel(getattr(each, name)) for each in maps])

    start, scales = all_of("start"), all_of("scale")
    lower, upper = (
        (all_of("lower") - start) / scales,
        (all_of("upper") - start) / scales,
    )

    def shapes_of(x):
        return [value for _, value in problem.constrained(*problem.flown(x))]

    seen = jax.eval_shape(shapes_of, jnp.asarray(start))
    shapes = [value.shape for value in seen]

    def row(of: Callable[[Constraint], float]) -> np.ndarray:
        rows = [
            np.full(math.prod(s), of(c))
            for s, c in zip(shapes, asked.values(), strict=True)
        ]
        return np.concatenate([np.zeros(0), *rows])

    sizes = row(lambda each: each.size)
    least, most = (
        row(lambda each: each.least) / sizes,
        row(lambda each: each.most) / sizes,
    )
    from_below = np.where(np.isfinite(least), least + 1.0, most - 1.0)
    both = np.isfinite(least) & np.isfinite(most)
    with np.errstate(invalid="ignore"):
        inside = np.where(both, 0.5 * (least + most), from_below)
    x = Limits(lower, upper, least, most)
    return _Scaled(x, scales, sizes, inside, list(asked), shapes)


def _require_finite(problem: _Problem, seen: _Seen, limits: _Scaled) -> None:
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


_STILL = 1e-12
"""Of a derivative, in the units of the problem: rounding"""


def _what_is_wrong(limits: _Scaled, here: Linearized) -> str:
    """What keeps a point from being allowed, the worst first, and what nothing moves."""
    values, equal = here.constraints, limits.x.least == limits.x.most
    rows = np.max(np.abs(here.rows), axis=1, initial=0.0)
    still = limits.named(equal & (rows < _STILL))
    named = [name for name, x in still.items() if np.any(x)]
    if named:
        return (
            f"{', '.join(named)} does not depend on what is varied there, where it is to "
            "equal a value: leave the constraint out, or look at how the flight ends"
        )
    beyond = np.maximum(limits.x.least - values, values - limits.x.most)
    worst = {n: float(np.max(x, initial=0.0)) for n, x in limits.named(beyond).items()}
    named = sorted(worst, key=lambda name: -worst[name])
    off = [
        f"{name} by {worst[name]:.2g} of its scale"
        for name in named
        if worst[name] > 1e-6
    ]
    if not off:
        return "all constraints are met there"
    return f"not met there: {', '.join(off)}"


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
