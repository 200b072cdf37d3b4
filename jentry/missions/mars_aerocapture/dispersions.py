"""Dispersions of the Mars aerocapture: those of Gelly and Vernis, AIAA 2009-5664.

Their table is quoted as in `scenario`. It prints three sigma of the normal distributions.
"""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add, multiply
from ...campaign.distributions import Normal, Uniform
from ...units import degree


@computed_once
def entry_errors() -> dict[str, Dispersion]:
    """Errors of place and velocity at the entry."""
    return {
        "longitude": Dispersion(
            lambda s: s.initial_state.longitude, Normal(0.0, 1.5 * degree / 3), add
        ),
        "latitude": Dispersion(
            lambda s: s.initial_state.latitude, Normal(0.0, 0.15 * degree / 3), add
        ),
        "velocity": Dispersion(
            lambda s: s.initial_state.velocity, Normal(0.0, 4.5 / 3), add
        ),
        "flight_path_angle": Dispersion(
            lambda s: s.initial_state.flight_path_angle,
            Normal(0.0, 0.6 * degree / 3),
            add,
        ),
        "heading": Dispersion(
            lambda s: s.initial_state.heading, Normal(0.0, 0.15 * degree / 3), add
        ),
    }


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """Errors of the density, the mass and the coefficients."""
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.5, 1.5)),
        "mass": Dispersion(lambda s: s.vehicle.mass, Uniform(0.99, 1.01), multiply),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, Uniform(0.95, 1.05)),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, Uniform(0.9, 1.1)),
    }


@computed_once
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()
