"""Plans a reference: solves a bank profile for its end point, and tabulates its flight."""

import dataclasses
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, PyTree

from .._math import derivatives_along
from .._newton import newton, solve
from .._printed import quantity_in_words
from .._setup import needs_float64
from ..fields import Scalar
from ..flight.closed_loop import start as begin, vector_field
from ..flight.flight import fly
from ..flight.lane import Moving
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..flight.solver import FixedStep
from ..flight.termination import Termination, VelocityBelow
from ..guidance.open_loop import BankProfile
from ..motion.forces import air_data
from ..motion.index import AbstractIndex
from ..motion.state import EntryState
from ..onboard.profiles import (
    AbstractProfile,
    Nodes,
    PolynomialProfile,
    QuinticTable,
    grid,
    quintic_table,
)
from ..onboard.reference import DragReference


@needs_float64
def plan_bank_profile(
    scenario: Scenario,
    end_velocity: Scalar | float,
    curvature: Scalar | float = 0.0,
    guess: tuple[float, float] = (0.6, 0.05),
    solver: FixedStep = FixedStep(),
) -> PolynomialProfile:
    """Bank profile that meets the target of a scenario at a velocity.

    cos(bank) = c0 + c1 z + c2 z^2, where z rises from 0 at `end_velocity` (m/s) to 1 at the
    initial velocity. c2 is `curvature`. Newton's method finds c0 and c1 with simulated
    flights, so that altitude and downrange of the target are met at the point where the
    velocity falls to `end_velocity`. By the implicit function theorem the profile is
    differentiable in the numbers of the scenario and in the curvature.

    The guidance and the end conditions of the scenario are not used.

    **Raises:** `ValueError` if no such profile is found; see `require_planned`.
    """
    curvature = jnp.asarray(curvature, float)
    end_velocity = jnp.asarray(end_velocity, float)
    given = scenario, end_velocity, curvature
    coefficients = _solve(given, jnp.asarray(guess, float), solver)
    require_planned(coefficients)
    return _profile(given, coefficients)


def require_planned(plan: PyTree) -> None:
    """Raise `ValueError` if a plan was not found.

    Under `jit` a plan that was not found is NaN, and this check does nothing: call it on
    the result outside. (A check inside the program would prevent its compilation cache.)
    """
    known = [x for x in jax.tree.leaves(plan) if not isinstance(x, Tracer)]
    if any(np.isnan(x).any() for x in known):
        raise ValueError(
            "no bank profile meets the target: its altitude, downrange and the end "
            "velocity do not go together for this vehicle; try another curvature or guess"
        )


def _profile(given, coefficients: Float[Array, " 2"]) -> PolynomialProfile:
    scenario, end_velocity, curvature = given
    span = scenario.initial_state.velocity - end_velocity
    return PolynomialProfile(jnp.append(coefficients, curvature), end_velocity, span)


def _misses(given, coefficients: Float[Array, " 2"], solver: FixedStep):
    """Altitude and downrange beyond the target, in units of 100 km."""
    scenario, end_velocity, _ = given
    flown = open_loop(scenario, _profile(given, coefficients), end_velocity)
    missed = misses(flown, fly(flown, solver))
    return jnp.stack([missed.altitude, missed.downrange]) / 1e5


def _search(given, guess: Float[Array, " 2"], solver: FixedStep) -> Float[Array, " 2"]:
    """Newton's method with a Jacobian by finite differences.

    It converges as well as with exact derivatives, and compiles in a third of the time.
    """
    offsets = jnp.concatenate([jnp.zeros((1, 2)), _DIFFERENCE * jnp.eye(2)])

    def differences(x):
        values = jax.vmap(lambda c: _misses(given, c, solver))(x[None, :] + offsets)
        return values[0], (values[1:] - values[:1]).T / _DIFFERENCE

    found = newton(differences, guess, _IMPROVEMENTS)
    planned = found.known & (jnp.max(jnp.abs(found.value)) < _PLANNED_TO)
    return jnp.where(planned, found.x, jnp.nan)


