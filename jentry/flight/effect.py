"""Numbers that a flight depends on, found in its equations without flying."""

import functools
from collections.abc import Callable, Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import partial_eval

from ..addresses import leaves_by_address
from ..guidance.law import AbstractSampledLaw
from ..motion.constraints import integrals_of
from ..motion.state import Controls
from ..onboard.measurement import measure
from .closed_loop import (
    constrained,
    decide,
    navigate,
    path_constraints,
    start,
    vector_field,
)
from .lane import Moving
from .scenario import Scenario
from .scenario_checks import without_effect


def require_felt(scenario: Scenario, addresses: Iterable[str]) -> None:
    """Refuse numbers that no equation of the flight uses, such as some of an onboard model.

    The law is examined only for numbers that motion and sensors do not use, since that
    takes much longer.
    """
    # The other numbers of the target affect the misses.
    wanted = {a for a in addresses if not a.startswith("target.") or _is_place(a)}
    for equations in (_motion_and_sensors, _guidance):
        if wanted:
            wanted -= _used(equations, scenario)
    for address in sorted(wanted):
        if _is_place(address):
            raise ValueError(
                f"{address} would move the target and not the flight: "
                f"{type(scenario.guidance).__name__} does not read where the target is. "
                "Plan its reference for another target, or fly a law that reads it, such "
                "as PredictorCorrector"
            )
        raise ValueError(
            f"{address} has no effect in this scenario: no equation of its flight uses it"
        )


def _is_place(address: str) -> bool:
    """Whether a number is part of the place of the target."""
    return address in ("target.downrange", "target.crossrange") or address.startswith(
        "target.origin."
    )


def unfelt(scenario: Scenario) -> tuple[str, ...]:
    """Addresses of the numbers that no equation of the flight uses, in their order."""
    used = _used(_motion_and_sensors, scenario) | _used(_guidance, scenario)
    idle = without_effect(scenario)
    return tuple(
        address
        for address in leaves_by_address(scenario)
        if address in idle
        or (address not in used and not address.startswith("target."))
    )


def _used(equations: Callable[[Scenario], Any], scenario: Scenario) -> set[str]:
    """Addresses of the leaves on which the results of `equations` depend."""
    scenario = jax.tree.map(_of_jax, scenario)
    arrays, others = eqx.partition(scenario, eqx.is_array)
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in jax.tree.leaves(arrays)]
    rest = jax.tree.flatten(others)
    of_shapes = (jax.tree.structure(arrays), tuple(shapes), rest[1], tuple(rest[0]))
    used = _inputs_used(equations, *of_shapes)
    return {
        a
        for a, is_used in zip(leaves_by_address(scenario), used, strict=True)
        if is_used
    }


def _of_jax(leaf: Any) -> Any:
    """The leaf as an array of JAX: a law of a user may hold NumPy arrays, which have no
    hash."""
    return jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf


@functools.lru_cache(maxsize=64)
def _inputs_used(equations, structure, shapes, other_structure, others) -> list[bool]:
    """Whether each array is used, in their order; equal for all scenarios of one
    structure."""
    others = jax.tree.unflatten(other_structure, others)

    def computed(leaves):
        scenario = eqx.combine(jax.tree.unflatten(structure, leaves), others)
        found = jax.tree.leaves(equations(scenario))
        return [x for x in found if eqx.is_array(x)]

    jaxpr = jax.make_jaxpr(computed)(list(shapes)).jaxpr
    return partial_eval.dce_jaxpr(jaxpr, [True] * len(jaxpr.outvars))[1]


def _motion_and_sensors(scenario: Scenario) -> Any:
    """Results of motion and sensors for the initial state and given controls."""
    planet, vehicle, state = scenario.planet, scenario.vehicle, scenario.initial_state
    time = 0.0 * state.altitude
    sampled_at = time if isinstance(scenario.law, AbstractSampledLaw) else None
    controls = Controls(0.1, 0.8, 0.6)
    integrals = {n: time for n in integrals_of(scenario.constraints)}
    motion = scenario.dynamics.integrated(state)
    moving = Moving(motion, None, None, integrals)
    sensors, angle = scenario.accelerometers, controls.angle_of_attack
    sensed = measure(
        planet,
        vehicle,
        state,
        angle,
        sensors,
        sampled_at,
        flow_sensors=scenario.flow_sensors,
    )
    return (
        state,
        scenario.dynamics.motion_rates(planet, vehicle, motion, controls),
        constrained(scenario, moving, controls),
        scenario.termination.margins(time, state, state, planet),
        sensed.lift,
        sensed.drag,
        sensed.air_velocity,
    )


def _guidance(scenario: Scenario) -> Any:
    """All results of one guidance cycle."""
    lane = start(scenario, 1.0)
    if scenario.navigation.cycle is not None:
        lane = navigate(scenario, lane, None)
    lane = decide(scenario, lane, None)
    law = scenario.law
    return (
        lane,
        law.cycle.seconds(lane.held) if isinstance(law, AbstractSampledLaw) else None,
        vector_field(scenario, lane.held, lane.aiding)(lane.flown, lane.moving),
        path_constraints(scenario, lane.flown, lane.moving, lane.held),
    )
