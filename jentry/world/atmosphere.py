"""Atmospheres: density, temperature, pressure and speed of sound over altitude."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp

from ..fields import Scalar, scalar


class AbstractAtmosphere(eqx.Module):
    """Air at rest with respect to the planet, a function of geometric altitude (m).

    An atmosphere that varies with the place overrides `column`; its other methods then
    hold at its origin. Every method is differentiable in altitude and in the numbers of
    the model.
    """

    def column(self, longitude: Scalar, latitude: Scalar) -> "AbstractAtmosphere":
        """The atmosphere above a place (rad); itself if it does not vary with the place."""
        return self

    @abstractmethod
    def density(self, altitude: Scalar) -> Scalar:
        """Density, kg/m3."""

    @abstractmethod
    def temperature(self, altitude: Scalar) -> Scalar:
        """Temperature, K."""

    @abstractmethod
    def pressure(self, altitude: Scalar) -> Scalar:
        """Pressure, Pa."""

    @abstractmethod
    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        """Speed of sound, m/s."""


class ExponentialAtmosphere(AbstractAtmosphere):
    """Isothermal atmosphere, density = surface_density * exp(-altitude / scale_height).

    Temperature and gas affect only pressure and speed of sound. The defaults are those of
    air at 246 K.
    """

    surface_density: Scalar = scalar(unit="kg/m3", positive=True)
    scale_height: Scalar = scalar(unit="m", positive=True)
    isothermal_temperature: Scalar = scalar(246.0, unit="K", positive=True)
    gas_constant: Scalar = scalar(287.05287, unit="J/(kg K)", positive=True)
    heat_capacity_ratio: Scalar = scalar(1.4, positive=True)

    def density(self, altitude: Scalar) -> Scalar:
        return self.surface_density * jnp.exp(-altitude * (1.0 / self.scale_height))

    def temperature(self, altitude: Scalar) -> Scalar:
        return self.isothermal_temperature + 0.0 * altitude

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.density(altitude) * self.gas_constant * self.isothermal_temperature

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return jnp.sqrt(
            self.heat_capacity_ratio * self.gas_constant * self.temperature(altitude)
        )
