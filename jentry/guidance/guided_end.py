"""End conditions of guided flight, for a law that predicts the rest of the flight."""

import equinox as eqx
import jax.numpy as jnp

from ..fields import Count, Flag, Scalar, optional_scalar
from ..motion.quantities import energy
from ..motion.state import EntryState
from ..onboard.propagation import Margin
from ..world.planet import Planet


class GuidedEnd(eqx.Module):
    """End conditions of guided flight, as the law assumes them: the first one met ends it.

    Altitudes are geodetic ones if the planet of the onboard model is an ellipsoid.

    The ground ends a flight as well. A flight that has risen to the ceiling has skipped
    out, and would come down too far away.
    """

    velocity: Scalar | None = optional_scalar(unit="m/s")
    altitude: Scalar | None = optional_scalar(unit="m")
    energy: Scalar | None = optional_scalar(unit="J/kg")
    ceiling: Scalar | None = optional_scalar(unit="m")

    def __check_init__(self):
        if self.velocity is None and self.altitude is None and self.energy is None:
            raise ValueError(
                "GuidedEnd has no velocity, no altitude and no energy: give what ends "
                "guided flight"
            )

    def margins(self, planet: Planet) -> tuple[Margin, ...]:
        """Margins to the ends of a prediction; that to a ceiling, if any, is last."""
        found: list[Margin] = []
        velocity, energy_there, ceiling = self.velocity, self.energy, self.ceiling
        lowest = 0.0 if self.altitude is None else self.altitude

        def altitude(state: EntryState) -> Scalar:
            return planet.geodetic_altitude(state.altitude, state.latitude)

        if velocity is not None:
            found.append(lambda state: state.velocity - velocity)
        found.append(lambda state: altitude(state) - lowest)
        if energy_there is not None:
            found.append(lambda state: energy(planet, state) - energy_there)
        if ceiling is not None:
            found.append(lambda state: ceiling - altitude(state))
        return tuple(found)

    def first(self) -> tuple[Scalar, Scalar]:
        """Velocity and altitude that end the flight; the ground if no altitude is set."""
        assert self.velocity is not None
        return self.velocity, 0.0 if self.altitude is None else self.altitude

    def is_skip(self, ended_by: Count) -> Flag:
        """Whether a prediction ended at the ceiling."""
        if self.ceiling is None:
            return jnp.zeros_like(ended_by, dtype=bool)
        before = self.velocity is not None, True, self.energy is not None
        return ended_by == sum(before)
