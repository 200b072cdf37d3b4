"""The planet: shape, gravity, rotation, atmosphere and wind."""

import dataclasses

import equinox as eqx
import numpy as np
from jax.core import Tracer

from .._printed import as_text
from ..fields import Scalar, scalar
from ..units import km
from .atmosphere import AbstractAtmosphere
from .gravity import AbstractGravity
from .shape import Ellipsoid, GeodeticAtmosphere, GeodeticWind, Sphere
from .wind import AbstractWind, StillAir


_NEAR = 0.1
"""Largest distance of the sphere from the ellipsoid, as a share of its radii"""


class Planet(eqx.Module):
    """A rotating planet with an atmosphere: a sphere, or an ellipsoid.

    Altitude and latitude of a state are those of a sphere, whatever the shape: above the
    sphere of `radius`, and geocentric. On an ellipsoid atmosphere and wind are taken at the
    geodetic altitude.
    """

    radius: Scalar = scalar(unit="m", positive=True)
    """Radius of the sphere above which altitudes are counted, and on which arcs over the
    ground are"""
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
    shape: Sphere | Ellipsoid = eqx.field(default_factory=Sphere, kw_only=True)
    """Surface from which the atmosphere is counted. The radius of the sphere must be within
    a tenth of the radii of an ellipsoid"""

    __str__ = as_text

    def __check_init__(self):
        if isinstance(self.shape, Sphere):
            return
        radii = self.radius, self.shape.polar_radius, self.shape.equatorial_radius
        if any(isinstance(x, Tracer) or np.ndim(x) for x in radii):
            return
        radius, polar, equatorial = map(float, radii)
        if not (1.0 - _NEAR) * polar <= radius <= (1.0 + _NEAR) * equatorial:
            raise ValueError(
                f"radius is {radius / km:g} km and shape an Ellipsoid with an equatorial "
                f"radius of {equatorial / km:g} km: altitudes would be counted from two "
                "different planets; give both, in metres, those of one planet"
            )

    def above(self, longitude: Scalar, latitude: Scalar) -> "Planet":
        """The planet with the atmosphere and the wind above a place (rad) everywhere.

        They are functions of the altitude of a state, also if the planet is an ellipsoid.
        """
        air = self.atmosphere.column(longitude, latitude)
        if isinstance(self.shape, Ellipsoid):
            return dataclasses.replace(
                self,
                atmosphere=GeodeticAtmosphere(air, self.shape, self.radius, latitude),
                wind=self.wind_above(latitude),
                shape=Sphere(),
            )
        if air is self.atmosphere:
            return self
        return dataclasses.replace(self, atmosphere=air)

    def wind_above(self, latitude: Scalar) -> AbstractWind:
        """The wind over the altitude of a state, at a geocentric latitude (rad)."""
        if isinstance(self.shape, Sphere) or isinstance(self.wind, StillAir):
            return self.wind
        return GeodeticWind(self.wind, self.shape, self.radius, latitude)

    def geodetic_altitude(self, altitude: Scalar, latitude: Scalar) -> Scalar:
        """Altitude above the shape of the planet (m): on a sphere, the altitude.

        `altitude` and `latitude` are those of a state.
        """
        if isinstance(self.shape, Sphere):
            return altitude
        return self.shape.altitude(self.radius + altitude, latitude)

    def density(self, altitude: Scalar) -> Scalar:
        """Density of the air at an altitude, kg/m3: at the origin, or see `above`.

        Raises `ValueError` if the planet is an ellipsoid.
        """
        if isinstance(self.shape, Ellipsoid):
            raise ValueError(
                "a computation reads the density over the altitude alone, and the planet "
                "is an Ellipsoid, whose air depends on the latitude as well: give this "
                "planet, such as that of the onboard model, shape=Sphere(), or take the "
                "air above a place, planet.above(longitude, latitude).density(altitude)"
            )
        return self.density_scale * self.atmosphere.density(altitude)
