"""Air of an ensemble of profiles over the altitude, one of which a flight meets."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from .._interpolation import check_grid, clamp, interpolate, interval
from ..fields import Scalar, as_float_array, scalar, table
from .atmosphere import AbstractAtmosphere
from .tabulated import AbstractTabulated, Edges
from .wind import AbstractWind


_WINDOW = 4
"""Points that a monotone cubic in the middle of them depends on"""


def _optional_table(unit: str, positive: bool) -> Any:
    def convert(value: Any) -> Array | None:
        return None if value is None else as_float_array(value)

    return eqx.field(
        default=None, converter=convert, metadata={"unit": unit, "positive": positive}
    )


class EnsembleAtmosphere(AbstractAtmosphere, AbstractTabulated):
    """Many profiles of density over the same altitudes, of which `profile` chooses one.

    Each is joined as `TabulatedAtmosphere` joins its table. Disperse
    `planet.atmosphere.profile` by `Discrete(range(count))`. A number that is no profile
    gives air that is not finite, and a flight that says so. Made by `read_ensemble`.
    """

    altitudes: Float[Array, "..."] = table(unit="m", increasing=True)
    """(n,), increasing"""
    densities: Float[Array, "..."] = table(unit="kg/m3", positive=True)
    """(profiles, n), positive"""
    temperatures: Float[Array, "..."] | None = _optional_table("K", True)
    """(profiles, n); None for the isothermal one"""
    pressures: Float[Array, "..."] | None = _optional_table("Pa", True)
    """(profiles, n); None for those of the equation of state"""
    profile: Scalar = scalar(0.0, choice=True)
    """Number of the profile that is met, from 0"""
    isothermal_temperature: Scalar = scalar(246.0, unit="K", positive=True)
    """Stands for the temperature where there is none."""
    gas_constant: Scalar = scalar(287.05287, unit="J/(kg K)", positive=True)
    heat_capacity_ratio: Scalar = scalar(1.4, positive=True)

    def __check_init__(self):
        for name in ("densities", "temperatures", "pressures"):
            values = getattr(self, name)
            if values is not None:
                _check_profiles(self, name, values)
                known = not isinstance(values, Tracer)
                if known and not np.all(np.asarray(values) > 0.0):
                    raise ValueError(f"{name} must be positive, and one is not")

    def edges(self) -> Edges:
        return {"altitudes": (self.altitudes[0], self.altitudes[-1])}

    def density(self, altitude: Scalar) -> Scalar:
        return self._exponential(self.densities, altitude)

    def temperature(self, altitude: Scalar) -> Scalar:
        if self.temperatures is None:
            return self.isothermal_temperature + 0.0 * altitude
        inside = clamp(altitude, self.altitudes[0], self.altitudes[-1])
        return _of_profile(self, self.temperatures, inside)

    def pressure(self, altitude: Scalar) -> Scalar:
        if self.pressures is None:
            gas = self.gas_constant * self.temperature(altitude)
            return self.density(altitude) * gas
        return self._exponential(self.pressures, altitude)

    def speed_of_sound(self, altitude: Scalar) -> Scalar:
        return jnp.sqrt(
            self.heat_capacity_ratio * self.gas_constant * self.temperature(altitude)
        )

    def _exponential(self, values: Array, altitude: Scalar) -> Scalar:
        return jnp.exp(_of_profile(self, values, altitude, jnp.log))


class EnsembleWind(AbstractWind, AbstractTabulated):
    """Many profiles of the horizontal wind over the same altitudes, of which one blows.

    Each is joined as `TabulatedWind` joins its table. Where the air is of an ensemble too,
    one dispersion moves both: `lambda s: (s.planet.atmosphere.profile,
    s.planet.wind.profile)`. Made by `read_ensemble`.
    """

    altitudes: Float[Array, "..."] = table(unit="m", increasing=True)
    """(n,), increasing"""
    east: Float[Array, "..."] = table(unit="m/s")
    """(profiles, n), positive where the air moves to the east"""
    north: Float[Array, "..."] = table(unit="m/s")
    """(profiles, n), positive where the air moves to the north"""
    profile: Scalar = scalar(0.0, choice=True)
    """Number of the profile that blows, from 0"""

    def __check_init__(self):
        for name in ("east", "north"):
            _check_profiles(self, name, getattr(self, name))
        if self.east.shape != self.north.shape:
            raise ValueError(
                f"east has shape {self.east.shape} and north {self.north.shape}: expected "
                "the same"
            )

    def edges(self) -> Edges:
        return {"altitudes": (self.altitudes[0], self.altitudes[-1])}

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        inside = clamp(altitude, self.altitudes[0], self.altitudes[-1])
        east, north = (_of_profile(self, x, inside) for x in (self.east, self.north))
        return east, north, jnp.zeros_like(altitude)


_Ensemble = EnsembleAtmosphere | EnsembleWind


def _check_profiles(air: _Ensemble, name: str, values: Array) -> None:
    check_grid("altitudes", air.altitudes)
    if values.ndim != 2 or values.shape[1] != air.altitudes.shape[0]:
        raise ValueError(
            f"{name} has shape {values.shape}: expected a row for each profile and a value "
            f"for each altitude, (profiles, {air.altitudes.shape[0]})"
        )
    if not eqx.is_array(air.profile) or isinstance(air.profile, Tracer):
        return
    number = float(air.profile)
    if number not in range(len(values)):
        raise ValueError(
            f"profile is {number:g}: it must be a whole number from 0 to "
            f"{len(values) - 1}, there are {len(values)} profiles"
        )


def _of_profile(air: _Ensemble, values: Array, x: Scalar, of=lambda x: x) -> Scalar:
    """The monotone cubic through a function of the values of the chosen profile."""
    count, points = values.shape
    size = min(_WINDOW, points)
    # The cubic between two points depends on those and their neighbours alone, and at an
    # end of the table on the three points there, which are at that end of the window too.
    begin = jnp.clip(interval(air.altitudes, x) - 1, 0, points - size)
    row = jnp.clip(jnp.round(air.profile), 0, count - 1).astype(begin.dtype)
    grid = jax.lax.dynamic_slice(air.altitudes, (begin,), (size,))
    near = jax.lax.dynamic_slice(values, (row, begin), (1, size))[0]
    return interpolate(grid, of(near), x) + jnp.where(row == air.profile, 0.0, jnp.nan)
