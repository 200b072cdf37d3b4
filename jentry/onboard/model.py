"""What a law believes of planet and vehicle."""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._newton import by_jvp, newton
from ..fields import Scalar
from ..motion.forces import speed_over_air
from ..motion.state import EntryState
from ..world.aerodynamics import AbstractInvertibleAerodynamics
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ..world.wind import StillAir


_INVERSIONS = 5
"""Newton steps for the angle of attack; a lift that is linear in it takes one"""


class OnboardModel(eqx.Module):
    """The nominal world on board: a copy of its own, which dispersing the truth leaves.

    Any atmosphere, gravity and aerodynamics. What laws need beside the forces is taken
    from these by forward differentiation, in the state and at the angle of attack (rad)
    that are flown.
    """

    planet: Planet
    vehicle: Vehicle

    def scale_height(self, state: EntryState) -> Scalar:
        """Density over its decrease with altitude, -rho / rho', m."""
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

        Its rate is that of the drag in units of the drag, whatever factor the actual
        drag has on the modelled one.
        """
        _, drag = self._coefficients(state, angle_of_attack)
        density = self._above(state).density(state.altitude)
        airspeed = speed_over_air(self.planet.wind, state)
        return jnp.log(density) + 2.0 * jnp.log(airspeed) + jnp.log(drag)

    def angle_of_attack_for(
        self, state: EntryState, lift: Scalar, least: Scalar, largest: Scalar
    ) -> Scalar:
        """Angle of attack between two bounds (rad) at which there is a lift (m/s2).

        The lift coefficient must rise between the bounds; where no angle
        between them has the lift it is the bound that comes nearest.
        """
        here, airspeed = self._above(state), speed_over_air(self.planet.wind, state)
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
        """Lift and drag coefficient, each with its slope over that angle, 1/rad."""
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
        airspeed = speed_over_air(self.planet.wind, state)
        return self.vehicle.coefficients(angle_of_attack, airspeed / sound, airspeed)


def require_still_air(planet: Planet, what: str, instead: str = "") -> None:
    """Refuse a planet of a model whose wind would be left out, where it is computed.

    **Arguments:**

    - `what`: that takes the air to be still, as the subject of a sentence.
    - `instead`: what to do beside taking the wind off.

    **Raises:** `ValueError` for any wind but `StillAir`.
    """
    if not isinstance(planet.wind, StillAir):
        raise ValueError(
            f"the planet of the onboard model has a {type(planet.wind).__name__}, and "
            f"{what} takes the air to be still: give the model StillAir(){instead}"
        )