_DIFFERENCE = 1e-5
_IMPROVEMENTS = 8
"""Newton steps from a guess that is 0.2 off to rounding, with two steps in reserve."""
_PLANNED_TO = 1e-9
"""Largest miss of a plan before the last Newton step, in units of 100 km."""


_solve = eqx.filter_custom_jvp(_search)


@_solve.def_jvp
def _solve_jvp(primals, tangents):
    """Derivative by the implicit function theorem: the profile balances the misses."""
    given, guess, solver = primals
    moved, _, _ = tangents
    found = _search(given, guess, solver)
    jacobian = jax.jacfwd(lambda c: _misses(given, c, solver))(found)
    _, drift = eqx.filter_jvp(lambda g: _misses(g, found, solver), (given,), (moved,))
    return found, -solve(jacobian, drift)


def open_loop(
    scenario: Scenario, cos_bank: AbstractProfile, end_velocity: Scalar | float
) -> Scenario:
    """The scenario with a bank profile in place of its law, and a velocity (m/s) as end."""
    return eqx.tree_at(
        lambda s: (s.guidance, s.termination),
        scenario,
        (
            BankProfile(cos_bank),
            Termination(
                {"velocity": VelocityBelow(velocity=end_velocity)},
                scenario.termination.time_limit,
            ),
        ),
    )


def no_memory(scenario: Scenario, interval: float) -> PyTree:
    """The empty memory of a law without memory: None, or a tree of None for a composed law.

    **Raises:** `ValueError` for a law with a memory, which does not follow from the state.
    """
    memory = jax.eval_shape(lambda: begin(scenario, interval).moving.memory)
    if jax.tree.leaves(memory):
        raise ValueError(
            f"{type(scenario.guidance).__name__} has a memory: fly a reference by a law "
            "without one, such as BankProfile or ControlProfiles"
        )
    return memory


Quantities = Callable[[Scalar, EntryState], Mapping[str, Scalar]]
"""Function of time (s) and state that returns numbers by name"""


