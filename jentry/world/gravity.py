"""Gravity: acceleration and potential over the distance from the planet's centre."""

from abc import abstractmethod

import equinox as eqx

from ..fields import Scalar, scalar


class AbstractGravity(eqx.Module):
    """Central gravity, a function of the radius (m)."""

    @abstractmethod
    def acceleration(self, radius: Scalar) -> Scalar:
        """Acceleration towards the centre, m/s2."""

    @abstractmethod
    def potential(self, radius: Scalar) -> Scalar:
        """Potential energy per unit mass, J/kg; its slope is the acceleration."""


class InverseSquareGravity(AbstractGravity):
    """Newton's law for a sphere."""

    gravitational_parameter: Scalar = scalar(unit="m3/s2", positive=True)

    def acceleration(self, radius: Scalar) -> Scalar:
        per_radius = 1.0 / radius
        return self.gravitational_parameter * per_radius * per_radius

    def potential(self, radius: Scalar) -> Scalar:
        return -self.gravitational_parameter * (1.0 / radius)


class ConstantGravity(AbstractGravity):
    """Acceleration that is equal at every radius, as in many published studies.

    The potential is counted from the planet's centre.
    """

    surface_acceleration: Scalar = scalar(unit="m/s2")

    def acceleration(self, radius: Scalar) -> Scalar:
        return self.surface_acceleration + 0.0 * radius

    def potential(self, radius: Scalar) -> Scalar:
        return self.surface_acceleration * radius
