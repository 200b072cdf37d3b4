"""Exact derivatives of a closed loop and of its vehicle, at points of a flight."""

import dataclasses
import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._programs import cached
from ..addresses import leaves_by_address
from ..fields import Count, Scalar, Vector
from ..flight.closed_loop import start, vector_field
from ..flight.cycle import Plan
from ..flight.end import end_of_flight
from ..flight.lane import Lane
from ..flight.loop import while_running_with_history
from ..flight.scenario import Scenario
from ..flight.sensing import command, sense
from ..flight.solver import AbstractSolver
from ..flight.termination import Outcome, has_end
from ..guidance.law import AbstractSampledLaw, Tracked
from ..motion.dynamics import require_angles
from ..motion.index import AbstractIndex
from ..motion.state import Controls
from ..onboard.measurement import measure
from ..onboard.navigation import InertialNavigation


QUICKLY = {
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}
"""Options of XLA for programs that run at few points, where compilation dominates"""


class FlownPoints(NamedTuple):
    """Points of a flight that are spaced evenly over an index."""

    plan: Plan
    lanes: Lane
    """Stacked lanes, each at the start of a step, or of a cycle before its decision"""
    index: Float[np.ndarray, " points"]
    time: Float[np.ndarray, " points"]
    """s since the start"""
    span: float
    """Change of the index from the start of the flight to its end, as a magnitude"""
    ended_by: str
    coordinates: tuple[str, ...]
    """Names of the numbers of a lane that are differentiated: the time, the moving states,
    and the values that a sampled law holds"""


def fly_points(
    scenario: Scenario, index: AbstractIndex, points: int, solver: AbstractSolver
) -> FlownPoints:
    """Fly a scenario and store points of the flight; see `linearize` for its errors."""
    if points < 1:
        raise ValueError(f"points is {points}: it must be 1 or more")
    require_angles(
        scenario.dynamics,
        scenario.initial_state,
        "the coordinates of a linearization are altitude, velocity and angles",
    )
    navigation = scenario.navigation
    if isinstance(navigation, InertialNavigation) and navigation.filter is not None:
        raise ValueError(
            "navigation has a filter, whose estimates are no coordinates of the "
            "linearization: take InertialNavigation(filter=None)"
        )
    sampled = isinstance(scenario.law, AbstractSampledLaw)
    plan = Plan.of(scenario, solver, None)
    if not sampled:
        plan = Plan.of(scenario, solver, plan.step)
    lanes, flying, values, end, outcome, ended_by = _flown(scenario, plan, index)
    if not has_end(int(outcome)):
        raise ValueError(
            f"the flight {Outcome(int(outcome)).message}: it has no linearization; fly it "
            "with a history and see where it fails"
        )
    # The cycle in which the flight ends is not complete.
    whole = int(flying) - sampled
    if whole < 1:
        raise ValueError(
            "the flight ends within its first step, or guidance cycle: there is nothing to "
            "linearize"
        )
    passed = np.append(np.asarray(values)[:whole], end)
    time = np.asarray(lanes.flown)[:whole]
    onwards = np.sign(passed[-1] - passed[0])
    wrong = np.flatnonzero(~(np.diff(passed) * onwards > 0.0))
    if wrong.size:
        raise ValueError(
            f"{type(index).__name__} stands still or turns {time[wrong[0]]:g} s after the "
            "start: deviations are taken at equal index, which must rise or fall "
            "throughout, as TimeIndex does"
        )
    wanted = np.linspace(passed[0], passed[-2], points)
    place = np.interp(wanted * onwards, passed[:-1] * onwards, np.arange(whole))
    chosen = np.rint(place).astype(int)
    if np.unique(chosen).size < points:
        raise ValueError(
            f"points is {points}: the {whole} steps, or guidance cycles, of the flight are "
            "too few for so many; use fewer points"
        )
    lanes = jax.tree.map(lambda x: x[chosen], lanes)
    span = float(abs(passed[-1] - passed[0]))
    end_name = scenario.termination.names[int(ended_by)]
    return FlownPoints(
        plan, lanes, passed[chosen], time[chosen], span, end_name, _coordinates(lanes)
    )


@cached
def _flown(
    scenario: Scenario, plan: Plan, index: AbstractIndex
) -> tuple[Lane, Count, Vector, Scalar, Count, Count]:
    lane = start(scenario, plan.step)
    lane, lanes = while_running_with_history(
        plan.cycle, lambda lane: lane.running, scenario, lane, plan.cycles
    )
    end = end_of_flight(scenario, lane)

    def value(lane: Lane) -> Scalar:
        return index.value(scenario.planet, lane.flown, lane.state)

    flying = jnp.sum(jax.vmap(lambda lane: lane.on_schedule)(lanes))
    values = jnp.asarray(jax.vmap(value)(lanes))
    return lanes, flying, values, value(end.lane), end.outcome, end.ended_by