class ReferenceFlight(eqx.Module):
    """A reference flight, with states so dense that one more step reaches any point."""

    scenario: Scenario
    interval: float = eqx.field(static=True)
    times: Float[Array, " n"]
    states: EntryState
    """States at `times`, each of shape (n,); NaN past the end"""
    end: EntryState
    """State at the end of the flight"""

    @classmethod
    def of(cls, scenario: Scenario, interval: float = 0.1) -> "ReferenceFlight":
        """Fly a scenario whose law has no memory, such as a bank profile.

        The law may be composed, with an angle of attack over the velocity.

        **Raises:** `ValueError` for a law with a memory.
        """
        no_memory(scenario, interval)
        flight = fly(scenario, FixedStep(interval), history=interval)
        history = flight.history
        assert history is not None
        return cls(scenario, interval, history.time, history.states, flight.state)

    def tabulate(
        self,
        quantities: Quantities,
        index: AbstractIndex,
        intervals: int,
        first_value: Scalar | None = None,
        power: int = 1,
    ) -> QuinticTable:
        """Tabulate quantities over an index, with exact values at the nodes.

        Each node is a state of the flight itself, one step of the solver after a stored
        state. The derivatives are those along the flow.

        **Arguments:**

        - `quantities`: function of time and state that returns numbers by name.
        - `index`: index that is monotonic from `first_value` on.
        - `intervals`: number of intervals between `first_value` and the end.
        - `first_value`: first value of the index, which the flight has; None for its value
          at the start.
        - `power`: 1 for even intervals, 2 for intervals that are short at first. See
          `QuinticTable`.

        **Raises:** `ValueError` for a first value that the flight does not reach.
        """
        if intervals < 1:
            raise ValueError(f"intervals is {intervals}: it must be 1 or more")
        start, end = self._ends(index, first_value)
        nodes = grid(start, end, intervals, power)
        exact = self._exact(quantities, index, nodes, first_value)
        return quintic_table(nodes, exact, power)

    def interpolation_error(
        self,
        table: QuinticTable,
        quantities: Quantities,
        index: AbstractIndex,
    ) -> dict[str, Scalar]:
        """Largest error of a table midway between its nodes, in units of the quantity.

        The error of a quintic is largest there. The exact values are those of the flight.
        """
        some = next(iter(table.coefficients.values()))
        intervals = some.shape[0]
        end = table.start + intervals * table.spacing
        nodes = grid(table.start, end, intervals, table.power)
        between = 0.5 * (nodes[1:] + nodes[:-1])
        exact = self._exact(quantities, index, between, table.start)
        read = jax.vmap(table.with_derivatives)(between)
        return {
            name: jnp.max(jnp.abs(read[name][0] - values[0]))
            for name, values in exact.items()
        }

    def reached(self, index: AbstractIndex, value: Scalar | float, name: str) -> Scalar:
        """A value of an index, named for the error message, that the flight must reach.

        It may lie one step of the flight beyond the first and the last state. In a compiled
        program a value that is not reached becomes NaN.

        **Raises:** `ValueError` if the flight does not reach it.
        """
        along, value = self._along(index), jnp.asarray(value, float)
        last = jnp.sum(jnp.isfinite(along)) - 1
        least, largest = jnp.nanmin(along), jnp.nanmax(along)
        step = jnp.abs(along[last] - along[jnp.maximum(last - 1, 0)])
        known = (value >= least - step) & (value <= largest + step)
        if not isinstance(known, Tracer) and not known:
            ends = (quantity_in_words(x, index.unit) for x in (least, largest))
            raise ValueError(
                f"{name} is {quantity_in_words(value, index.unit)}: the reference flight "
                f"has {' to '.join(ends)}; choose a value within, or fly it on"
            )
        return jnp.where(known, value, jnp.nan)

    def first_above(
        self, values: Float[Array, " n"], bound: Scalar | float, name: str
    ) -> tuple[Scalar, EntryState]:
        """Time and state where the drag, m/s2, is first above a bound.

        In a compiled program they are NaN if no drag is above it.

        **Arguments:**

        - `values`: drag of each state.
        - `bound`: the drag to exceed, named for the error message by `name`.

        **Raises:** `ValueError` if no drag is above it.
        """
        above = values > bound
        found = jnp.any(above)
        if not isinstance(found, Tracer) and not found:
            largest = quantity_in_words(jnp.nanmax(values), "m/s2")
            raise ValueError(
                f"{name} is {quantity_in_words(bound, 'm/s2')}: the largest drag of the "
                f"reference flight is {largest}; choose a smaller one"
            )
        first = jnp.where(found, jnp.argmax(above), values.size)
        return jax.tree.map(
            lambda x: x.at[first].get(mode="fill", fill_value=jnp.nan),
            (self.times, self.states),
        )

    def _along(self, index: AbstractIndex) -> Float[Array, " n"]:
        planet = self.scenario.planet
        values = jax.vmap(lambda *point: index.value(planet, *point))
        return jnp.asarray(values(self.times, self.states))

    def _ends(
        self, index: AbstractIndex, first_value: Scalar | None
    ) -> tuple[Scalar, Scalar]:
        along = self._along(index)
        last = jnp.sum(jnp.isfinite(along)) - 1
        if first_value is None:
            return along[0], along[last]
        return self.reached(index, first_value, "first_value"), along[last]

    def _exact(
        self,
        quantities: Quantities,
        index: AbstractIndex,
        nodes: Float[Array, " nodes"],
        first_value: Scalar | None,
    ) -> dict[str, Nodes]:
        """Quantities with two derivatives over the index, at the nodes."""

        planet = self.scenario.planet
        field = vector_field(self.scenario, None)
        memory = no_memory(self.scenario, self.interval)

        def integrated(state):
            return Moving(self.scenario.dynamics.integrated(state), None, memory)

        def flow(point):
            time, state = point
            moving = integrated(state)
            rates = field(time, moving)
            _, rate = jax.jvp(
                lambda motion: dataclasses.replace(moving, motion=motion).state,
                (moving.motion,),
                (rates.motion,),
            )
            return jnp.ones_like(time), rate

        def index_at(point):
            return index.value(planet, *point)

        solver = FixedStep(self.interval)

        def after(point, duration):
            time, state = point
            moving = solver.advance(field, time, duration, integrated(state))
            return time + duration, moving.state

        along = self._along(index)
        finite = jnp.isfinite(along)
        last = jnp.sum(finite) - 1
        start, _ = self._ends(index, first_value)
        falling = jnp.where(along[last] < start, -1.0, 1.0)
        # The index may turn before the first node; look only at what comes after.
        place = jnp.where(finite, falling * along, jnp.inf)
        place = lax.cummin(place, axis=0, reverse=True)

        def node(wanted):
            before = jnp.searchsorted(place, falling * wanted, side="right") - 1
            before = jnp.clip(before, 0, last)
            point = jax.tree.map(lambda x: x[before], (self.times, self.states))

            def improve(_, found):
                duration = found[1] - early(found[0], wanted)
                duration = lax.stop_gradient(duration)
                return after(point, duration), duration

            start = point, jnp.zeros_like(wanted)
            found, _ = lax.fori_loop(0, 4, improve, start)
            return read(on_the_node(found, wanted))

        def read(point):
            def all_of_them(point):
                return index_at(point), dict(quantities(*point))

            (_, values), (rate, firsts), (acceleration, seconds) = derivatives_along(
                flow, all_of_them, point
            )
            found = {}
            for name, value in values.items():
                slope = firsts[name] / rate
                bend = (seconds[name] - slope * acceleration) / (rate * rate)
                found[name] = value, slope, bend
            return found

        def early(point, wanted):
            """Time since the point had the required index, s, to first order."""
            value, rate = jax.jvp(index_at, (point,), (flow(point),))
            return (value - wanted) / rate

        def on_the_node(point, wanted):
            # The point lies on the node to rounding. This step to first order provides the
            # derivative of the node with respect to the flight.
            late, rates = -early(point, wanted), lax.stop_gradient(flow(point))
            return jax.tree.map(lambda x, rate: x + late * rate, point, rates)

        return jax.vmap(node)(nodes)


