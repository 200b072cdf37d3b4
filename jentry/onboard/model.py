"""What a law believes of planet and vehicle."""

import equinox as eqx

from ..fields import Scalar
from ..world.atmosphere import ExponentialAtmosphere
from ..world.gravity import InverseSquareGravity
from ..world.planet import Planet
from ..world.vehicle import Vehicle


class WorldModel(eqx.Module):
    """The nominal world on board: a copy of its own, which dispersing the truth leaves."""

    planet: Planet
    vehicle: Vehicle


class OnboardModel(WorldModel):
    """The nominal world for laws that need the rates of density and gravity.

    Its atmosphere is exponential, since laws use its scale height, and its gravity that
    of a sphere, since they use its rate of change.
    """

    def __check_init__(self):
        atmosphere = self.planet.atmosphere
        if not isinstance(atmosphere, ExponentialAtmosphere):
            raise ValueError(
                f"the onboard model has a {type(atmosphere).__name__}: it needs an "
                "ExponentialAtmosphere, fitted to the corridor that is flown"
            )

        gravity = self.planet.gravity
        if not isinstance(gravity, InverseSquareGravity):
            raise ValueError(
                f"the onboard model has a {type(gravity).__name__}: it needs an "
                "InverseSquareGravity"
            )

    @property
    def scale_height(self) -> Scalar:
        """m"""
        atmosphere = self.planet.atmosphere
        assert isinstance(atmosphere, ExponentialAtmosphere)
        return atmosphere.scale_height

    @property
    def lift_to_drag(self) -> Scalar:
        """At the trim angle of attack, a Mach number of 20 and 6 km/s."""
        lift, drag = self._trim_coefficients()
        return lift / drag

    @property
    def ballistic_coefficient(self) -> Scalar:
        """m / (C_D S), kg/m2, likewise."""
        _, drag = self._trim_coefficients()
        return self.vehicle.mass / (drag * self.vehicle.reference_area)

    def _trim_coefficients(self) -> tuple[Scalar, Scalar]:
        angle_of_attack = self.vehicle.trim_angle_of_attack
        return self.vehicle.coefficients(
            angle_of_attack,
            20.0 + 0.0 * angle_of_attack,
            6000.0 + 0.0 * angle_of_attack,
        )