def _carried(lane: Lane):
    """The numbers of a lane that can deviate: a triple of trees."""
    return eqx.filter((lane.flown, lane.moving, lane.held), eqx.is_inexact_array)


def _flat(lane: Lane) -> Vector:
    return ravel_pytree(_carried(lane))[0]


def _coordinates(lanes: Lane) -> tuple[str, ...]:
    """Names of the numbers of stacked lanes, in the order of `_flat`."""
    _, moving, held = _carried(lanes)
    named = {a.removeprefix("motion."): x for a, x in leaves_by_address(moving).items()}
    named |= {f"held.{a}".rstrip("."): x for a, x in leaves_by_address(held).items()}
    found = ["time"]
    for name, leaf in named.items():
        count = int(np.prod(leaf.shape[1:]))
        found += [name] if leaf.ndim == 1 else [f"{name}[{i}]" for i in range(count)]
    return tuple(found)


class LoopDerivatives(eqx.Module):
    """Derivatives of a closed loop at points, with respect to all coordinates."""

    gradient: Float[Array, "*points n"]
    """Derivatives of the index"""
    shares: Float[Array, "*points n"]
    """Contributions of the coordinates to the rate of the index"""
    derivative: Float[Array, "*points n n"]
    """Derivatives of the rates per unit of the passed index. For a law with a guidance
    cycle: derivatives of the map of one cycle, up to equal index"""
    way: Float[Array, "*points"]
    """Change of the index in the cycle, as a magnitude; 1 without cycles"""
    errors: Float[Array, "*points k n"]
    """Derivatives of the errors that the law feeds back"""
    gradient_then: Float[Array, "*points n"]
    """`gradient` after the cycle; without cycles, its rate per unit of the index"""
    errors_then: Float[Array, "*points k n"]
    """`errors` after the cycle; without cycles, their rate per unit of the index"""


@functools.partial(cached, compiler_options=QUICKLY)
def loop_derivatives(
    scenario: Scenario, index: AbstractIndex, plan: Plan, lanes: Lane
) -> LoopDerivatives:
    """Derivatives of a closed loop at the points of a flight; see `fly_points`."""
    return derivatives_at(scenario, index, plan, lanes)


def derivatives_at(
    scenario: Scenario, index: AbstractIndex, plan: Plan, lanes: Lane
) -> LoopDerivatives:
    """`loop_derivatives` for use in another program, which may differentiate the result."""

    def put(flat: Vector, lane: Lane) -> Lane:
        _, unravel = ravel_pytree(_carried(lane))
        fixed = eqx.filter(
            (lane.flown, lane.moving, lane.held), eqx.is_inexact_array, inverse=True
        )
        flown, moving, held = eqx.combine(unravel(flat), fixed)
        return dataclasses.replace(lane, flown=flown, moving=moving, held=held)

    def flow(lane: Lane) -> Vector:
        rate = vector_field(scenario, lane.held, lane.aiding)(lane.flown, lane.moving)
        _, _, held = _carried(lane)
        still = jax.tree.map(jnp.zeros_like, held)
        rate = eqx.filter(rate, eqx.is_inexact_array)
        return ravel_pytree((jnp.ones_like(lane.flown), rate, still))[0]

    def value(lane: Lane) -> Scalar:
        return index.value(scenario.planet, lane.flown, lane.state)

    def slope(lane: Lane) -> Vector:
        return jax.jacfwd(lambda flat: value(put(flat, lane)))(_flat(lane))

    def over_index(flat: Vector, lane: Lane) -> tuple[Vector, tuple[Vector, Vector]]:
        rate = flow(put(flat, lane))
        along = lambda flat: value(put(flat, lane))
        over = rate / jnp.abs(jax.jvp(along, (flat,), (rate,))[1])
        return over, (over, rate)

    def errors(lane: Lane) -> Array:
        def fed_back(flat: Vector) -> Array:
            there = put(flat, lane)
            sensed = sense(scenario, there.flown, there.moving, there.held)
            tracked = scenario.law.tracked(there.flown, sensed, there.held)
            numbers = [] if tracked is None else sum(tracked.errors, ())
            return jnp.stack(numbers) if numbers else jnp.zeros(0)

        return jax.jacfwd(fed_back)(_flat(lane))

    def cycle(flat: Vector, lane: Lane) -> tuple[Vector, Lane]:
        after = plan.cycle(scenario, put(flat, lane))
        return _flat(after), after

    def at(lane: Lane) -> LoopDerivatives:
        flat, gradient = _flat(lane), slope(lane)
        if not isinstance(scenario.law, AbstractSampledLaw):
            derivative, (over, rate) = jax.jacfwd(over_index, has_aux=True)(flat, lane)
            both = lambda flat: (slope(put(flat, lane)), errors(put(flat, lane)))
            (_, error), then = jax.jvp(both, (flat,), (over,))
            way = jnp.ones_like(lane.flown)
            return LoopDerivatives(
                gradient, gradient * rate, derivative, way, error, *then
            )
        pushed, after = jax.jacfwd(cycle, has_aux=True)(flat, lane)
        # A deviation that arrives ahead is moved back along the flow, to equal index.
        there, rate = slope(after), flow(after)
        ahead = (there @ pushed) / (there @ rate)
        derivative = pushed - rate[:, None] * ahead[None, :]
        way = jnp.abs(value(after) - value(lane))
        return LoopDerivatives(
            gradient, there * rate, derivative, way, errors(lane), there, errors(after)
        )

    return lax.map(at, lanes)


