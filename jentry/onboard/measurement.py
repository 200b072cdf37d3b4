"""Measurements of the vehicle."""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx

from .._math import sincos
from ..fields import NOT_NEGATIVE, Scalar, scalar
from ..motion.attitude import Swing
from ..motion.axes import Components
from ..motion.constraints import Constraints
from ..motion.forces import AirData, air_data
from ..motion.state import EntryState
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .flow_sensing import AirVelocity, FlowSensors
from .sampling import normal_sample


class Measurement(eqx.Module):
    """Everything that a law knows of the true flight, with its path constraints."""

    state: EntryState
    """What navigation believes: see `Scenario.navigation`"""
    lift: Scalar
    """Sensed specific force normal to the relative wind, m/s2"""
    drag: Scalar
    """Sensed specific force along the relative wind, m/s2"""
    angle_of_attack: Scalar
    """Actual angle of attack, at which the forces are sensed, rad"""
    trim_angle_of_attack: Scalar
    """Angle of attack at which the vehicle trims if its law does not command one, rad"""
    constraints: Constraints = eqx.field(default_factory=dict)
    """Path constraints of the scenario, whose limits the law should respect"""
    bank: Swing | None = None
    """Actual bank, positive to the right, and its motion; None if commands take effect at
    once, and before the first one"""
    air_velocity: AirVelocity | None = None
    """Velocity over the air, sensed at a guidance cycle; None between cycles, and if the
    scenario has no flow sensors"""


class SpecificForce(NamedTuple):
    """Sensed specific force, about the velocity relative to the air, m/s2."""

    lift: Scalar
    """In the plane of symmetry of the vehicle, normal to the relative wind"""
    drag: Scalar
    """Along the relative wind"""
    side: Scalar | float = 0.0
    """To the right of the plane of symmetry: actually zero"""


class AbstractAccelerometers(eqx.Module):
    """Sensing of the specific forces."""

    @abstractmethod
    def read(self, air: AirData, sampled_at: Scalar | None) -> SpecificForce:
        """Sensed specific force.

        **Arguments:**

        - `sampled_at`: time of the sample, s; None between samples.
        """


class PerfectAccelerometers(AbstractAccelerometers):
    """Accelerometers without errors: the actual forces."""

    def read(self, air: AirData, sampled_at: Scalar | None) -> SpecificForce:
        return SpecificForce(air.lift, air.drag)


class Accelerometers(AbstractAccelerometers):
    """Two accelerometers, along and normal to the relative wind, with separate errors."""

    lift_bias: Scalar = scalar(0.0, unit="m/s2")
    drag_bias: Scalar = scalar(0.0, unit="m/s2")
    lift_scale_error: Scalar = scalar(0.0)
    """Share of the force"""
    drag_scale_error: Scalar = scalar(0.0)
    noise: Scalar = scalar(0.0, unit="m/s2", range=NOT_NEGATIVE)
    """Standard deviation of a sample; the samples are independent"""
    noise_seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1 that selects the noise of this flight; disperse it with
    `Uniform(0, 1)`"""

    def read(self, air: AirData, sampled_at: Scalar | None) -> SpecificForce:
        lift = air.lift * (1.0 + self.lift_scale_error) + self.lift_bias
        drag = air.drag * (1.0 + self.drag_scale_error) + self.drag_bias
        if sampled_at is None:
            return SpecificForce(lift, drag)
        error = normal_sample(self.noise_seed, sampled_at)
        return SpecificForce(lift + self.noise * error(0), drag + self.noise * error(1))


class BodyAccelerometers(AbstractAccelerometers):
    """Three accelerometers that are fixed to the vehicle: forward, to the right and down.

    The axis forward is above the velocity over the air by the angle of attack. Sensed is
    the actual force with a bias and a scale error of each, in axes that are turned from
    those of the vehicle by small angles.
    """

    bias_forward: Scalar = scalar(0.0, unit="m/s2")
    bias_right: Scalar = scalar(0.0, unit="m/s2")
    bias_down: Scalar = scalar(0.0, unit="m/s2")
    scale_error_forward: Scalar = scalar(0.0)
    """Share of the force; to the right there is none"""
    scale_error_down: Scalar = scalar(0.0)
    misalignment_roll: Scalar = scalar(0.0, unit="rad")
    """Turn of the instrument about the axis forward"""
    misalignment_pitch: Scalar = scalar(0.0, unit="rad")
    """Turn about the axis to the right"""
    misalignment_yaw: Scalar = scalar(0.0, unit="rad")
    """Turn about the axis down"""

    def read(self, air: AirData, sampled_at: Scalar | None) -> SpecificForce:
        sine, cosine = sincos(air.angle_of_attack)

        def seen(forward: Scalar, right: Scalar, down: Scalar) -> Components:
            """Components along the lift, along the drag and to the right."""
            lift, drag = forward * sine - down * cosine, -forward * cosine - down * sine
            return lift, drag, right

        def off(forward: Scalar, down: Scalar) -> Components:
            """What the instruments add to a force without their bias: turned axes sense
            of a vector it, less the turn times it."""
            return seen(
                self.scale_error_forward * forward - self.misalignment_pitch * down,
                self.misalignment_roll * down - self.misalignment_yaw * forward,
                self.scale_error_down * down + self.misalignment_pitch * forward,
            )

        # The errors by a unit of lift and of drag change only with the angle of attack:
        # where it is constant, the compiler computes them once.
        biases = seen(self.bias_forward, self.bias_right, self.bias_down)
        lift, drag, side = (
            bias + by_lift * air.lift + by_drag * air.drag
            for bias, by_lift, by_drag in zip(
                biases, off(sine, -cosine), off(-cosine, -sine), strict=True
            )
        )
        return SpecificForce(air.lift + lift, air.drag + drag, side)


def measure(
    planet: Planet,
    vehicle: Vehicle,
    state: EntryState,
    angle_of_attack: Scalar,
    accelerometers: AbstractAccelerometers = PerfectAccelerometers(),
    sampled_at: Scalar | None = None,
    constraints: Constraints | None = None,
    bank: Swing | None = None,
    flow_sensors: FlowSensors | None = None,
    believed: EntryState | None = None,
) -> Measurement:
    """Measurement with accelerometers and flow sensors, and with what navigation believes.

    `angle_of_attack` is the actual one, rad. `sampled_at` is that of
    `AbstractAccelerometers.read`. `constraints` and `bank` are passed on unchanged.
    `believed` is the state of the navigation; None for the actual one.
    """
    air = air_data(planet, vehicle, state, angle_of_attack)
    lift, drag, _ = accelerometers.read(air, sampled_at)
    trim = vehicle.trim_angle_of_attack
    flow = None
    if flow_sensors is not None and sampled_at is not None:
        flow = flow_sensors.read(planet, state, air, sampled_at)
    known = state if believed is None else believed
    return Measurement(
        known, lift, drag, angle_of_attack, trim, constraints or {}, bank, flow
    )
