"""Atmosphere and wind with random perturbations over the altitude."""

import dataclasses

import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, scalar
from .atmosphere import AbstractAtmosphere
from .random_profile import RandomAltitudeProfile
from .wind import AbstractWind


class RandomAtmosphere(AbstractAtmosphere):
    """An atmosphere whose density and pressure are multiplied by a random factor.

    The factor is the exponential of a random profile. At every altitude it is lognormal
    with a median of 1, so it is never negative. The temperature is that of the undisturbed
    atmosphere. A factor with a standard deviation of about 10 % and a correlation length
    of 10 km is

        RandomAtmosphere(atmosphere, RandomAltitudeProfile(10e3), 0.1)

    Disperse `planet.atmosphere.profile.seed` by `Uniform(0, 1)`.
    """

    undisturbed: AbstractAtmosphere
    profile: RandomAltitudeProfile
    deviation_of_logarithm: Scalar = scalar(range=NOT_NEGATIVE)
    """Standard deviation of the natural logarithm of the factor"""

    def column(self, longitude: Scalar, latitude: Scalar) -> "RandomAtmosphere":
        above = self.undisturbed.column(longitude, latitude)
        if above is self.undisturbed:
            return self
        return dataclasses.replace(self, undisturbed=above)

    def factor(self, altitude: Scalar) -> Scalar:
        """Density over the undisturbed density."""
        return jnp.exp(self.deviation_of_logarithm * self.profile(altitude))

    def density(self, altitude: Scalar) -> Scalar:
        return self.factor(altitude) * self.undisturbed.density(altitude)

    def temperature(self, altitude: Scalar) -> Scalar:
        return self.undisturbed.temperature(altitude)

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.factor(altitude) * self.undisturbed.pressure(altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return self.undisturbed.speed_of_sound(altitude)


class RandomWind(AbstractWind):
    """A wind plus random gusts towards east and north over the altitude.

    Disperse the two seeds, `planet.wind.east.seed` and `planet.wind.north.seed`, by two
    separate `Uniform(0, 1)`: two profiles with equal seeds and nodes are equal.
    """

    mean: AbstractWind
    east: RandomAltitudeProfile
    north: RandomAltitudeProfile
    standard_deviation: Scalar = scalar(unit="m/s", range=NOT_NEGATIVE)
    """Standard deviation of the gusts, towards east and towards north"""

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        east, north, up = self.mean.velocity(altitude)
        return (
            east + self.standard_deviation * self.east(altitude),
            north + self.standard_deviation * self.north(altitude),
            up,
        )
