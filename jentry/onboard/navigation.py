"""Measurements of the vehicle."""

from abc import abstractmethod

import equinox as eqx

from ..fields import NOT_NEGATIVE, Scalar, scalar
from ..motion.attitude import Swing
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


class AbstractAccelerometers(eqx.Module):
    """Sensing of the specific forces."""

    @abstractmethod
    def read(self, air: AirData, sampled_at: Scalar | None) -> tuple[Scalar, Scalar]:
        """Sensed lift and drag, m/s2.

        **Arguments:**

        - `sampled_at`: time of the sample, s; None between samples.
        """


class PerfectAccelerometers(AbstractAccelerometers):
    """Accelerometers without errors: the actual forces."""

    def read(self, air: AirData, sampled_at: Scalar | None) -> tuple[Scalar, Scalar]:
        return air.lift, air.drag


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

    def read(self, air: AirData, sampled_at: Scalar | None) -> tuple[Scalar, Scalar]:
        lift = air.lift * (1.0 + self.lift_scale_error) + self.lift_bias
        drag = air.drag * (1.0 + self.drag_scale_error) + self.drag_bias
        if sampled_at is None:
            return lift, drag
        error = normal_sample(self.noise_seed, sampled_at)
        return lift + self.noise * error(0), drag + self.noise * error(1)


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
) -> Measurement:
    """Measurement with perfect navigation, and with accelerometers and flow sensors.

    `angle_of_attack` is the actual one, rad. `sampled_at` is that of
    `AbstractAccelerometers.read`. `constraints` and `bank` are passed on unchanged.
    """
    air = air_data(planet, vehicle, state, angle_of_attack)
    lift, drag = accelerometers.read(air, sampled_at)
    trim = vehicle.trim_angle_of_attack
    flow = None
    if flow_sensors is not None and sampled_at is not None:
        flow = flow_sensors.read(planet, state, air, sampled_at)
    return Measurement(
        state, lift, drag, angle_of_attack, trim, constraints or {}, bank, flow
    )
