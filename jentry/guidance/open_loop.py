"""Open-loop laws: profiles of the controls without feedback."""

import jax.numpy as jnp

from ..fields import Scalar, optional_scalar
from ..motion.index import AbstractIndex
from ..motion.state import Controls
from ..onboard.measurement import Measurement
from ..onboard.profiles import AbstractProfile
from ..world.planet import Planet
from .lateral import AbstractLateralLogic, FixedSide
from .law import AbstractBankLaw, AbstractContinuousLaw


class BankProfile(AbstractBankLaw[None]):
    """Cosine of the bank as a function of velocity, at a constant angle of attack.

    The cosine is clipped to [-1, 1].
    """

    cos_bank: AbstractProfile
    """Cosine of the bank over velocity (m/s)"""
    angle_of_attack: Scalar | None = optional_scalar(unit="rad")
    """Angle of attack; None for the trim angle of attack"""
    lateral: AbstractLateralLogic = FixedSide()

    def init(self, measurement: Measurement) -> None:
        return None

    def to_the_right(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        cos_bank = self.cos_bank(measurement.state.velocity)
        angle = self.angle_of_attack
        angle = measurement.trim_angle_of_attack if angle is None else angle
        return vertical_lift_command(cos_bank, angle), None


def vertical_lift_command(cos_bank: Scalar, angle_of_attack: Scalar) -> Controls:
    """Command that banks to the right, with the cosine clipped to [-1, 1].

    The sine has derivative zero where the cosine is clipped.
    """
    clipped = jnp.clip(cos_bank, -1.0, 1.0)
    inside = jnp.abs(clipped) < 1.0
    sine = jnp.sqrt(jnp.where(inside, 1.0 - clipped * clipped, 1.0))
    return Controls(angle_of_attack, clipped, jnp.where(inside, sine, 0.0))


class ControlProfiles(AbstractContinuousLaw[None]):
    """Angle of attack and signed bank as functions of an index, such as the energy."""

    index: AbstractIndex
    planet: Planet
    """Planet for which the index is evaluated, such as that of an onboard model"""
    angle_of_attack: AbstractProfile | None
    """rad, over the index; None for the trim angle of attack, or for that of the law with
    which this one is composed, see `compose`"""
    bank: AbstractProfile
    """rad, over the index; positive to the right"""

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        here = self.index.value(self.planet, time, measurement.state)
        angle = measurement.trim_angle_of_attack
        if self.angle_of_attack is not None:
            angle = self.angle_of_attack(here)
        return Controls.from_bank(self.bank(here), angle), None