@needs_float64
def plan_drag_reference(
    flight: ReferenceFlight,
    index: AbstractIndex,
    gate: float = 0.0,
    intervals: int = 2000,
    power: int = 1,
) -> DragReference:
    """Drag reference of a flight with a bank profile, over an index, for drag tracking.

    With a gate (m/s2) the table starts where the drag first exceeds the gate. For a table
    over energy that starts at the entry interface, `power=2` makes its error small there;
    see `ReferenceFlight.interpolation_error`.

    **Raises:** `ValueError` for a flight under another law, and for a gate that its drag
    does not exceed.
    """
    scenario = flight.scenario
    law = scenario.guidance
    if not isinstance(law, BankProfile):
        raise ValueError(f"the reference flies {type(law).__name__}, not a BankProfile")
    planet, vehicle = scenario.planet, scenario.vehicle

    angle = law.angle_of_attack
    angle = vehicle.trim_angle_of_attack if angle is None else angle

    def drag(state):
        return air_data(planet, vehicle, state, angle).drag

    if not gate >= 0.0:
        raise ValueError(f"gate is {gate} m/s2: it must be zero or more")
    first_value = None
    if gate > 0.0:
        drags = jax.vmap(drag)(flight.states)
        first_value = index.value(
            planet, *flight.first_above(jnp.asarray(drags), gate, "gate")
        )

    def quantities(time, state):
        return {"drag": drag(state)}

    table = flight.tabulate(quantities, index, intervals, first_value, power)
    return DragReference(index, table.profile("drag"), law.cos_bank, gate)
