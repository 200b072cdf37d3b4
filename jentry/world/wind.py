"""Wind: the velocity of the air over the rotating planet."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp

from .._types import Scalar, scalar


class AbstractWind(eqx.Module):
    """Velocity of the air relative to the rotating planet, a function of altitude (m)."""

    @abstractmethod
    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Towards east, north and up, m/s."""


class StillAir(AbstractWind):
    """Air that turns with the planet."""

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        calm = jnp.zeros_like(altitude)
        return calm, calm, calm


class ConstantWind(AbstractWind):
    """The same wind at every altitude; named by where it blows to."""

    east: Scalar = scalar(0.0, unit="m/s")
    north: Scalar = scalar(0.0, unit="m/s")
    up: Scalar = scalar(0.0, unit="m/s")

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        return self.east, self.north, self.up
