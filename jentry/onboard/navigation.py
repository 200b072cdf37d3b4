"""What the vehicle measures of its own flight."""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, scalar
from ..motion.attitude import Swing
from ..motion.constraints import Constraints
from ..motion.forces import AirData, air_data
from ..motion.state import EntryState
from ..world.planet import Planet
from ..world.vehicle import Vehicle


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
    noise_seed: Scalar = scalar(0.0, choice=True)
    """A number between 0 and 1 that chooses the noise of this flight; disperse it with
    `Uniform(0, 1)`"""

    def read(self, air: AirData, sampled_at: Scalar | None) -> tuple[Scalar, Scalar]:
        lift = air.lift * (1.0 + self.lift_scale_error) + self.lift_bias
        drag = air.drag * (1.0 + self.drag_scale_error) + self.drag_bias
        if sampled_at is None:
            return lift, drag
        seed = jnp.asarray(self.noise_seed * 2.0**31).astype(jnp.uint32)
        millisecond = jnp.round(1e3 * jnp.asarray(sampled_at)).astype(jnp.uint32)
        key = jax.random.fold_in(
            jax.random.fold_in(jax.random.key(0), seed), millisecond
        )

        def error(axis: int) -> Scalar:
            # Drawn alone: read out of one array for both, side by side with other runs,
            # the compiler treats the last runs of a block in another way than the rest.
            return self.noise * jax.random.normal(
                jax.random.fold_in(key, axis), dtype=float
            )

        return lift + error(0), drag + error(1)


def measure(
    planet: Planet,
    vehicle: Vehicle,
    state: EntryState,
    angle_of_attack: Scalar,
    accelerometers: AbstractAccelerometers = PerfectAccelerometers(),
    sampled_at: Scalar | None = None,
    constraints: Constraints | None = None,
    bank: Swing | None = None,
) -> Measurement:
    """Perfect navigation, and the accelerometers, at an angle of attack (rad).

    `sampled_at` as of `AbstractAccelerometers.read`; `constraints` and `bank` are told as
    they are.
    """
    air = air_data(planet, vehicle, state, angle_of_attack)
    lift, drag = accelerometers.read(air, sampled_at)
    trim = vehicle.trim_angle_of_attack
    return Measurement(
        state, lift, drag, angle_of_attack, trim, constraints or {}, bank
    )
