"""Lateral logic of an aerocapture: bank reversals at the limits of the inclination."""

import equinox as eqx
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, scalar
from ..motion.orbit import inertial_velocity, orbit_of
from ..onboard.measurement import Measurement
from ..world.planet import Planet
from .lateral import AbstractCorridor, Destination, reverse_bank
from .switching import AbstractSwitching, Sharp


class OrbitPlane(eqx.Module):
    """The plane that a law steers to, in the onboard model."""

    planet: Planet
    inclination: Scalar
    """rad"""


class InclinationCorridor(AbstractCorridor):
    """Reverses the bank if the inclination of the orbit is too far from that of the target.

    The corridor is |inclination error| <= floor + widening V^2, with the velocity relative
    to the planet. Within it the bank is not reversed. A bank to the right lowers the
    inclination while the vehicle flies northwards, and raises it while it flies southwards.
    Where it flies due east or west, at its largest latitude, the inclination cannot be
    lowered.
    """

    floor: Scalar = scalar(unit="rad", positive=True)
    widening: Scalar = scalar(0.0, unit="rad s2/m2", range=NOT_NEGATIVE)
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""
    switching: AbstractSwitching = Sharp()

    def half_width(self, velocity: Scalar) -> Scalar:
        """Half width of the corridor, rad."""
        return self.floor + self.widening * velocity * velocity

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: Scalar,
        destination: Destination | OrbitPlane | None,
    ) -> Scalar:
        if not isinstance(destination, OrbitPlane):
            raise ValueError(
                "an InclinationCorridor is about the inclination of a target orbit, and "
                "this law has none: give an AerocaptureGuidance a target with an "
                "inclination, or take FixedSide()"
            )
        planet, state = destination.planet, measurement.state
        too_much = orbit_of(planet, state).inclination - destination.inclination
        northwards = inertial_velocity(planet, state).north > 0.0
        # As a length and positive to the left, in which smooth switching measures it.
        miss = planet.radius * jnp.where(northwards, too_much, -too_much)
        half_width = planet.radius * self.half_width(state.velocity)
        return reverse_bank(side, miss, half_width, self.switching)
