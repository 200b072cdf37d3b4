"""What the vehicle measures of its own flight."""

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
    """All that a law is told of the true flight, and of what it may not exceed."""

    state: EntryState
    lift: Scalar
    """Sensed specific force across the relative wind, m/s2"""
    drag: Scalar
    """Sensed specific force along the relative wind, m/s2"""
    angle_of_attack: Scalar
    """Angle of attack that is flown, at which the forces are sensed, rad"""
    trim_angle_of_attack: Scalar
    """Angle of attack at which the vehicle flies where its law leaves it alone, rad"""
    constraints: Constraints = eqx.field(default_factory=dict)
    """Those of the scenario: what the law has to keep below their limits"""
    bank: Swing | None = None
    """Bank that is flown, positive to the right, and how it turns; None where commands are
    flown at once, and before the first one"""
    air_velocity: AirVelocity | None = None
    """Velocity over the air as sensed at a guidance cycle; None between cycles, and where
    the scenario has no flow sensors"""


class AbstractAccelerometers(eqx.Module):
    """What is sensed of the specific forces."""

    @abstractmethod
    def read(self, air: AirData, sampled_at: Scalar | None) -> tuple[Scalar, Scalar]:
        """Lift and drag, m/s2.

        **Arguments:**

        - `sampled_at`: time of the sample, s; none where it is read between samples.
        """


class PerfectAccelerometers(AbstractAccelerometers):
    """The actual forces."""

    def read(self, air: AirData, sampled_at: Scalar | None) -> tuple[Scalar, Scalar]:
        return air.lift, air.drag


class Accelerometers(AbstractAccelerometers):
    """One along and one across the relative wind, each with errors of its own."""

    lift_bias: Scalar = scalar(0.0, unit="m/s2")
    drag_bias: Scalar = scalar(0.0, unit="m/s2")
    lift_scale_error: Scalar = scalar(0.0)
    """Share of the force"""
    drag_scale_error: Scalar = scalar(0.0)
    noise: Scalar = scalar(0.0, unit="m/s2", range=NOT_NEGATIVE)
    """Standard deviation of a sample; the samples are independent"""
    noise_seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1 that chooses the noise of this flight; disperse it with
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
    """Perfect navigation, accelerometers and flow sensors, at an angle of attack (rad).

    `sampled_at` as of `AbstractAccelerometers.read`; `constraints` and `bank` are told as
    they are.
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
