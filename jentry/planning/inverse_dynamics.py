"""Inverse dynamics of a drag profile: altitude, flight-path angle and upward lift.

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
from ..onboard.model import require_sphere
from ..onboard.profiles import AbstractProfile
from ..units import km
from ..world.planet import Planet
from ..world.vehicle import Vehicle


_LOWEST, _HIGHEST = 0.0, 150.0 * km
_SEARCH = 60
"""Largest number of Newton steps to an altitude, or of bisections where these fail"""
_AGAIN = 3
"""Further Newton steps that are differentiated: exact up to the seventh derivative"""


class InversePoint(eqx.Module):
    """A point of the flight that follows a drag profile."""

    altitude: Scalar = output(unit="m")
    flight_path_angle: Scalar = output(unit="rad")
    lift_to_drag_up: Scalar = output()
    """Lift in the vertical plane over drag: C_L / C_D times the cosine of the bank"""
    lift_to_drag: Scalar = output()
    """Total lift over drag. A bank exists where `lift_to_drag_up` is not larger"""

    @property
    def cos_bank(self) -> Scalar:
        return self.lift_to_drag_up / self.lift_to_drag


class AbstractInverse(eqx.Module):
    """Finds the flight that follows a drag profile, in a plane, over a sphere at rest."""

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
        require_sphere(self.planet, "the inverse of the motion in a plane")
        nothing = jnp.zeros_like(velocity)
        level = EntryState(altitude, nothing, nothing, velocity, nothing, nothing)
        return air_data(
            self.planet, self.vehicle, level, self.angle_of_attack(velocity)
        )

    def altitude(self, velocity: Scalar) -> Scalar:
        """Altitude at which the drag has the value of the profile, m."""
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
        """Upward lift over drag for a flight-path angle with the slope `bend`.

        `bend` is the derivative of the flight-path angle with respect to the velocity.
        """
        radius = self.planet.radius + altitude
        gravity = self.planet.gravity.acceleration(radius)
        sine, cosine = sincos(path)
        drag = self.drag(velocity)
        turning = bend * velocity * (-drag - gravity * sine)
        return (turning - (velocity**2 / radius - gravity) * cosine) / drag


class ExactInverse(AbstractInverse):
    """Exact inverse of the equations of motion: its flight has exactly the planned drag.

    It works for any twice differentiable atmosphere and aerodynamics.
    """

    def _path(self, velocity: Scalar) -> tuple[Scalar, Scalar]:
        """Flight-path angle (rad) and altitude (m)."""
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
    """Equations (19) and (23), corrected. They neglect gravity along the path.

    The bracket of (23) is 4/V^2 + (C_D'/C_D)^2 + C_D'/(V C_D) - C_D''/C_D; the printed
    equation lacks the square and a sign. Where the path is steep, as at the end, the flight
    deviates from the profile: by some 240 m in the case of the paper.
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
            # Drag coefficient at the altitude, apart from constant factors.
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
