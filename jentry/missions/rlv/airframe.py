"""The vehicle of the RLV mission, and the angle of attack at which it flies."""

import jax.numpy as jnp

from ..._math import derivatives_along, smoothstep
from ...fields import Scalar, scalar
from ...onboard.profiles import AbstractProfile
from ...units import degree
from ...world.aerodynamics import PolynomialAerodynamics
from ...world.vehicle import Vehicle


_LIFT = 0.12457, -0.02437, 0.00309, -3.66023e-5
_DRAG = 0.32083, -0.02850, 0.00155, -9.42499e-7
"""Coefficients of (43) and (44), polynomials in the angle of attack in degrees"""


def vehicle() -> Vehicle:
    """The RLV: 5 m2 from the paper, and 3500 kg, chosen: 437 kg/m2 at 40 degrees."""
    lift, drag = (
        jnp.array([c / degree**power for power, c in enumerate(fit)])
        for fit in (_LIFT, _DRAG)
    )
    return Vehicle(
        mass=3500.0,
        reference_area=5.0,
        aerodynamics=PolynomialAerodynamics(lift, drag),
        trim_angle_of_attack=40.0 * degree,
    )


class ScheduledAngleOfAttack(AbstractProfile):
    """Angle of attack (45) over the Mach number: 40 degrees, and less below Mach 12.

    The paper's function has a corner and a step of 0.007 degrees at Mach 12. Here its two
    parts are blended between Mach 11.8 and 12.2, twice continuously differentiable. Below
    Mach 3, where the paper has no value, it is constant.
    """

    high: Scalar = scalar(40.0 * degree, unit="rad")
    blend: Scalar = scalar(0.2, positive=True)
    """Half of the width of the blend, in Mach numbers"""

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return derivatives_along(jnp.ones_like, self._angle, index)

    def _angle(self, mach: Scalar) -> Scalar:
        known = jnp.maximum(mach, 3.0)
        falling = (-4.3333 + 7.3611 * known - 0.3056 * known * known) * degree
        share = smoothstep((mach - 12.0) / (2.0 * self.blend) + 0.5)
        return falling + share * (self.high - falling)
