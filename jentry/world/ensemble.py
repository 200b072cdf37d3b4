"""Atmosphere and wind from an ensemble of profiles; a flight uses one profile."""

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
"""Number of points on which a monotone cubic between the middle two depends"""


def _optional_table(unit: str, positive: bool) -> Any:
    def convert(value: Any) -> Array | None:
        return None if value is None else as_float_array(value)

    return eqx.field(
        default=None, converter=convert, metadata={"unit": unit, "positive": positive}
    )


class EnsembleAtmosphere(AbstractAtmosphere, AbstractTabulated):
    """Profiles of density over common altitudes; `profile` selects one of them.

    Each profile is interpolated like `TabulatedAtmosphere`. Disperse
    `planet.atmosphere.profile` by `Discrete(range(count))`. A number that is not that of a
    profile gives NaN, which stops the flight with `Outcome.NOT_FINITE`. `read_ensemble`
    reads an ensemble from files.
    """

    altitudes: Float[Array, "..."] = table(unit="m", increasing=True)
    """Altitudes, m, shape (n,), increasing"""
    densities: Float[Array, "..."] = table(unit="kg/m3", positive=True)
    """Densities, kg/m3, shape (profiles, n), positive"""
    temperatures: Float[Array, "..."] | None = _optional_table("K", True)
    """Temperatures, K, shape (profiles, n); None for `isothermal_temperature`"""
    pressures: Float[Array, "..."] | None = _optional_table("Pa", True)
    """Pressures, Pa, shape (profiles, n); None for those of the equation of state"""
    profile: Scalar = scalar(0.0, choice=True)
    """Number of the selected profile, counted from 0"""
    isothermal_temperature: Scalar = scalar(246.0, unit="K", positive=True)
    """Temperature at every altitude if `temperatures` is None"""
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
    """Profiles of the horizontal wind over common altitudes; `profile` selects one of them.

    Each profile is interpolated like `TabulatedWind`. If the atmosphere is that of an
    ensemble too, one dispersion moves both: `lambda s: (s.planet.atmosphere.profile,
    s.planet.wind.profile)`. `read_ensemble` reads an ensemble from files.
    """

    altitudes: Float[Array, "..."] = table(unit="m", increasing=True)
    """Altitudes, m, shape (n,), increasing"""
    east: Float[Array, "..."] = table(unit="m/s")
    """Wind towards east, m/s, shape (profiles, n)"""
    north: Float[Array, "..."] = table(unit="m/s")
    """Wind towards north, m/s, shape (profiles, n)"""
    profile: Scalar = scalar(0.0, choice=True)
    """Number of the selected profile, counted from 0"""

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
    """Monotone cubic through a function `of` the values of the selected profile."""
    count, points = values.shape
    size = min(_WINDOW, points)
    # The cubic between two points depends only on those and their neighbours. At an end of
    # the table it depends on the three points there, which the window contains as well.
    begin = jnp.clip(interval(air.altitudes, x) - 1, 0, points - size)
    row = jnp.clip(jnp.round(air.profile), 0, count - 1).astype(begin.dtype)
    grid = jax.lax.dynamic_slice(air.altitudes, (begin,), (size,))
    near = jax.lax.dynamic_slice(values, (row, begin), (1, size))[0]
    return interpolate(grid, of(near), x) + jnp.where(row == air.profile, 0.0, jnp.nan)
