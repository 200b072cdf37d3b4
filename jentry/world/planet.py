"""The planet: shape, gravity, rotation, atmosphere and wind."""

import dataclasses

import equinox as eqx

from .._printed import as_text
from ..fields import Scalar, scalar
from .atmosphere import AbstractAtmosphere
from .gravity import AbstractGravity
from .wind import AbstractWind, StillAir


class Planet(eqx.Module):
    """A rotating sphere with an atmosphere."""

    radius: Scalar = scalar(unit="m", positive=True)
    gravity: AbstractGravity = eqx.field(kw_only=True)
    atmosphere: AbstractAtmosphere = eqx.field(kw_only=True)
    wind: AbstractWind = eqx.field(default_factory=StillAir, kw_only=True)
    rotation_rate: Scalar = scalar(0.0, unit="rad/s")
    density_scale: Scalar = scalar(1.0, positive=True)
    """Factor on the density of the atmosphere: the usual dispersion."""
    heating_coefficient: Scalar = scalar(1.7415e-4, unit="kg^0.5/m", positive=True)
    """Coefficient of the heat rate at the stagnation point: Sutton and Graves' for air"""
    heating_exponent: int | float = eqx.field(default=3, static=True, kw_only=True)
    """Power of the velocity in the heat rate. If it is not 3, the unit of the coefficient
    changes accordingly"""

    __str__ = as_text

    def above(self, longitude: Scalar, latitude: Scalar) -> "Planet":
        """The planet with the atmosphere above a place (rad) everywhere."""
        air = self.atmosphere.column(longitude, latitude)
        if air is self.atmosphere:
            return self
        return dataclasses.replace(self, atmosphere=air)

    def density(self, altitude: Scalar) -> Scalar:
        """Density of the air at an altitude, kg/m3: at the origin, or see `above`."""
        return self.density_scale * self.atmosphere.density(altitude)
