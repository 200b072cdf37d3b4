"""Plans a glide over the velocity: constant heating first, then near-equilibrium glide."""

from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer

from .._math import smoothstep
from .._newton import by_jvp, newton
from .._setup import needs_float64
from ..fields import Scalar, scalar
from ..motion.forces import AirData, air_data
from ..motion.index import VelocityIndex
from ..motion.state import EntryState
from ..onboard.model import require_sphere
from ..onboard.profiles import AbstractProfile, grid, quintic_table
from ..onboard.reference import Reference
from ..units import degree
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ._differences import with_differences


_LOWEST, _HIGHEST = 0.0, 120e3
"""Bounds of the search for an altitude, m"""
_SEARCH = 60
"""Largest number of Newton steps from the middle of the bounds; usually ten"""
_MET = 1e-9
"""Largest error of the logarithm before the last step of a successful search"""


class Glide(eqx.Module):
    """Parameters of a planned glide.

    At high velocity sqrt(density) V^heating_power is constant. At low velocity the lift at
    a constant bank balances the weight less the centrifugal force:
    L cos(bank) = g0 (1 - V^2), with V in units of the circular velocity. Between the two
    parts the slope of the logarithm of the density is blended. The constant of the heating
    part follows from continuity.
    """

    bank: Scalar = scalar(60.0 * degree, unit="rad")
    """Bank of the equilibrium glide. The bank that flies the plan differs from it"""
    heating_power: Scalar = scalar(3.15)
    join: Scalar = scalar(5000.0, unit="m/s", positive=True)
    """Velocity at the middle of the blend"""
    blend: Scalar = scalar(100.0, unit="m/s", positive=True)
    """Half of the width of the blend"""
    least_weight: Scalar = scalar(1e-3, positive=True)
    """Lower limit of 1 - V^2"""
    first: Scalar = scalar(7800.0, unit="m/s", positive=True)
    """Velocity at which the plan begins"""
    last: Scalar = scalar(1000.0, unit="m/s", positive=True)
    """Velocity at which the plan ends"""


@needs_float64
def plan_glide(
    planet: Planet,
    vehicle: Vehicle,
    angle_of_attack: AbstractProfile,
    glide: Glide | None = None,
    intervals: int = 3400,
) -> Reference:
    """Plan a glide, and the bank that flies it, over the velocity (m/s).

    The planet does not rotate, and the equilibrium glide uses the gravity at the surface.
    The reference contains altitude (m), flight-path angle, bank and angle of attack (rad),
    drag and lift (m/s2), altitude rate (m/s) and lift_to_drag_up, the ratio of the upward
    lift to the drag.

    The equations of motion give the flight-path angle from the altitude over the velocity,
    and the bank from the flight-path angle over the velocity. The atmosphere must be twice
    continuously differentiable, or the bank jumps: see `smoothed`.

    **Arguments:**

    - `angle_of_attack`: rad, over the Mach number.
    - `glide`: None for `Glide()`, which has the values of the paper.
    - `intervals`: number of intervals of the table; four or more.

    **Raises:** `ValueError` if there is no such altitude or bank. Under `jit` the values
    are NaN instead.
    """
    require_sphere(planet, "a glide")
    glide = Glide() if glide is None else glide
    world = _World(planet, vehicle, angle_of_attack, glide)
    nodes = grid(glide.last, glide.first, 2 * intervals)
    half = nodes[1] - nodes[0]

    # Simpson's rule over pairs of intervals.
    slopes = jnp.asarray(jax.vmap(world.slope)(nodes))
    parts = slopes[:-2:2] + 4.0 * slopes[1:-1:2] + slopes[2::2]
    start = world.log_density(world.glide_altitude(glide.last))
    logarithms = start + half / 3.0 * jnp.append(0.0, jnp.cumsum(parts))
    velocities, slopes = nodes[::2], slopes[::2]

    def there(velocity: Scalar, logarithm: Scalar, slope: Scalar) -> dict[str, Scalar]:
        altitude = world.altitude_at(logarithm)
        one = jnp.ones_like(altitude)
        _, per_metre = jax.jvp(world.log_density, (altitude,), (one,))
        climb = slope / per_metre
        angle, air = world.air(altitude, velocity)
        gravity = planet.gravity.acceleration(planet.radius + altitude)
        sine = -air.drag * climb / (velocity + gravity * climb)
        return {
            "altitude": altitude,
            "flight_path_angle": jnp.arcsin(sine),
            "angle_of_attack": angle,
            "drag": air.drag,
            "lift": air.lift,
            "altitude_rate": velocity * sine,
        }

    flown = jax.vmap(there)(velocities, logarithms, slopes)
    found = {name: jnp.asarray(column) for name, column in flown.items()}
    path = found["flight_path_angle"]
    spacing = velocities[1] - velocities[0]
    _, bend, _ = with_differences(path, spacing)

    def upwards(velocity: Scalar, here: Mapping[str, Scalar], bend: Scalar) -> Scalar:
        """Specific lift in the vertical plane, m/s2."""
        radius, path = planet.radius + here["altitude"], here["flight_path_angle"]
        gravity = planet.gravity.acceleration(radius)
        slows = -here["drag"] - gravity * jnp.sin(path)
        centrifugal = velocity**2 / radius - gravity
        return velocity * bend * slows - centrifugal * jnp.cos(path)

    up = jax.vmap(upwards)(velocities, found, bend)
    found["bank"] = jnp.arccos(up / found["lift"])
    found["lift_to_drag_up"] = up / found["drag"]
    if not isinstance(up, Tracer) and not np.all(np.isfinite(found["bank"])):
        lost = float(velocities[np.argmin(np.isfinite(found["bank"]))])
        raise ValueError(
            f"no glide is found at {lost:g} m/s: no altitude up to {_HIGHEST / 1e3:g} km "
            "has the density, or no bank the lift; try another bank, or velocities"
        )
    table = {name: with_differences(x, spacing) for name, x in found.items()}
    return Reference(VelocityIndex(), quintic_table(velocities, table))


