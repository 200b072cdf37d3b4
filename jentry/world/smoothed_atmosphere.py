"""A smoothed atmosphere, without corners between its layers."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .._interpolation import clamp
from ..fields import Scalar, Vector, scalar, table
from ..units import km
from .atmosphere import AbstractAtmosphere
from .tabulated import AbstractTabulated, Edges


_REACH = 5.0
"""Half-width of the interval of the mean, in standard deviations"""
_POINTS = 401
"""Number of points of the mean"""
_SAME_GAS = 1e-3
"""Relative difference of the numbers of two gases up to which they are one gas"""


class SmoothedAtmosphere(AbstractAtmosphere, AbstractTabulated):
    """Means over altitude of another atmosphere; twice continuously differentiable.

    Layered models have corners where the lapse rate jumps. A plan that differentiates the
    density twice, such as one that inverts the dynamics for the bank, has jumps there.
    `smoothed` makes this atmosphere. Beyond the table the density continues as an
    exponential, and the temperature is constant: see `AbstractTabulated`.
    """

    log_density: Vector = table()
    """Logarithm of the density in kg/m3: cubic B-spline coefficients on an even grid"""
    temperatures: Vector = table(unit="K", positive=True)
    """Temperature, K: cubic B-spline coefficients on that grid"""
    lowest: Scalar = scalar(unit="m")
    """Altitude of the first coefficient"""
    spacing: Scalar = scalar(unit="m", positive=True)
    gas_constant: Scalar = scalar(287.05287, unit="J/(kg K)", positive=True)
    heat_capacity_ratio: Scalar = scalar(1.4, positive=True)

    def edges(self) -> Edges:
        last = self.log_density.shape[0] - 2.0
        first = self.lowest + self.spacing
        return {"altitudes": (first, self.lowest + last * self.spacing)}

    def density(self, altitude: Scalar) -> Scalar:
        return jnp.exp(self._read(self.log_density, altitude, goes_on=True))

    def temperature(self, altitude: Scalar) -> Scalar:
        return self._read(self.temperatures, altitude, goes_on=False)

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.density(altitude) * self.gas_constant * self.temperature(altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return jnp.sqrt(
            self.heat_capacity_ratio * self.gas_constant * self.temperature(altitude)
        )

    def _read(self, coefficients: Vector, altitude: Scalar, goes_on: bool) -> Scalar:
        position = (altitude - self.lowest) * (1.0 / self.spacing)
        last = coefficients.shape[0] - 2.0
        inside = clamp(position, 1.0, last)
        before = jnp.clip(jnp.floor(inside), 1.0, last - 1.0)
        x = inside - before
        first = before.astype(jnp.int32) - 1
        a, b, c, d = (coefficients.at[first + i].get(mode="clip") for i in range(4))
        y = 1.0 - x
        value = (
            y * y * y * a
            + (4.0 - 6.0 * x * x + 3.0 * x * x * x) * b
            + (4.0 - 6.0 * y * y + 3.0 * y * y * y) * c
            + x * x * x * d
        ) / 6.0
        if not goes_on:
            return value
        middle = (1.0 + 2.0 * x * y) * (c - b)
        slope = 0.5 * (y * y * (b - a) + middle + x * x * (d - c))
        return value + (position - inside) * slope


def smoothed(
    atmosphere: AbstractAtmosphere,
    width: float = 1.5 * km,
    lowest: float = 0.0,
    highest: float = 150.0 * km,
    spacing: float = 250.0,
    gas_constant: float = 287.05287,
    heat_capacity_ratio: float = 1.4,
) -> SmoothedAtmosphere:
    """Means of an atmosphere, weighted by a normal distribution of altitudes.

    One mean is that of the logarithm of the density, which leaves an exponential
    atmosphere unchanged. The other is that of the temperature that gives the speed of
    sound. Pressure and temperature are correct if the atmosphere consists of this gas.

    **Arguments:**

    - `width`: standard deviation of the distribution, m.
    - `lowest`, `highest`: altitudes between which the means are tabulated, m.
    - `spacing`: spacing of the table, m.
    - `gas_constant`: gas constant, J/(kg K); the default is that of air.
    - `heat_capacity_ratio`: heat capacity ratio of the gas; the default is that of air.

    **Raises:** `ValueError` for a width or a spacing that is not positive, and for an
    atmosphere of another gas. The gas is not checked under `jit`, where its numbers are not
    known.
    """
    if not (width > 0.0 and spacing > 0.0 and highest - lowest >= 4.0 * spacing):
        raise ValueError(
            f"width is {width} m, spacing {spacing} m, from {lowest} to {highest} m: both "
            "must be positive, and the table four spacings or more"
        )
    _refuse_another_gas(atmosphere, lowest, gas_constant, heat_capacity_ratio)
    count = round((highest - lowest) / spacing) + 1
    altitudes = lowest + spacing * np.arange(-2, count + 2)
    away = np.linspace(-_REACH, _REACH, _POINTS)
    weights = np.exp(-0.5 * away**2)
    weights /= weights.sum()

    def logarithm(altitude: Scalar) -> Scalar:
        return jnp.log(atmosphere.density(altitude))

    def temperature(altitude: Scalar) -> Scalar:
        sound = atmosphere.speed_of_sound(altitude)
        return sound * sound / (heat_capacity_ratio * gas_constant)

    def mean(of):
        where = jnp.asarray(altitudes[:, None] + width * away[None, :])
        return jax.vmap(jax.vmap(of))(where) @ jnp.asarray(weights)

    def coefficients(values):
        # The spline of these passes through the values to fourth order in the spacing.
        bend = values[2:] - 2.0 * values[1:-1] + values[:-2]
        return values[1:-1] - bend / 6.0

    return SmoothedAtmosphere(
        coefficients(mean(logarithm)),
        coefficients(mean(temperature)),
        altitudes[1],
        spacing,
        gas_constant,
        heat_capacity_ratio,
    )


def _refuse_another_gas(
    atmosphere: AbstractAtmosphere, altitude: float, constant: float, ratio: float
) -> None:
    """Refuse an atmosphere that does not consist of a gas with these numbers."""
    at = jnp.asarray(altitude)
    pressure, density = atmosphere.pressure(at), atmosphere.density(at)
    sound, temperature = atmosphere.speed_of_sound(at), atmosphere.temperature(at)
    if any(isinstance(x, Tracer) for x in (pressure, density, sound, temperature)):
        return
    own_constant = float(pressure / (density * temperature))
    own_ratio = float(density * sound * sound / pressure)
    if not np.allclose([own_constant, own_ratio], [constant, ratio], rtol=_SAME_GAS):
        raise ValueError(
            f"at {altitude:g} m the atmosphere is of a gas with gas_constant="
            f"{own_constant:.6g} J/(kg K) and heat_capacity_ratio={own_ratio:.6g}, and "
            f"{constant:g} and {ratio:g} were given: give those of the gas"
        )
