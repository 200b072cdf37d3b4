"""The flight that has a drag over its velocity: altitude, path angle and lift upwards.

Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
Dynamics Method", KSME International Journal 18(9), 2004, section 3.
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._math import arcsin, sincos
from .._newton import by_jvp, newton
from ..fields import Scalar, output
from ..motion.forces import AirData, air_data
from ..motion.state import EntryState
from ..onboard.profiles import AbstractProfile
from ..units import km
from ..world.planet import Planet
from ..world.vehicle import Vehicle


_LOWEST, _HIGHEST = 0.0, 150.0 * km
_SEARCH = 60
"""Newton steps to an altitude, or halvings where these lead astray"""
_AGAIN = 3
"""More of them, which are differentiated: exact up to the seventh derivative"""


class InversePoint(eqx.Module):
    """A point of the flight that has the drag."""

    altitude: Scalar = output(unit="m")
    flight_path_angle: Scalar = output(unit="rad")
    lift_to_drag_up: Scalar = output()
    """Lift in the vertical plane over drag: C_L / C_D times the cosine of the bank"""
    lift_to_drag: Scalar = output()
    """All of it; a bank is there where the one up is not larger"""

    @property
    def cos_bank(self) -> Scalar:
        return self.lift_to_drag_up / self.lift_to_drag


class AbstractInverse(eqx.Module):
    """Finds the flight of a drag profile, in a plane, over a sphere at rest."""

    planet: Planet
    vehicle: Vehicle
    angle_of_attack: AbstractProfile
    """rad, over the velocity in m/s"""
    drag: AbstractProfile
    """m/s2, over the velocity in m/s"""

    @abstractmethod
    def at(self, velocity: Scalar) -> InversePoint:
        """The point at a velocity, m/s; NaN where no altitude has the drag."""

    def air(self, altitude: Scalar, velocity: Scalar) -> AirData:
        nothing = jnp.zeros_like(velocity)
        level = EntryState(altitude, nothing, nothing, velocity, nothing, nothing)
        return air_data(
            self.planet, self.vehicle, level, self.angle_of_attack(velocity)
        )

    def altitude(self, velocity: Scalar) -> Scalar:
        """Where the air is so dense that there is the drag, m."""
        wanted = jnp.log(self.drag(velocity))

        def excess(altitude: Scalar) -> Scalar:
            return jnp.log(self.air(altitude, velocity).drag) - wanted

        middle = jnp.full_like(velocity, 0.5 * (_LOWEST + _HIGHEST))
        searched = newton(
            by_jvp(excess), middle, _SEARCH, lower=_LOWEST, upper=_HIGHEST, falls=True
        )
        found = newton(by_jvp(excess), lax.stop_gradient(searched.x), _AGAIN)
        there = jnp.abs(excess(found.x)) < 1e-9
        inside = (found.x >= _LOWEST) & (found.x <= _HIGHEST)
        return jnp.where(there & inside, found.x, jnp.nan)

    def _upwards(
        self, velocity: Scalar, altitude: Scalar, path: Scalar, bend: Scalar
    ) -> Scalar:
        """Lift over drag that bends the path so: `bend` is its slope over the velocity."""
        radius = self.planet.radius + altitude
        gravity = self.planet.gravity.acceleration(radius)
        sine, cosine = sincos(path)
        drag = self.drag(velocity)
        turning = bend * velocity * (-drag - gravity * sine)
        return (turning - (velocity**2 / radius - gravity) * cosine) / drag


class ExactInverse(AbstractInverse):
    """From the equations of motion as they are: what flies so has the drag.

    For any atmosphere and aerodynamics that are twice differentiable.
    """

    def _path(self, velocity: Scalar) -> tuple[Scalar, Scalar]:
        """Path angle (rad), and altitude (m)."""
        one = jnp.ones_like(velocity)
        altitude, climb = jax.jvp(self.altitude, (velocity,), (one,))
        gravity = self.planet.gravity.acceleration(self.planet.radius + altitude)
        # dr/dV = V sin(gamma) / (-D - g sin(gamma)), solved for the sine.
        sine = -self.drag(velocity) * climb / (velocity + gravity * climb)
        return arcsin(sine), altitude

    def at(self, velocity: Scalar) -> InversePoint:
        one = jnp.ones_like(velocity)
        path, bend, altitude = jax.jvp(self._path, (velocity,), (one,), has_aux=True)
        air = self.air(altitude, velocity)
        up = self._upwards(velocity, altitude, path, bend)
        return InversePoint(altitude, path, up, air.lift / air.drag)


class SmallAngleInverse(AbstractInverse):
    """Equations (19) and (23), corrected: gravity along the path is left out.

    The bracket of (23) is 4/V^2 + (C_D'/C_D)^2 + C_D'/(V C_D) - C_D''/C_D, of which the
    print loses the square and a sign. Where the path is steep, as at the end, what is flown
    so leaves the profile: for the paper's case by some 240 m.
    """

    def at(self, velocity: Scalar) -> InversePoint:
        one = jnp.ones_like(velocity)
        altitude = self.altitude(velocity)

        def log_density(altitude: Scalar) -> Scalar:
            return jnp.log(self.planet.density(altitude))

        _, slope = jax.jvp(log_density, (altitude,), (jnp.ones_like(altitude),))
        steepness = -slope
        air = self.air(altitude, velocity)

        def log_coefficient(velocity: Scalar) -> Scalar:
            # Of the drag, at the altitude: with V^2 and the density taken out.
            there = self.air(lax.stop_gradient(altitude), velocity)
            return jnp.log(there.drag / velocity**2)

        def first(velocity: Scalar) -> Scalar:
            return jax.jvp(log_coefficient, (velocity,), (one,))[1]

        c1, bend = jax.jvp(first, (velocity,), (one,))
        c2 = bend + c1 * c1  # C_D'' / C_D
        drag, d1, d2 = self.drag.with_derivatives(velocity)
        radius = self.planet.radius + altitude
        gravity = self.planet.gravity.acceleration(radius)
        path = (d1 - (2.0 / velocity + c1) * drag) / (velocity * steepness)
        bracket = 4.0 / velocity**2 + c1 * c1 + c1 / velocity - c2
        up = (-d2 + (3.0 / velocity + c1) * d1 - bracket * drag) / steepness
        up = up + (gravity - velocity**2 / radius) / drag
        return InversePoint(altitude, path, up, air.lift / air.drag)
