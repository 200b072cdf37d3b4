"""An atmosphere whose density departs from its model by a trend and waves over altitude."""

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, scalar
from ..units import km
from .atmosphere import AbstractAtmosphere


class DensityWave(eqx.Module):
    """A sinusoidal departure, in shares of the density."""

    amplitude: Scalar = scalar()
    wavelength: Scalar = scalar(unit="m", positive=True)
    phase: Scalar = scalar(0.0, unit="rad")
    """Phase at altitude zero"""

    def departure(self, altitude: Scalar) -> Scalar:
        """Share of the density."""
        angle = 2.0 * jnp.pi * altitude * (1.0 / self.wavelength) + self.phase
        return self.amplitude * sincos(angle)[0]


class PerturbedAtmosphere(AbstractAtmosphere):
    """Another atmosphere, its density and pressure times 1 + trend + waves.

    The temperature is its own.

    The trend is `trend` times a share of the density that grows linearly between two
    altitudes, and keeps its value beyond them: the usual form of a dispersed density,
    with the share one standard deviation and a `trend` that is drawn from a normal
    distribution of variance 1.
    """

    undisturbed: AbstractAtmosphere
    waves: tuple[DensityWave, ...] = ()
    trend: Scalar = scalar(0.0)
    low: Scalar = scalar(30.0 * km, unit="m")
    high: Scalar = scalar(80.0 * km, unit="m")
    share_low: Scalar = scalar(0.0)
    share_high: Scalar = scalar(0.0)

    def factor(self, altitude: Scalar) -> Scalar:
        """Density in units of the undisturbed one."""
        way = jnp.clip((altitude - self.low) / (self.high - self.low), 0.0, 1.0)
        share = self.share_low + way * (self.share_high - self.share_low)
        factor = 1.0 + self.trend * share
        for wave in self.waves:
            factor = factor + wave.departure(altitude)
        return factor

    def density(self, altitude: Scalar) -> Scalar:
        return self.factor(altitude) * self.undisturbed.density(altitude)

    def temperature(self, altitude: Scalar) -> Scalar:
        return self.undisturbed.temperature(altitude)

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.factor(altitude) * self.undisturbed.pressure(altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return self.undisturbed.speed_of_sound(altitude)
