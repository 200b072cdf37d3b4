"""Plan a glide over the velocity: constant heating first, then near equilibrium."""

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
from ..onboard.profiles import AbstractProfile, grid, quintic_table
from ..onboard.reference import Reference
from ..units import degree
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ._differences import with_differences


_LOWEST, _HIGHEST = 0.0, 120e3
"""m, between which altitudes are looked for"""
_SEARCH = 60
"""Newton steps, from the middle: most searches take ten"""
_MET = 1e-9
"""Of a logarithm, where the last step of a search began"""


class Glide(eqx.Module):
    """What a glide is planned by.

    At high velocity sqrt(density) V^heating_power is constant. At low velocity the lift at
    a bank carries the weight less the centrifugal force: L cos(bank) = g0 (1 - V^2), with
    V in units of the circular velocity. Between, the slope of the logarithm of the density
    goes from the one to the other, and the altitudes of the heating are those that meet it.
    """

    bank: Scalar = scalar(60.0 * degree, unit="rad")
    """Of the equilibrium glide; the bank that flies the plan is another"""
    heating_power: Scalar = scalar(3.15)
    join: Scalar = scalar(5000.0, unit="m/s", positive=True)
    """Velocity of the middle of the blend"""
    blend: Scalar = scalar(100.0, unit="m/s", positive=True)
    """Half of its width"""
    least_weight: Scalar = scalar(1e-3, positive=True)
    """Of 1 - V^2"""
    first: Scalar = scalar(7800.0, unit="m/s", positive=True)
    """Velocity at which the plan begins"""
    last: Scalar = scalar(1000.0, unit="m/s", positive=True)
    """Velocity at which it ends"""


@needs_float64
def plan_glide(
    planet: Planet,
    vehicle: Vehicle,
    angle_of_attack: AbstractProfile,
    glide: Glide | None = None,
    intervals: int = 3400,
) -> Reference:
    """A glide with the bank that flies it, over the velocity (m/s).

    Over a planet at rest, with the gravity at the surface for its unit of force. Altitude
    (m), path angle, bank and angle of attack (rad), drag and lift (m/s2), altitude rate
    (m/s) and lift_to_drag_up, the ratio of the lift upwards to the drag.

    The altitude over the velocity gives the path angle by the equations of motion, and
    that over the velocity the bank. The atmosphere must be twice continuously
    differentiable, or the bank jumps: see `smoothed`.

    **Arguments:**

    - `angle_of_attack`: rad, over the Mach number.
    - `glide`: the `Glide()` of the paper if not given.
    - `intervals`: of the table; four or more.

    **Raises:** `ValueError` where there is no such altitude or bank, as far as that is
    known: under `jit` it is NaN.
    """
    glide = Glide() if glide is None else glide
    world = _World(planet, vehicle, angle_of_attack, glide)
    nodes = grid(glide.last, glide.first, 2 * intervals)
    half = nodes[1] - nodes[0]

    # Simpson's rule from node to node, over every second one.
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
    """What flies through what, and how."""

    planet: Planet
    vehicle: Vehicle
    angle_of_attack: AbstractProfile
    glide: Glide

    def log_density(self, altitude: Scalar) -> Scalar:
        return jnp.log(self.planet.density(altitude))

    def air(self, altitude: Scalar, velocity: Scalar) -> tuple[Scalar, AirData]:
        """The angle of attack (rad) there, and the air."""
        mach = velocity / self.planet.atmosphere.speed_of_sound(altitude)
        angle = self.angle_of_attack(mach)
        nothing = jnp.zeros_like(velocity)
        level = EntryState(altitude, nothing, nothing, velocity, nothing, nothing)
        return angle, air_data(self.planet, self.vehicle, level, angle)

    def altitude_at(self, logarithm: Scalar) -> Scalar:
        """Altitude (m) at which the density has a logarithm."""
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
    """Where a logarithm is met between the altitudes; NaN where it is not."""
    search = newton(by_jvp(excess), start, _SEARCH, lower=_LOWEST, upper=_HIGHEST)
    found = newton(by_jvp(excess), lax.stop_gradient(search.x), 2)
    met = jnp.abs(found.value) < _MET
    return jnp.where(met, found.x, jnp.nan)
