"""What the vehicle measures, and what its law commands then."""

from typing import Any

import equinox as eqx

from .._dependence import Traced
from ..fields import Scalar
from ..guidance.law import AbstractSampledLaw, begun, commanded
from ..motion.attitude import Swing
from ..motion.state import Controls
from ..onboard.inertial import in_equator
from ..onboard.measurement import Measurement, measure
from .lane import Moving
from .scenario import Scenario


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
    if navigated is not None and not scenario.dynamics.has_crossrange:
        navigated = in_equator(navigated)
    motion = scenario.dynamics.integrated(state)
    return Moving(motion, None, None, navigated=navigated)


@eqx.filter_jit
def command(
    scenario: Scenario, flown: Scalar, moving: Moving, held: Any
) -> tuple[Controls, Any]:
    """The command of the law, and the rate of its memory."""
    acting = _acting(scenario, flown, moving, held)
    measurement = _sensed(scenario, moving, acting)
    return acting(measurement.lift, measurement.drag, measurement.angle_of_attack)
