"""An atmosphere from a table of density over altitude."""

import os
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._interpolation import check_grid, clamp, interpolate
from .._tables import read_columns
from ..fields import Scalar, as_float_array, scalar, table
from .atmosphere import AbstractAtmosphere
from .tabulated import AbstractTabulated, Edges


LOWEST_TOP = 1e3
"""m; a file whose highest altitude is lower is refused, since its altitudes may be in km"""


def _as_float_array_or_none(value: Any) -> Array | None:
    return None if value is None else as_float_array(value)


class TabulatedAtmosphere(AbstractAtmosphere, AbstractTabulated):
    """An atmosphere from a table of density, and temperature if known, over altitude.

    Between the altitudes the logarithm of density is a monotone cubic. Beyond both ends
    the density is an exponential with the scale height at that end. Temperature is a
    monotone cubic too, and constant beyond the ends: see `AbstractTabulated`. Density is
    once differentiable in altitude everywhere, and all quantities are differentiable in
    the numbers of the table. Pressure follows from the equation of state.

        atmosphere = TabulatedAtmosphere.from_csv("mars.csv")
    """

    altitudes: Float[Array, "..."] = table(unit="m", increasing=True)
    """Altitudes, m, shape (n,), increasing"""
    densities: Float[Array, "..."] = table(unit="kg/m3", positive=True)
    """Densities, kg/m3, shape (n,), positive"""
    temperatures: Float[Array, "..."] | None = eqx.field(
        default=None,
        converter=_as_float_array_or_none,
        metadata={"unit": "K", "positive": True},
    )
    """Temperatures, K, shape (n,); None if the source gives only the density"""
    isothermal_temperature: Scalar = scalar(246.0, unit="K", positive=True)
    """Temperature at every altitude if `temperatures` is None"""
    gas_constant: Scalar = scalar(287.05287, unit="J/(kg K)", positive=True)
    heat_capacity_ratio: Scalar = scalar(1.4, positive=True)

    def __check_init__(self):
        check_grid("altitudes", self.altitudes)
        for name in ("densities", "temperatures"):
            values = getattr(self, name)
            if values is None:
                continue
            if values.shape != self.altitudes.shape:
                raise ValueError(
                    f"{name} has shape {values.shape}: expected one value for each "
                    f"altitude, {self.altitudes.shape}"
                )
            known = not isinstance(values, Tracer)
            if known and not np.all(np.asarray(values) > 0.0):
                raise ValueError(f"{name} must be positive, and one is not: {values}")

    def edges(self) -> Edges:
        return {"altitudes": (self.altitudes[0], self.altitudes[-1])}

    @classmethod
    def from_csv(cls, path: str | os.PathLike, **numbers: Any) -> "TabulatedAtmosphere":
        """Read a file with the columns `altitude_m,density_kg_m3[,temperature_K]`.

        Other fields, such as `gas_constant`, are given by name.

        Raises `ValueError` that names the file, the line and what was expected there.
        """
        columns, _ = read_columns(
            path,
            ("altitude_m", "density_kg_m3"),
            ("temperature_K",),
            increasing="altitude_m",
            positive=("density_kg_m3", "temperature_K"),
        )
        highest = columns["altitude_m"][-1]
        if highest < LOWEST_TOP:
            raise ValueError(
                f"{path}: the highest altitude is {highest:g} m, which is not that of an "
                "entry; are its altitudes in km?"
            )
        return cls(
            jnp.asarray(columns["altitude_m"]),
            jnp.asarray(columns["density_kg_m3"]),
            columns.get("temperature_K"),
            **numbers,
        )

    def density(self, altitude: Scalar) -> Scalar:
        return jnp.exp(interpolate(self.altitudes, jnp.log(self.densities), altitude))

    def temperature(self, altitude: Scalar) -> Scalar:
        if self.temperatures is None:
            return self.isothermal_temperature + 0.0 * altitude
        inside = clamp(altitude, self.altitudes[0], self.altitudes[-1])
        return interpolate(self.altitudes, self.temperatures, inside)

    def pressure(self, altitude: Scalar) -> Scalar:
        return self.density(altitude) * self.gas_constant * self.temperature(altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return jnp.sqrt(
            self.heat_capacity_ratio * self.gas_constant * self.temperature(altitude)
        )
