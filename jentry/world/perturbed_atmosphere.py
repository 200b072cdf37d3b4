"""An atmosphere with density perturbations: a trend, and waves over altitude and ground."""

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
    """A sinusoidal perturbation over the altitude, as a share of the density."""

    amplitude: Scalar = scalar()
    wavelength: Scalar = scalar(unit="m", positive=True)
    phase: Scalar = scalar(0.0, unit="rad")
    """Phase at altitude zero"""

    def departure(self, altitude: Scalar) -> Scalar:
        """Perturbation at an altitude (m), as a share of the density."""
        angle = 2.0 * jnp.pi * altitude * (1.0 / self.wavelength) + self.phase
        return self.amplitude * sincos(angle)[0]


class GroundWave(eqx.Module):
    """A sinusoidal perturbation over the distance from an origin, as a share of density."""

    amplitude: Scalar = scalar()
    wavelength: Scalar = scalar(unit="m", positive=True)
    """Wavelength over the ground"""
    radius: Scalar = scalar(unit="m", positive=True)
    """Radius of the planet"""
    phase: Scalar = scalar(0.0, unit="rad")
    """Phase at the origin"""
    longitude: Scalar = scalar(0.0, unit="rad")
    """Longitude of the origin, such as the entry point"""
    latitude: Scalar = scalar(0.0, unit="rad")

    def departure(self, longitude: Scalar, latitude: Scalar) -> Scalar:
        """Perturbation above a place (rad), as a share of the density."""
        # Half angles are used: rounding would spoil the cosine of a small distance.
        across = sincos(0.5 * (latitude - self.latitude))[0]
        along = sincos(0.5 * (longitude - self.longitude))[0]
        _, here = sincos(latitude)
        _, there = sincos(self.latitude)
        square = across * across + here * there * along * along
        distance = 2.0 * arcsin(jnp.minimum(safe_sqrt(square), 1.0))
        waves = distance * self.radius * (1.0 / self.wavelength)
        return self.amplitude * sincos(2.0 * jnp.pi * waves + self.phase)[0]


class PerturbedAtmosphere(AbstractAtmosphere):
    """An atmosphere whose density and pressure are multiplied by 1 + trend + waves.

    Waves vary with the altitude, and ground waves with the distance from an origin. The
    temperature is that of the undisturbed atmosphere.

    The trend is `trend` times a share of the density that grows linearly between two
    altitudes and is constant beyond them. This is the usual form of a dispersed density:
    the share is one standard deviation, and `trend` is drawn from a normal distribution of
    variance 1.
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
    """Longitude and latitude (rad) of the place at which the ground waves are evaluated;
    None for their origins. `column` sets it"""

    def column(self, longitude: Scalar, latitude: Scalar) -> "PerturbedAtmosphere":
        undisturbed = self.undisturbed.column(longitude, latitude)
        if undisturbed is self.undisturbed and not self.ground_waves:
            return self
        above = (longitude, latitude) if self.ground_waves else self.above
        return dataclasses.replace(self, undisturbed=undisturbed, above=above)

    def factor(self, altitude: Scalar) -> Scalar:
        """Density over the undisturbed density at the place. It is NaN where it would be
        zero or negative, so that no flight continues in air of negative density."""
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


def without_zero_perturbations(tree: Tree, varied: Iterable[str] = ()) -> Tree:
    """The tree without the density perturbations that are zero.

    Its flights are equal, and zero perturbations are not computed: with three waves of
    amplitude zero a nominal flight takes one and a half times as long. `fly` and
    `monte_carlo` do this for numbers that are known when they are called. A program that
    you compile does not know its numbers, so call this function before:

        eqx.filter_jit(fly)(without_zero_perturbations(scenario))

    **Arguments:**

    - `tree`: a pytree such as a scenario.
    - `varied`: addresses of leaves that will be replaced. An atmosphere with one of them
      is left unchanged, so that the address remains valid.
    """
    varied = tuple(varied)

    # Classes derived from these may have other perturbations.
    def is_perturbed(node: Any) -> bool:
        return type(node) is PerturbedAtmosphere

    def spared(path: tuple, node: Any) -> Any:
        inside = f"{address_of(path)}." if path else ""
        if not is_perturbed(node) or any(each.startswith(inside) for each in varied):
            return node
        return _spared(node)

    return jtu.tree_map_with_path(spared, tree, is_leaf=is_perturbed)


def _spared(air: PerturbedAtmosphere) -> AbstractAtmosphere:
    """The atmosphere without perturbations that are known to be zero; the undisturbed
    atmosphere if none is left."""
    moving, along = [
        () if all(_is_at_rest(wave) for wave in waves) else waves
        for waves in (air.waves, air.ground_waves)
    ]
    undisturbed = without_zero_perturbations(air.undisturbed)
    level = _is_zero(air.trend) or _is_zero(air.share_low) and _is_zero(air.share_high)
    if level and not moving and not along:
        return undisturbed
    return dataclasses.replace(
        air, undisturbed=undisturbed, waves=moving, ground_waves=along
    )


def _is_at_rest(wave: DensityWave | GroundWave) -> bool:
    return type(wave) in (DensityWave, GroundWave) and _is_zero(wave.amplitude)


def _is_zero(number: Any) -> bool:
    """Whether a number is known to be zero."""
    return not isinstance(number, Tracer) and bool(np.all(np.asarray(number) == 0.0))
