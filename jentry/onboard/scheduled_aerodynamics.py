"""Aerodynamics along a schedule of the angle of attack, for laws that hold the angle."""

from ..fields import Scalar
from ..world.aerodynamics import AbstractAerodynamics
from .profiles import AbstractProfile


class ScheduledAerodynamics(AbstractAerodynamics):
    """Coefficients at the angle of attack that a schedule has at the airspeed.

    A law that differentiates its model at an angle of attack that is held, as drag
    tracking does, has the rate of the schedule in its derivatives with this model. The
    angle of attack at which it is asked does not count.
    """

    flown: AbstractAerodynamics
    schedule: AbstractProfile
    """rad, over the airspeed in m/s"""

    def coefficients(
        self, angle_of_attack: Scalar, mach: Scalar, airspeed: Scalar
    ) -> tuple[Scalar, Scalar]:
        return self.flown.coefficients(self.schedule(airspeed), mach, airspeed)
