"""The closed loop: vehicle, measurement and law as one system of equations."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._batching import any_lane
from .._dependence import Traced
from ..fields import Count, Flag, Scalar
from ..guidance.law import AbstractSampledLaw, begun, commanded, decided
from ..guidance.switching import shares_reversals
from ..motion.attitude import Swing
from ..motion.constraints import (
    ConstraintValues,
    PathPoint,
    constraint_values,
    integrals_of,
)
from ..motion.state import Controls, EntryState
from ..onboard.inertial import Actual, Navigated
from ..onboard.measurement import Measurement, measure
from ..onboard.navigation import InertialNavigation
from ..onboard.navigation_filter import Knowledge
from ..world.tabulated import Excursion, beyond_edges, tables_in
from .scenario import Scenario
from .termination import Outcome


class Bracket(eqx.Module):
    """Next step of the fixed-step solver, and the bracket about the end of the flight."""

    trial: Scalar
    """Length of the next step, s"""
    margin: Scalar
    """Smallest margin of the end conditions now"""
    far: Scalar
    """Length of a step that is known to cross the end, s; infinite if none is known"""
    far_margin: Scalar
    """Smallest margin of the end conditions at `far`"""
    allowed: Scalar
    """Largest value that `far` may have after the next step, s"""


class Moving(eqx.Module):
    """Integrated quantities of a flight, or their time derivatives."""

    state: EntryState
    attitude: Any
    """State of the attitude; None if the vehicle follows commands at once"""
    memory: Any
    """Memory of the law"""
    integrals: Mapping[str, Scalar] = eqx.field(default_factory=dict)
    """Values of the path constraints that are integrals, by name"""
    off_a_bank: Scalar | None = None
    """Integral of the error of sin^2 + cos^2 of the commanded bank: zero if every command
    was a bank. It is None during the flight, where an invalid bank is replaced by NaN:
    this costs less, and stops the flight"""
    navigated: Navigated | None = None
    """State of the navigation; None if it is perfect"""

    @property
    def believed(self) -> EntryState:
        """What the vehicle believes of its position and velocity."""
        return self.state if self.navigated is None else self.navigated.state


class Instant(eqx.Module):
    """Time and state of a flight at one instant."""

    time: Scalar = eqx.field(metadata={"unit": "s"})
    """Time since the start, s"""
    state: EntryState


class Noted(eqx.Module):
    """Quantities that are recorded of a flight up to a step."""

    peaks: ConstraintValues
    at_peaks: dict[str, Instant]
    """Time and state at the located peaks, by name"""
    beyond: dict[str, Excursion]
    """Excursions beyond the edges of tables, by the name of the caveat"""


class Lane(eqx.Module):
    """A flight in progress: everything that the loop carries."""

    flown: Scalar
    """Time since the start, s"""
    moving: Moving
    held: Any
    noted: "Noted"
    bracket: Bracket
    running: Flag
    stopped: Count
    """Code of the `Outcome` that stopped the flight before an end; -1 if none has"""
    aiding: Any = None
    """What the navigation holds from one update to the next; None if nothing"""

    @property
    def state(self) -> EntryState:
        return self.moving.state

    @property
    def memory(self) -> Any:
        return self.moving.memory

    @property
    def on_schedule(self) -> Flag:
        """Whether the flight is running and not yet in the step that contains the end."""
        return self.running & jnp.isinf(self.bracket.far)


def guidance_period(scenario: Scenario) -> float | None:
    """Longest guidance cycle of a sampled law, s; none for a continuous one."""
    law = scenario.law
    return law.cycle.period if isinstance(law, AbstractSampledLaw) else None


def sense(
    scenario: Scenario,
    flown: Scalar,
    moving: Moving,
    held: Any,
    sampled_at: Scalar | None = None,
) -> Measurement:
    """What the vehicle measures in a state, at its present angle of attack.

    This is the angle of attack of its attitude. If the vehicle follows commands at once,
    it is the angle that the law commands. `sampled_at` (s) is given at the start of a
    guidance cycle.

    **Raises:** `ValueError` if the vehicle follows commands at once and the commanded
    angle of attack depends on the forces that are sensed at the same instant: these
    forces depend on the angle of attack in turn.
    """
    acting = _acting(scenario, flown, moving, held)
    return _sensed(scenario, moving, acting, sampled_at)


def _acting(scenario: Scenario, flown: Scalar, moving: Moving, held: Any) -> Traced:
    """The command of the law and the rate of its memory, as functions of what is sensed:
    lift, drag and the angle of attack."""
    state, memory = moving.believed, moving.memory
    trim = scenario.vehicle.trim_angle_of_attack
    bank = scenario.attitude.bank(moving.attitude)

    def act(lift: Scalar, drag: Scalar, angle: Scalar) -> tuple[Controls, Any]:
        measurement = Measurement(
            state, lift, drag, angle, trim, scenario.constraints, bank
        )
        return commanded(scenario.law, flown, measurement, memory, held)

    return Traced(act, *3 * [state.altitude])


def _sensed(
    scenario: Scenario,
    moving: Moving,
    acting: Traced,
    sampled_at: Scalar | None = None,
) -> Measurement:
    angle = scenario.attitude.angle_of_attack(moving.attitude)
    if angle is None:
        angle = acting.independent(lambda out: out[0].angle_of_attack)
    if angle is None:
        law = scenario.law
        hold = (
            "decide it at the guidance cycle, in `update`, and hold it"
            if isinstance(law, AbstractSampledLaw)
            else "hold the command through a guidance cycle, Sampled(law, period)"
        )
        raise ValueError(
            f"{type(law).__name__} commands an angle of attack that depends on the lift "
            "and drag sensed at the same instant, which depend on the angle of attack: "
            f"{hold}, or give the vehicle an attitude that takes its time"
        )
    bank = scenario.attitude.bank(moving.attitude)
    return _measured(scenario, moving, angle, sampled_at, bank)


def _measured(
    scenario: Scenario,
    moving: Moving,
    angle_of_attack: Scalar,
    sampled_at: Scalar | None = None,
    bank: Swing | None = None,
) -> Measurement:
    measurement = measure(
        scenario.planet,
        scenario.vehicle,
        moving.state,
        angle_of_attack,
        scenario.accelerometers,
        sampled_at,
        scenario.constraints,
        bank,
        scenario.flow_sensors,
        moving.believed,
    )
    error = scenario.angle_of_attack_error
    if error is None:
        return measurement
    told = angle_of_attack + error
    return eqx.tree_at(lambda m: m.angle_of_attack, measurement, told)


def first_measurement(scenario: Scenario) -> Measurement:
    """What the vehicle measures at the start, when its law has no memory yet.

    The forces are those at the first angle of attack of the attitude. If the attitude has
    none, they are those at the angle that the law commands at the start. If that command
    depends on the measurement, through the first memory or the first decision, the angle
    is the trim angle of attack of the vehicle: the attitude before guidance begins.
    """
    moving = first_moving(scenario)
    first = scenario.attitude.first_angle_of_attack
    if first is not None:
        return _measured(scenario, moving, first)
    law, state = scenario.law, moving.believed
    trim = scenario.vehicle.trim_angle_of_attack

    def act(lift: Scalar, drag: Scalar, angle: Scalar) -> tuple[Controls, Any]:
        measurement = Measurement(state, lift, drag, angle, trim, scenario.constraints)
        begin = begun(law, measurement)
        return commanded(law, 0.0 * state.altitude, measurement, *begin)

    acting = Traced(act, *3 * [state.altitude])
    angle = acting.independent(lambda out: out[0].angle_of_attack)
    if angle is None:
        angle = trim
    return _measured(scenario, moving, angle)


def first_moving(scenario: Scenario) -> Moving:
    """State and navigation at the start, before there is a command."""
    state = scenario.initial_state
    navigated = scenario.navigation.start(scenario.planet, state)
    return Moving(state, None, None, navigated=navigated)


@eqx.filter_jit
def start(scenario: Scenario, step: float) -> Lane:
    """The flight before its first step; `step` is the length of that step (s)."""
    state, known = scenario.initial_state, first_moving(scenario)
    measurement = first_measurement(scenario)
    memory, held = begun(scenario.law, measurement)
    flown = 0.0 * state.altitude
    conditions = scenario.termination
    margin = conditions.smallest_margin(
        flown, state, known.believed, scenario.planet, conditions.always
    )
    first, _ = commanded(scenario.law, flown, measurement, memory, held)
    integrals = {n: jnp.zeros_like(flown) for n in integrals_of(scenario.constraints)}
    attitude = scenario.attitude.init(first)
    moving = Moving(state, attitude, memory, integrals, navigated=known.navigated)
    point = path_point(scenario, flown, moving, held)
    aiding = scenario.navigation.begin(
        _actual(scenario, moving, point.controls), moving.navigated
    )
    peaks = constraint_values(scenario.constraints, point, integrals)
    beyond, refused = beyond_tables(scenario, point)
    first_instant = lax.stop_gradient(Instant(flown, state))
    at_peaks = {name: first_instant for name in scenario.located_peaks}
    at_edges = {n: Excursion(jnp.zeros_like(flown), x) for n, x in beyond.items()}
    running = jnp.asarray(margin > 0.0) & is_finite((moving, peaks)) & ~refused
    return Lane(
        flown=flown,
        moving=moving,
        held=held,
        noted=Noted(peaks, at_peaks, at_edges),
        bracket=Bracket(flown + step, margin, flown + jnp.inf, flown, flown + jnp.inf),
        running=running,
        stopped=jnp.where(refused, int(Outcome.BEYOND_TABLE), -1),
        aiding=aiding,
    )


@eqx.filter_jit
def navigate(scenario: Scenario, lane: Lane, due: Flag | None) -> Lane:
    """The flight after an update of its navigation, if one is due; None if it is."""
    navigation = scenario.navigation

    def actual() -> Actual:
        wish, _ = command(scenario, lane.flown, lane.moving, lane.held)
        controls = scenario.attitude.flown(lane.moving.attitude, wish)
        return _actual(scenario, lane.moving, controls)

    def update(known: tuple[Any, Any]) -> tuple[Any, Any]:
        return navigation.update(actual, *known, lane.flown, updates)

    updates = lane.on_schedule & (lane.flown > 0.0)
    known = lane.moving.navigated, lane.aiding
    if due is None:
        navigated, aiding = update(known)
    else:
        updates = updates & due
        navigated, aiding = lax.cond(any_lane(updates), update, lambda x: x, known)
    moving = dataclasses.replace(lane.moving, navigated=navigated)
    return dataclasses.replace(lane, moving=moving, aiding=aiding)


def knowledge(scenario: Scenario, lane: Lane) -> Knowledge | None:
    """The knowledge error of a flight; None with perfect navigation."""
    navigation, navigated = scenario.navigation, lane.moving.navigated
    if navigated is None or not isinstance(navigation, InertialNavigation):
        return None
    known = lane.state, navigated, lane.aiding, lane.flown
    return navigation.knowledge_of(scenario.planet, *known)


@eqx.filter_jit
def decide(scenario: Scenario, lane: Lane, due: Flag | None) -> Lane:
    """The flight after a decision of its sampled law, if a guidance cycle is due."""
    law = scenario.law
    if not isinstance(law, AbstractSampledLaw):
        return lane
    measurement = sense(scenario, lane.flown, lane.moving, lane.held, lane.flown)
    after = decided(law, lane.flown, measurement, lane.memory, lane.held)
    decides = lane.on_schedule if due is None else lane.on_schedule & due
    memory, held = select(decides, after, (lane.memory, lane.held))
    return eqx.tree_at(
        lambda lane: (lane.moving.memory, lane.held),
        lane,
        (memory, held),
        is_leaf=lambda x: x is None,
    )


@eqx.filter_jit
def command(
    scenario: Scenario, flown: Scalar, moving: Moving, held: Any
) -> tuple[Controls, Any]:
    """The command of the law, and the rate of its memory."""
    acting = _acting(scenario, flown, moving, held)
    measurement = _sensed(scenario, moving, acting)
    return acting(measurement.lift, measurement.drag, measurement.angle_of_attack)


def caveats(scenario: Scenario, lane: Lane) -> dict[str, Scalar]:
    """Caveats that a sampled law reports of its decisions, and shares of time beyond
    tables."""
    law = scenario.law
    said = law.caveats(lane.held) if isinstance(law, AbstractSampledLaw) else {}
    said = said | scenario.navigation.caveats(lane.aiding)
    # Shares count whole steps, so they have no derivative with respect to the end.
    flown = lax.stop_gradient(lane.flown)
    flies = flown > 0.0
    seconds = jnp.where(flies, flown, 1.0)
    # Before the first step the share is that of the initial state, 0 or 1.
    return said | {
        name: jnp.where(flies, beyond.time / seconds, 1.0 * (beyond.distance > 0.0))
        for name, beyond in lane.noted.beyond.items()
    }


def caveat_names(scenario: Scenario) -> list[str]:
    """Names of the caveats that flights of a scenario may have, without flying one."""
    return list(eqx.filter_eval_shape(lambda s: caveats(s, start(s, 1.0)), scenario))


def vector_field(scenario: Scenario, held: Any, aiding: Any = None):
    """Time derivative of the integrated quantities in a cycle, `field(flown, moving)`.

    `held` and `aiding` are what the law and the navigation hold.
    """
    dynamics, attitude = scenario.dynamics, scenario.attitude
    shared = shares_reversals(scenario.law)

    def field(flown: Scalar, moving: Moving) -> Moving:
        wish, memory_rate = command(scenario, flown, moving, held)
        # Checked in each stage, since the command is known there.
        off = wish.off_a_bank(shared)
        if moving.off_a_bank is None:
            wish, off = wish.unless(off > 0.0), None
        controls = attitude.flown(moving.attitude, wish)
        planet, vehicle = scenario.planet, scenario.vehicle
        rate = dynamics.rates(planet, vehicle, moving.state, controls)
        integrands = _integrands(scenario, moving, controls)
        turning = attitude.rate(moving.attitude, wish)
        navigated = _navigating(scenario, moving, controls, aiding)
        return Moving(rate, turning, memory_rate, integrands, off, navigated)

    return field


def _navigating(
    scenario: Scenario, moving: Moving, controls: Controls, aiding: Any
) -> Navigated | None:
    """Rate of the navigation; None where the vehicle knows its state."""
    if moving.navigated is None:
        return None
    actual = _actual(scenario, moving, controls)
    return scenario.navigation.rate(actual, moving.navigated, aiding)


def _actual(scenario: Scenario, moving: Moving, controls: Controls) -> Actual:
    return Actual(
        scenario.planet,
        scenario.vehicle,
        moving.state,
        controls,
        scenario.accelerometers,
        scenario.flow_sensors,
        scenario.angle_of_attack_error,
    )


def _integrands(
    scenario: Scenario, moving: Moving, controls: Controls
) -> dict[str, Scalar]:
    """Rates of the path constraints that are integrals, by name."""
    if not moving.integrals:
        return {}
    point, integrals = _point(scenario, moving, controls), moving.integrals
    found = integrals_of(scenario.constraints)
    return {name: found[name].rate(point) for name in integrals}


def _point(scenario: Scenario, moving: Moving, controls: Controls) -> PathPoint:
    planet, vehicle = scenario.planet, scenario.vehicle
    return PathPoint.of(planet, vehicle, moving.state, controls, scenario.dynamics)


def path_point(
    scenario: Scenario, flown: Scalar, moving: Moving, held: Any
) -> PathPoint:
    """The point of a flight at one instant, with the controls there."""
    wish, _ = command(scenario, flown, moving, held)
    controls = scenario.attitude.flown(moving.attitude, wish)
    return _point(scenario, moving, controls)


def path_constraints(
    scenario: Scenario, flown: Scalar, moving: Moving, held: Any
) -> ConstraintValues:
    """The constrained quantities at an instant of a flight."""
    point = path_point(scenario, flown, moving, held)
    return constraint_values(scenario.constraints, point, moving.integrals)


def beyond_tables(
    scenario: Scenario, point: PathPoint
) -> tuple[dict[str, Scalar], Flag]:
    """Distances of a point beyond the edges of the tables of planet and vehicle, by the
    name of the caveat, and whether a table refuses the point. Empty without tables.
    """
    found, refused = beyond_edges(
        tables_in(planet=scenario.planet, vehicle=scenario.vehicle),
        altitudes=point.state.altitude,
        mach_numbers=point.air.mach,
        angles_of_attack=point.controls.angle_of_attack,
    )
    return lax.stop_gradient((found, refused))


def noted(
    scenario: Scenario, lane: Lane, flown: Scalar, moving: Moving
) -> tuple[Noted, Flag]:
    """The record of a flight after a step to a state, and whether a table refuses it."""
    point = path_point(scenario, flown, moving, lane.held)
    now = constraint_values(scenario.constraints, point, moving.integrals)
    here = lax.stop_gradient(Instant(flown, moving.state))
    at_peaks = {
        name: select(now[name] > lane.noted.peaks[name], here, there)
        for name, there in lane.noted.at_peaks.items()
    }
    peaks = jax.tree.map(jnp.maximum, lane.noted.peaks, now)
    distances, refused = beyond_tables(scenario, point)
    seconds = lax.stop_gradient(flown - lane.flown)
    beyond = {
        name: Excursion(
            before.time + jnp.where(distances[name] > 0.0, seconds, 0.0),
            jnp.maximum(before.distance, distances[name]),
        )
        for name, before in lane.noted.beyond.items()
    }
    return Noted(peaks, at_peaks, beyond), refused


def constrained(
    scenario: Scenario, moving: Moving, controls: Controls
) -> ConstraintValues:
    """The constrained quantities at given controls."""
    point = _point(scenario, moving, controls)
    return constraint_values(scenario.constraints, point, moving.integrals)


def is_finite(y: Any) -> Flag:
    """Whether every number of a state is finite."""
    # A reduction of a scalar would prevent the fusion of the operations around it.
    leaves = [x if jnp.ndim(x) == 0 else jnp.sum(x) for x in jax.tree.leaves(y)]
    return jnp.isfinite(sum(leaves))


def select(condition: Flag, chosen: Any, otherwise: Any) -> Any:
    """`chosen` where the condition holds, and `otherwise` elsewhere, leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, otherwise)
