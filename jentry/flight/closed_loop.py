"""The closed loop: vehicle, measurement and law as one system of equations.

Only this file asks which of the two kinds a law is.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._types import Flag, Scalar
from ..guidance.law import AbstractContinuousLaw, AbstractSampledLaw
from ..motion.dynamics import entry_dynamics, equatorial_dynamics
from ..motion.forces import air_data
from ..motion.quantities import convective_heat_rate, load_factor
from ..motion.state import Controls, EntryState
from ..onboard.navigation import Measurement, measure
from .scenario import Scenario


class Peaks(eqx.Module):
    """Largest values of the path constraints so far."""

    drag: Scalar
    """m/s2"""
    dynamic_pressure: Scalar
    """Pa"""
    heat_rate: Scalar
    """W/m2, at the stagnation point"""
    load_factor: Scalar
    """In units of 9.80665 m/s2"""


class Bracket(eqx.Module):
    """Where the fixed-step solver tries to go next, and what it knows of the end."""

    trial: Scalar
    """Length of the next step, s"""
    margin: Scalar
    """Smallest margin of the end conditions now"""
    far: Scalar
    """A step of this length is known to cross the end, s; infinite while none is"""
    far_margin: Scalar
    """Smallest margin there"""
    allowed: Scalar
    """`far` is at most this after the next step, s"""


class Lane(eqx.Module):
    """A flight on its way: all that the loop carries."""

    flown: Scalar
    """s since the start"""
    state: EntryState
    memory: Any
    held: Any
    peaks: Peaks
    bracket: Bracket
    running: Flag
    singular: Flag
    """Stopped since a step came too close to a singular point of the equations of motion"""

    @property
    def on_schedule(self) -> Flag:
        """Running, and not yet in the step that holds the end."""
        return self.running & jnp.isinf(self.bracket.far)


def guidance_period(scenario: Scenario) -> float | None:
    """Guidance cycle of a sampled law, s; none for a continuous one."""
    law = scenario.guidance
    return law.period if isinstance(law, AbstractSampledLaw) else None


def sense(
    scenario: Scenario,
    state: EntryState,
    memory: Any = None,
    held: Any = None,
    sampled_at: Scalar | None = None,
) -> Measurement:
    """What the vehicle measures in a state, at the angle of attack that it flies.

    Without memory, before the first command, that is the trim angle of attack.
    `sampled_at` (s) is given at the start of a guidance cycle.
    """
    law, vehicle = scenario.guidance, scenario.vehicle
    angle_of_attack = None
    if isinstance(law, AbstractSampledLaw) and memory is not None:
        angle_of_attack = law.angle_of_attack(state, memory, held)
    if angle_of_attack is None:
        angle_of_attack = vehicle.trim_angle_of_attack
    return measure(
        scenario.planet,
        vehicle,
        state,
        angle_of_attack,
        scenario.accelerometers,
        sampled_at,
    )


def start(scenario: Scenario, step: float) -> Lane:
    """The flight before its first step, which will be of a length (s)."""
    state = scenario.initial_state
    measurement = sense(scenario, state)
    law = scenario.guidance
    if isinstance(law, AbstractSampledLaw):
        memory, held = law.init(measurement)
    else:
        assert isinstance(law, AbstractContinuousLaw)
        memory, held = law.init(measurement), None
    flown = 0.0 * state.altitude
    conditions = scenario.termination
    margin = conditions.smallest_margin(flown, state, conditions.always)
    controls, _ = command(scenario, flown, state, memory, held)
    peaks = path_constraints(scenario, state, controls)
    running = (margin > 0.0) & is_finite((state, memory, peaks))
    return Lane(
        flown=flown,
        state=state,
        memory=memory,
        held=held,
        peaks=peaks,
        bracket=Bracket(flown + step, margin, flown + jnp.inf, flown, flown + jnp.inf),
        running=running,
        singular=jnp.zeros_like(running),
    )


def decide(scenario: Scenario, lane: Lane, due: Flag | None) -> Lane:
    """Start of a guidance cycle: what a sampled law decides, if the cycle is due."""
    law = scenario.guidance
    if not isinstance(law, AbstractSampledLaw):
        return lane
    state, memory, held = lane.state, lane.memory, lane.held
    measurement = sense(scenario, state, memory, held, lane.flown)
    decided = law.update(lane.flown, measurement, lane.memory, lane.held)
    decides = lane.on_schedule if due is None else lane.on_schedule & due
    memory, held = select(decides, decided, (lane.memory, lane.held))
    return eqx.tree_at(
        lambda lane: (lane.memory, lane.held),
        lane,
        (memory, held),
        is_leaf=lambda x: x is None,
    )


def command(
    scenario: Scenario, flown: Scalar, state: EntryState, memory: Any, held: Any
) -> tuple[Controls, Any]:
    """What the law commands, and the rate of its memory."""
    law = scenario.guidance
    measurement = sense(scenario, state, memory, held)
    if isinstance(law, AbstractSampledLaw):
        return law(flown, measurement, memory, held)
    assert isinstance(law, AbstractContinuousLaw)
    return law(flown, measurement, memory)


def caveats(scenario: Scenario, held: Any) -> dict[str, Scalar]:
    """What a sampled law says of how it decided."""
    law = scenario.guidance
    return law.caveats(held) if isinstance(law, AbstractSampledLaw) else {}


def vector_field(scenario: Scenario, held: Any):
    """Time derivative of motion and memory within a cycle, `field(flown, y)`."""
    dynamics = equatorial_dynamics if scenario.in_plane else entry_dynamics

    def field(flown: Scalar, y: tuple[EntryState, Any]) -> tuple[EntryState, Any]:
        state, memory = y
        controls, memory_rate = command(scenario, flown, state, memory, held)
        rate = dynamics(scenario.planet, scenario.vehicle, state, controls)
        return rate, memory_rate

    return field


def path_constraints(
    scenario: Scenario, state: EntryState, controls: Controls
) -> Peaks:
    """The constrained quantities in a state."""
    planet, vehicle = scenario.planet, scenario.vehicle
    air = air_data(planet, vehicle, state, controls.angle_of_attack)
    return Peaks(
        drag=air.drag,
        dynamic_pressure=air.dynamic_pressure,
        heat_rate=convective_heat_rate(
            air.density,
            air.airspeed,
            vehicle.nose_radius,
            planet.heating_coefficient,
            planet.heating_exponent,
        ),
        load_factor=load_factor(air),
    )


def is_finite(y: Any) -> Flag:
    """Whether every number of a state is finite."""
    # A reduction of a scalar would stand between operations that belong together.
    leaves = [x if jnp.ndim(x) == 0 else jnp.sum(x) for x in jax.tree.leaves(y)]
    return jnp.isfinite(sum(leaves))


def select(condition: Flag, chosen: Any, otherwise: Any) -> Any:
    """Leaf by leaf, `chosen` where the condition holds."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, otherwise)
