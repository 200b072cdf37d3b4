"""Flow sensors: measurement of the velocity over the air."""

import equinox as eqx
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Flag, Scalar, scalar
from ..motion.forces import AirData, velocity_over_air, wind_at
from ..motion.state import EntryState
from ..world.planet import Planet
from .sampling import normal_sample


class AirVelocity(eqx.Module):
    """Sensed velocity relative to the air, m/s."""

    east: Scalar
    north: Scalar
    up: Scalar
    is_sensed: Flag
    """Whether there is a measurement; otherwise the numbers are meaningless"""

    @property
    def speed(self) -> Scalar:
        """m/s."""
        return jnp.sqrt(self.east**2 + self.north**2 + self.up**2)

    def axes(self) -> tuple[tuple[Scalar, Scalar, Scalar], ...]:
        """Unit vectors (east, north, up) along the velocity, to its right, and above it."""
        speed, ground = self.speed, jnp.sqrt(self.east**2 + self.north**2)
        along = self.east / speed, self.north / speed, self.up / speed
        right = self.north / ground, -self.east / ground, jnp.zeros_like(ground)
        rises = along[2] / ground
        above = -self.east * rises, -self.north * rises, ground / speed
        return along, right, above


class FlowSensors(eqx.Module):
    """Flush air data: speed and direction of the flow, where they can be sensed.

    A law receives the measurement at its guidance cycles. The errors are shares of the
    airspeed along the flow, and angles across it. In m/s they are therefore large at high
    velocity: half a degree is a side wind of 44 m/s at 5 km/s, and of 4 m/s at 500 m/s.
    """

    speed_scale_error: Scalar = scalar(0.0)
    """Share of the airspeed"""
    side_error: Scalar = scalar(0.0, unit="rad")
    """Angle by which the sensed velocity over the air points too far to the right"""
    rise_error: Scalar = scalar(0.0, unit="rad")
    """Angle by which the sensed velocity over the air points too far up"""
    noise: Scalar = scalar(0.0, range=NOT_NEGATIVE)
    """Standard deviation of a sample of the speed, as a share of it, and of each angle,
    rad; the samples are independent"""
    noise_seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1 that selects the noise of this flight; disperse it with
    `Uniform(0, 1)`"""
    largest_mach: Scalar = scalar(20.0, positive=True)
    """Mach number above which nothing is sensed"""
    least_dynamic_pressure: Scalar = scalar(850.0, unit="Pa", range=NOT_NEGATIVE)
    """Dynamic pressure below which nothing is sensed"""

    def read(
        self, planet: Planet, state: EntryState, air: AirData, sampled_at: Scalar
    ) -> AirVelocity:
        """Sample at a time, s."""
        senses = air.mach <= self.largest_mach
        senses &= air.dynamic_pressure >= self.least_dynamic_pressure
        actual = AirVelocity(*velocity_over_air(wind_at(planet, state), state), senses)
        noise = normal_sample(self.noise_seed, sampled_at)
        errors = self.speed_scale_error, self.side_error, self.rise_error
        shares = [
            error + self.noise * noise(axis)
            for axis, error in enumerate(errors, _FIRST_AXIS)
        ]
        along, right, above = actual.axes()
        east, north, up = (
            actual.speed * (a + shares[0] * a + shares[1] * r + shares[2] * b)
            for a, r, b in zip(along, right, above, strict=True)
        )
        return AirVelocity(east, north, up, senses)


_FIRST_AXIS = 2
"""First noise axis, after those of the accelerometers: the noise differs for equal seeds"""
