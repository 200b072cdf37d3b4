"""An atmosphere whose density departs from its model: a trend, waves up and along."""

import dataclasses
from collections.abc import Iterable
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jax.core import Tracer

from .._math import arcsin, safe_sqrt, sincos
from ..addresses import address_of
from ..fields import Scalar, scalar
from ..units import km
from .atmosphere import AbstractAtmosphere


Tree = TypeVar("Tree")


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


class GroundWave(eqx.Module):
    """A sinusoidal departure over the distance from a place, in shares of the density."""

    amplitude: Scalar = scalar()
    wavelength: Scalar = scalar(unit="m", positive=True)
    """Over the ground"""
    radius: Scalar = scalar(unit="m", positive=True)
    """Of the planet"""
    phase: Scalar = scalar(0.0, unit="rad")
    """Phase at the origin"""
    longitude: Scalar = scalar(0.0, unit="rad")
    """Of the origin, such as the entry point"""
    latitude: Scalar = scalar(0.0, unit="rad")

    def departure(self, longitude: Scalar, latitude: Scalar) -> Scalar:
        """Share of the density above a place (rad)."""
        # By half angles: a small distance from its own cosine would be lost in rounding.
        across = sincos(0.5 * (latitude - self.latitude))[0]
        along = sincos(0.5 * (longitude - self.longitude))[0]
        _, here = sincos(latitude)
        _, there = sincos(self.latitude)
        square = across * across + here * there * along * along
        distance = 2.0 * arcsin(jnp.minimum(safe_sqrt(square), 1.0))
        waves = distance * self.radius * (1.0 / self.wavelength)
        return self.amplitude * sincos(2.0 * jnp.pi * waves + self.phase)[0]


class PerturbedAtmosphere(AbstractAtmosphere):
    """Another atmosphere, its density and pressure times 1 + trend + waves.

    Waves go up with the altitude, and ground waves with the distance from a place.

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
    ground_waves: tuple[GroundWave, ...] = ()
    above: tuple[Scalar, Scalar] | None = None
    """Longitude and latitude (rad) of the place that this is the air of; None for the
    origins of the ground waves. Given by `column`"""

    def column(self, longitude: Scalar, latitude: Scalar) -> "PerturbedAtmosphere":
        undisturbed = self.undisturbed.column(longitude, latitude)
        if undisturbed is self.undisturbed and not self.ground_waves:
            return self
        above = (longitude, latitude) if self.ground_waves else self.above
        return dataclasses.replace(self, undisturbed=undisturbed, above=above)

    def factor(self, altitude: Scalar) -> Scalar:
        """Density in units of the undisturbed one, at the place; NaN where departures take
        all of it away, so that no flight goes through air of negative density."""
        way = jnp.clip((altitude - self.low) / (self.high - self.low), 0.0, 1.0)
        share = self.share_low + way * (self.share_high - self.share_low)
        factor = 1.0 + self.trend * share
        for wave in self.waves:
            factor = factor + wave.departure(altitude)
        for wave in self.ground_waves:
            place = self.above or (wave.longitude, wave.latitude)
            factor = factor + wave.departure(*place)
        return jnp.where(factor > 0.0, factor, jnp.nan)

    def density(self, altitude: Scalar) -> Scalar:
        return self.factor(altitude) * self.undisturbed.density(altitude)

    def temperature(self, altitude: Scalar) -> Scalar:
        return self.undisturbed.temperature(altitude)

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.factor(altitude) * self.undisturbed.pressure(altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return self.undisturbed.speed_of_sound(altitude)


def without_zero_departures(tree: Tree, varied: Iterable[str] = ()) -> Tree:
    """The tree without the departures of its air that are zero.

    It flies the same, and what does not depart is not computed: in an atmosphere with
    three waves of amplitude zero a nominal flight takes half as long again. `fly` and
    `monte_carlo` do this by themselves with numbers that they know. What you compile
    yourself takes its numbers later, and is spared nothing unless you do it before:

        eqx.filter_jit(fly)(without_zero_departures(scenario))

    **Arguments:**

    - `tree`: such as a scenario.
    - `varied`: addresses of leaves that will be replaced. Air with one of them stays as it
      is, so that the address holds.
    """
    varied = tuple(varied)

    # What is derived from these may depart otherwise.
    def is_perturbed(node: Any) -> bool:
        return type(node) is PerturbedAtmosphere

    def spared(path: tuple, node: Any) -> Any:
        inside = f"{address_of(path)}." if path else ""
        if not is_perturbed(node) or any(each.startswith(inside) for each in varied):
            return node
        return _spared(node)

    return jtu.tree_map_with_path(spared, tree, is_leaf=is_perturbed)


def _spared(air: PerturbedAtmosphere) -> AbstractAtmosphere:
    """Without its departures that are known to be zero, and undisturbed without any."""
    moving, along = [
        () if all(_is_at_rest(wave) for wave in waves) else waves
        for waves in (air.waves, air.ground_waves)
    ]
    undisturbed = without_zero_departures(air.undisturbed)
    level = _is_zero(air.trend) or _is_zero(air.share_low) and _is_zero(air.share_high)
    if level and not moving and not along:
        return undisturbed
    return dataclasses.replace(
        air, undisturbed=undisturbed, waves=moving, ground_waves=along
    )


def _is_at_rest(wave: DensityWave | GroundWave) -> bool:
    return type(wave) in (DensityWave, GroundWave) and _is_zero(wave.amplitude)


def _is_zero(number: Any) -> bool:
    """Whether it is known, and zero."""
    return not isinstance(number, Tracer) and bool(np.all(np.asarray(number) == 0.0))
