"""The closed loop: vehicle, measurement and law as one system of equations."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._batching import any_lane
from ..fields import Flag, Scalar
from ..guidance.law import AbstractSampledLaw, begun, commanded, decided
from ..guidance.switching import shares_reversals
from ..motion.constraints import (
    ConstraintValues,
    PathPoint,
    constraint_values,
    integrals_of,
)
from ..motion.dynamics import Motion
from ..motion.state import Controls, EntryState
from ..onboard.inertial import (
    Actual,
    Directions,
    Navigated,
    in_equator,
    rate_in_equator,
)
from ..onboard.navigation import InertialNavigation
from ..onboard.navigation_filter import Knowledge
from ..world.tabulated import Excursion, beyond_edges, tables_in
from .lane import Bracket, Instant, Lane, Moving, Noted
from .scenario import Scenario
from .sensing import command, first_measurement, first_moving, sense
from .termination import Outcome


def guidance_period(scenario: Scenario) -> float | None:
    """Longest guidance cycle of a sampled law, s; none for a continuous one."""
    law = scenario.law
    return law.cycle.period if isinstance(law, AbstractSampledLaw) else None


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
    moving = Moving(
        known.motion, attitude, memory, integrals, navigated=known.navigated
    )
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
        navigated, aiding = navigation.update(actual, *known, lane.flown, updates)
        if navigated is not None and not scenario.dynamics.has_crossrange:
            navigated = select(updates, in_equator(navigated), navigated)
        return navigated, aiding

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
        rate = dynamics.motion_rates(planet, vehicle, moving.motion, controls)
        integrands = _integrands(scenario, moving, controls)
        turning = attitude.rate(moving.attitude, wish)
        navigated = _navigating(scenario, moving, controls, aiding)
        directions = _directing(moving, rate, navigated)
        return Moving(
            rate, turning, memory_rate, integrands, off, navigated, directions
        )

    return field


def _navigating(
    scenario: Scenario, moving: Moving, controls: Controls, aiding: Any
) -> Navigated | None:
    """Rate of the navigation; None where the vehicle knows its state."""
    if moving.navigated is None:
        return None
    actual = _actual(scenario, moving, controls)
    rate = scenario.navigation.rate(actual, moving.navigated, aiding)
    return rate if scenario.dynamics.has_crossrange else rate_in_equator(rate)


def _directing(
    moving: Moving, actual: Motion, navigated: Navigated | None
) -> Directions | None:
    """Rate of the sines and cosines, from those of the motion and of the navigation."""
    if moving.directions is None or navigated is None:
        return None
    assert isinstance(actual, EntryState)  # the scenario has been checked
    return moving.directions.rate(actual, navigated.state)


def _actual(scenario: Scenario, moving: Moving, controls: Controls) -> Actual:
    return Actual(
        scenario.planet,
        scenario.vehicle,
        moving.state,
        controls,
        scenario.accelerometers,
        scenario.flow_sensors,
        scenario.angle_of_attack_error,
        moving.directions,
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
        altitudes=scenario.planet.geodetic_altitude(
            point.state.altitude, point.state.latitude
        ),
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
