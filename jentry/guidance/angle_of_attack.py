"""Angle-of-attack laws, which are composed with a law for the bank."""

from ..fields import Scalar
from ..onboard.measurement import Measurement
from ..onboard.profiles import AbstractProfile
from .law import AbstractContinuousLaw, AngleOfAttackCommand


class TrimAngleOfAttack(AbstractContinuousLaw[None]):
    """The angle of attack at which the vehicle trims, as with a bank law alone."""

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[AngleOfAttackCommand, None]:
        return AngleOfAttackCommand(measurement.trim_angle_of_attack), None


class AngleOfAttackProfile(AbstractContinuousLaw[None]):
    """Angle of attack as a function of the velocity; a constant is a polynomial."""

    angle_of_attack: AbstractProfile
    """rad over m/s"""

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[AngleOfAttackCommand, None]:
        angle = self.angle_of_attack(measurement.state.velocity)
        return AngleOfAttackCommand(angle), None