class PlantDerivatives(eqx.Module):
    """Derivatives of the motion at points, at equal time, with the flown controls."""

    gradient: Float[Array, "*points n"]
    """Derivatives of the index with respect to the state"""
    a: Float[Array, "*points n n"]
    """Derivatives of the rates per unit of the passed index with respect to the state"""
    b: Float[Array, "*points n 2"]
    """Derivatives of these rates with respect to angle of attack and bank"""
    c: Float[Array, "*points m n"]
    """Derivatives of the errors of the tracked outputs with respect to the state"""
    d: Float[Array, "*points m 2"]
    """Derivatives of these errors with respect to angle of attack and bank"""


@functools.partial(cached, compiler_options=QUICKLY)
def plant_derivatives(
    scenario: Scenario, index: AbstractIndex, plan: Plan, lanes: Lane
) -> PlantDerivatives:
    """Derivatives of the vehicle, from its controls to the outputs that its law tracks."""
    planet, vehicle, law = scenario.planet, scenario.vehicle, scenario.law

    def at(lane: Lane) -> PlantDerivatives:
        lane = plan.decided(scenario, lane)
        wish, _ = command(scenario, lane.flown, lane.moving, lane.held)
        flown = scenario.attitude.flown(lane.moving.attitude, wish)
        x, unravel = ravel_pytree(lane.state)
        u = jnp.stack(
            [flown.angle_of_attack, jnp.arctan2(flown.sin_bank, flown.cos_bank)]
        )

        def value(time: Scalar, x: Vector) -> Scalar:
            return index.value(planet, time, unravel(x))

        def over_index(x: Vector, u: Array) -> Array:
            angle, bank = u
            controls = Controls.from_bank(bank, angle)
            rates = scenario.dynamics.rates(planet, vehicle, unravel(x), controls)
            rate, _ = ravel_pytree(rates)
            at, along = (lane.flown, x), (jnp.ones_like(lane.flown), rate)
            return rate / jnp.abs(jax.jvp(value, at, along)[1])

        def outputs(x: Vector, u: Array) -> Array:
            angle, _ = u
            sensed = measure(
                planet,
                vehicle,
                unravel(x),
                angle,
                scenario.accelerometers,
                None,
                scenario.constraints,
            )
            tracked = law.tracked(lane.flown, sensed, lane.held)
            assert tracked is not None
            return jnp.stack([error for error, *_ in tracked.errors])

        a, b = jax.jacfwd(over_index, (0, 1))(x, u)
        c, d = jax.jacfwd(outputs, (0, 1))(x, u)
        return PlantDerivatives(jax.jacfwd(value, 1)(lane.flown, x), a, b, c, d)

    return lax.map(at, lanes)


def what_is_tracked(scenario: Scenario, lanes: Lane) -> Tracked | None:
    """Structure of the errors that the law declares to track, without their values."""

    def tracked(lanes: Lane) -> Tracked | None:
        lane = jax.tree.map(lambda x: x[0], lanes)
        sensed = sense(scenario, lane.flown, lane.moving, lane.held)
        return scenario.law.tracked(lane.flown, sensed, lane.held)

    return eqx.filter_eval_shape(tracked, lanes)
