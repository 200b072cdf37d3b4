"""Wind: the velocity of the air over the rotating planet."""

import os
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interpolation import check_grid, clamp, interpolate
from .._tables import read_columns
from ..fields import Scalar, scalar, table
from .tabulated import AbstractTabulated, Edges


class AbstractWind(eqx.Module):
    """Velocity of the air relative to the rotating planet, over altitude (m)."""

    @abstractmethod
    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Velocity of the air towards east, north and up, m/s."""


class StillAir(AbstractWind):
    """Air that rotates with the planet: no wind."""

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        calm = jnp.zeros_like(altitude)
        return calm, calm, calm


class ConstantWind(AbstractWind):
    """A wind that is equal at every altitude; components are towards east, north and up."""

    east: Scalar = scalar(0.0, unit="m/s")
    north: Scalar = scalar(0.0, unit="m/s")
    up: Scalar = scalar(0.0, unit="m/s")

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return self.east, self.north, self.up


class TabulatedWind(AbstractWind, AbstractTabulated):
    """Horizontal wind from a table over altitude, interpolated by monotone cubics.

    Below the first and above the last altitude the wind is constant: see
    `AbstractTabulated`.
    """

    altitudes: Float[Array, "..."] = table(unit="m", increasing=True)
    """Altitudes, m, shape (n,), increasing"""
    east: Float[Array, "..."] = table(unit="m/s")
    """Wind towards east, m/s, shape (n,)"""
    north: Float[Array, "..."] = table(unit="m/s")
    """Wind towards north, m/s, shape (n,)"""

    def __check_init__(self):
        check_grid("altitudes", self.altitudes)
        for name in ("east", "north"):
            shape = getattr(self, name).shape
            if shape != self.altitudes.shape:
                raise ValueError(
                    f"{name} has shape {shape}: expected one value for each altitude, "
                    f"{self.altitudes.shape}"
                )

    def edges(self) -> Edges:
        return {"altitudes": (self.altitudes[0], self.altitudes[-1])}

    @classmethod
    def from_csv(
        cls, path: str | os.PathLike, refuse_beyond: bool = False
    ) -> "TabulatedWind":
        """Read a file with the columns `altitude_m,east_m_s,north_m_s`.

        Raises `ValueError` that names the file, the line and what was expected there.
        """
        columns, _ = read_columns(
            path, ("altitude_m", "east_m_s", "north_m_s"), increasing="altitude_m"
        )
        return cls(
            altitudes=jnp.asarray(columns["altitude_m"]),
            east=jnp.asarray(columns["east_m_s"]),
            north=jnp.asarray(columns["north_m_s"]),
            refuse_beyond=refuse_beyond,
        )

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        inside = clamp(altitude, self.altitudes[0], self.altitudes[-1])
        horizontal = jnp.stack([self.east, self.north], axis=-1)
        east, north = interpolate(self.altitudes, horizontal, inside)
        return east, north, jnp.zeros_like(altitude)


class ScaledWind(AbstractWind):
    """A wind multiplied by a factor: the usual dispersion, at `planet.wind.scale`.

    A factor of 1 leaves the wind unchanged, bit by bit; a negative one reverses it.
    """

    wind: AbstractWind
    scale: Scalar = scalar(1.0)
    """Factor on all components"""

    def __check_init__(self):
        if isinstance(self.wind, StillAir):
            raise ValueError(
                "StillAir is scaled, and a factor on no wind has no effect: give a wind, "
                "such as ConstantWind"
            )

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        east, north, up = self.wind.velocity(altitude)
        return self.scale * east, self.scale * north, self.scale * up
