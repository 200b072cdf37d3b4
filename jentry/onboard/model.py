"""The onboard model: the planet and vehicle that a law assumes."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._newton import by_jvp, newton
from ..fields import Scalar
from ..motion.forces import speed_over_air, wind_at
from ..motion.state import EntryState
from ..world.aerodynamics import AbstractInvertibleAerodynamics
from ..world.planet import Planet
from ..world.shape import Sphere
from ..world.vehicle import Vehicle
from ..world.wind import StillAir


_INVERSIONS = 5
"""Newton steps for the angle of attack; a lift that is linear in it needs one"""


class OnboardModel(eqx.Module):
    """Nominal planet and vehicle on board, which dispersions of the truth do not change.

    Any atmosphere, gravity and aerodynamics can be used. Quantities that laws need beside
    the forces are computed from these by forward differentiation, in the actual state and
    at the actual angle of attack (rad). Laws whose equations are those of a sphere with a
    central gravity refuse another planet; that of the scenario may be another one.
    """

    planet: Planet
    vehicle: Vehicle

    def scale_height(self, state: EntryState) -> Scalar:
        """Scale height of the density, -rho / rho', m."""
        altitude = state.altitude
        density, slope = jax.jvp(
            self._above(state).density, (altitude,), (jnp.ones_like(altitude),)
        )
        return -density / slope

    def lift_to_drag(self, state: EntryState, angle_of_attack: Scalar) -> Scalar:
        """Ratio of lift to drag."""
        lift, drag = self._coefficients(state, angle_of_attack)
        return lift / drag

    def ballistic_coefficient(
        self, state: EntryState, angle_of_attack: Scalar
    ) -> Scalar:
        """m / (C_D S), kg/m2."""
        _, drag = self._coefficients(state, angle_of_attack)
        return self.vehicle.mass / (drag * self.vehicle.reference_area)

    def logarithm_of_drag(self, state: EntryState, angle_of_attack: Scalar) -> Scalar:
        """Natural logarithm of the drag, up to a constant.

        Its rate is that of the drag in units of the drag, for any constant factor between
        actual and modelled drag.
        """
        _, drag = self._coefficients(state, angle_of_attack)
        density = self._above(state).density(state.altitude)
        airspeed = speed_over_air(wind_at(self.planet, state), state)
        return jnp.log(density) + 2.0 * jnp.log(airspeed) + jnp.log(drag)

    def angle_of_attack_for(
        self, state: EntryState, lift: Scalar, least: Scalar, largest: Scalar
    ) -> Scalar:
        """Angle of attack between two bounds (rad) that gives a lift (m/s2).

        The lift coefficient must rise between the bounds. If no angle between them gives
        the lift, the result is the nearer bound.
        """
        here, airspeed = (
            self._above(state),
            speed_over_air(wind_at(self.planet, state), state),
        )
        pressure = 0.5 * here.density(state.altitude) * airspeed * airspeed
        wanted = lift * self.vehicle.mass / (pressure * self.vehicle.reference_area)
        aerodynamics = self.vehicle.aerodynamics
        if isinstance(aerodynamics, AbstractInvertibleAerodynamics):
            mach = airspeed / here.atmosphere.speed_of_sound(state.altitude)
            wanted = wanted / self.vehicle.lift_scale
            angle = aerodynamics.angle_of_attack(wanted, mach, airspeed)
            return jnp.clip(angle, least, largest)

        def excess(angle: Scalar) -> Scalar:
            return self._coefficients(state, angle)[0] - wanted

        middle = 0.5 * (least + largest)
        return newton(by_jvp(excess), middle, _INVERSIONS, lower=least, upper=largest).x

    def coefficients_with_slopes(
        self, state: EntryState, angle_of_attack: Scalar
    ) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """Lift and drag coefficient, each with its slope over the angle, 1/rad."""
        (lift, drag), (lift_slope, drag_slope) = jax.jvp(
            lambda angle: self._coefficients(state, angle),
            (angle_of_attack,),
            (jnp.ones_like(angle_of_attack),),
        )
        return (lift, lift_slope), (drag, drag_slope)

    def _above(self, state: EntryState) -> Planet:
        return self.planet.above(state.longitude, state.latitude)

    def _coefficients(
        self, state: EntryState, angle_of_attack: Scalar
    ) -> tuple[Scalar, Scalar]:
        sound = self._above(state).atmosphere.speed_of_sound(state.altitude)
        airspeed = speed_over_air(wind_at(self.planet, state), state)
        return self.vehicle.coefficients(angle_of_attack, airspeed / sound, airspeed)


def require_still_air(planet: Planet, what: str, instead: str = "") -> None:
    """Refuse a planet with a wind, for a computation that neglects it.

    **Arguments:**

    - `what`: computation that assumes still air, as the subject of a sentence.
    - `instead`: alternative to removing the wind.

    **Raises:** `ValueError` for any wind but `StillAir`.
    """
    if not isinstance(planet.wind, StillAir):
        raise ValueError(
            f"the planet of the onboard model has a {type(planet.wind).__name__}, and "
            f"{what} takes the air to be still: give the model StillAir(){instead}"
        )


def require_sphere(planet: Planet, what: str, instead: str = "") -> None:
    """Refuse an ellipsoid and a gravity that is not central, for a computation that
    neglects them.

    **Arguments:**

    - `what`: computation that assumes a sphere, as the subject of a sentence.
    - `instead`: alternative to another planet.

    **Raises:** `ValueError` for any shape but `Sphere`, and for a gravity that depends on
    the latitude.
    """
    found = []
    if not isinstance(planet.shape, Sphere):
        found.append(f"the shape {type(planet.shape).__name__}")
    if not planet.gravity.is_central:
        found.append(f"a {type(planet.gravity).__name__}")
    if found:
        raise ValueError(
            f"the planet of the onboard model has {' and '.join(found)}, and {what} takes "
            "it to be a sphere with a central gravity: give the model Sphere() and "
            f"InverseSquareGravity{instead}; the planet of the scenario may differ"
        )
