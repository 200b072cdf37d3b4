"""Flying a bank profile without feedback."""

import jax.numpy as jnp

from ..fields import Scalar, optional_scalar
from ..motion.state import Controls
from ..onboard.navigation import Measurement
from ..onboard.profiles import AbstractProfile
from .law import AbstractContinuousLaw


class BankProfile(AbstractContinuousLaw[None]):
    """Cosine of the bank as a function of velocity, at one angle of attack.

    Bank is to the right throughout, and its cosine is clipped to [-1, 1].
    """

    cos_bank: AbstractProfile
    """Over velocity, m/s"""
    angle_of_attack: Scalar | None = optional_scalar(unit="rad")
    """None for that at which the vehicle trims"""

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        cos_bank = self.cos_bank(measurement.state.velocity)
        angle = self.angle_of_attack
        angle = measurement.trim_angle_of_attack if angle is None else angle
        return vertical_lift_command(cos_bank, angle), None


def vertical_lift_command(
    cos_bank: Scalar, angle_of_attack: Scalar, sign: Scalar | float = 1.0
) -> Controls:
    """Bank with a wanted cosine, the wish clipped to [-1, 1]; to the right by default.

    A `sign` of -1 banks to the left. The sine has derivative zero where the wish is
    clipped.
    """
    clipped = jnp.clip(cos_bank, -1.0, 1.0)
    inside = jnp.abs(clipped) < 1.0
    sine = jnp.sqrt(jnp.where(inside, 1.0 - clipped * clipped, 1.0))
    return Controls(angle_of_attack, clipped, sign * jnp.where(inside, sine, 0.0))