class _World(eqx.Module):
    """Planet, vehicle, angle of attack and parameters of a glide."""

    planet: Planet
    vehicle: Vehicle
    angle_of_attack: AbstractProfile
    glide: Glide

    def log_density(self, altitude: Scalar) -> Scalar:
        return jnp.log(self.planet.density(altitude))

    def air(self, altitude: Scalar, velocity: Scalar) -> tuple[Scalar, AirData]:
        """Angle of attack (rad) and air data at an altitude and a velocity."""
        mach = velocity / self.planet.atmosphere.speed_of_sound(altitude)
        angle = self.angle_of_attack(mach)
        nothing = jnp.zeros_like(velocity)
        level = EntryState(altitude, nothing, nothing, velocity, nothing, nothing)
        return angle, air_data(self.planet, self.vehicle, level, angle)

    def altitude_at(self, logarithm: Scalar) -> Scalar:
        """Altitude (m) at which the logarithm of the density has a value."""
        middle = jnp.full_like(logarithm, 0.5 * (_LOWEST + _HIGHEST))
        return _root(lambda z: logarithm - self.log_density(z), middle)

    def glide_altitude(self, velocity: Scalar) -> Scalar:
        """Altitude (m) of the equilibrium glide at a velocity."""
        gravity = self.planet.gravity.acceleration(self.planet.radius)
        share = velocity**2 / (gravity * self.planet.radius)
        carried = jnp.maximum(1.0 - share, self.glide.least_weight) * gravity

        def excess(altitude: Scalar) -> Scalar:
            _, air = self.air(altitude, velocity)
            return jnp.log(carried) - jnp.log(air.lift * jnp.cos(self.glide.bank))

        return _root(excess, jnp.full_like(velocity, 40e3))

    def slope(self, velocity: Scalar) -> Scalar:
        """Derivative of the logarithm of the density over the velocity, s/m."""
        glide = self.glide

        def in_glide(velocity: Scalar) -> Scalar:
            return self.log_density(self.glide_altitude(velocity))

        _, gliding = jax.jvp(in_glide, (velocity,), (jnp.ones_like(velocity),))
        heating = -2.0 * glide.heating_power / velocity
        share = smoothstep((velocity - glide.join) / (2.0 * glide.blend) + 0.5)
        return gliding + share * (heating - gliding)


def _root(excess: Callable[[Scalar], Scalar], start: Scalar) -> Scalar:
    """Altitude at which `excess` is zero between the bounds; NaN if there is none."""
    search = newton(by_jvp(excess), start, _SEARCH, lower=_LOWEST, upper=_HIGHEST)
    found = newton(by_jvp(excess), lax.stop_gradient(search.x), 2)
    met = jnp.abs(found.value) < _MET
    return jnp.where(met, found.x, jnp.nan)
