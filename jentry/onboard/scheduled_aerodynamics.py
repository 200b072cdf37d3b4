"""Aerodynamics along an angle-of-attack schedule, for laws that assume a constant angle."""

from ..fields import Scalar
from ..world.aerodynamics import AbstractAerodynamics
from .profiles import AbstractProfile


class ScheduledAerodynamics(AbstractAerodynamics):
    """Coefficients at the angle of attack that a schedule has at the airspeed.

    Some laws, such as drag tracking, differentiate their model at a constant angle of
    attack. With this model their derivatives include the rate of the schedule. The angle
    of attack at which the coefficients are requested has no effect.
    """

    flown: AbstractAerodynamics
    schedule: AbstractProfile
    """rad, over the airspeed in m/s"""

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        return self.flown.coefficients(self.schedule(airspeed), mach, airspeed)
