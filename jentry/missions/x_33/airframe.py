"""The vehicle of the X-33 mission, and the angle of attack at which it flies."""

import jax.numpy as jnp

from ..._math import derivatives_along
from ...fields import Scalar, scalar
from ...onboard.profiles import AbstractProfile
from ...units import degree
from ...world.aerodynamics import PolynomialAerodynamics
from ...world.vehicle import Vehicle


_LIFT = -0.041065, 0.016292, 0.00026024
"""Coefficients of (61), a polynomial in the angle of attack in degrees"""
_DRAG = 0.080505, -0.03026, 0.86495
"""Coefficients of (62), a polynomial in the lift coefficient"""


def vehicle() -> Vehicle:
    """The X-33: 104 305 kg and 391.22 m2, which is 290 kg/m2 at 40 degrees."""
    lift = jnp.array([c / degree**power for power, c in enumerate(_LIFT)])
    # The drag is a polynomial in the lift, and so in the angle of attack as well.
    constant, first, second = _DRAG
    drag = second * jnp.convolve(lift, lift)
    drag = drag.at[:3].add(first * lift).at[0].add(constant)
    return Vehicle(
        mass=104_305.0,
        reference_area=391.22,
        aerodynamics=PolynomialAerodynamics(lift, drag),
        trim_angle_of_attack=40.0 * degree,
    )


class ScheduledAngleOfAttack(AbstractProfile):
    """Angle of attack over the velocity: 40 degrees, falling to 14 from 4570 to 760 m/s.

    The paper says that it falls monotonically. Here it is a parabola with its top at
    4570 m/s, where its second derivative jumps. It continues below 760 m/s.
    """

    high: Scalar = scalar(40.0 * degree, unit="rad")
    fall: Scalar = scalar(26.0 * degree, unit="rad")
    """Change from the top to the last velocity"""
    top: Scalar = scalar(4570.0, unit="m/s", positive=True)
    last: Scalar = scalar(760.0, unit="m/s", positive=True)

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return derivatives_along(jnp.ones_like, self._angle, index)

    def _angle(self, velocity: Scalar) -> Scalar:
        below = (velocity - self.top) / (self.top - self.last)
        return self.high - jnp.where(
            velocity < self.top, self.fall * below * below, 0.0
        )
