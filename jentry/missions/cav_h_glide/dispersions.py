"""What is uncertain in the mission CAV-H glide. All of it is our own: round numbers."""

import functools

from ...campaign.dispersions import Dispersion, add, multiply
from ...campaign.distributions import Normal
from ...units import degree


def _initial(name: str, three_sigma: float) -> Dispersion:
    where = lambda s: getattr(s.initial_state, name)
    return Dispersion(where, Normal(0.0, three_sigma / 3.0), apply=add)


@functools.cache
def entry_errors() -> dict[str, Dispersion]:
    """Of the state at entry: a tenth of a degree of each angle, and 10 m/s, at 3 sigma."""
    tenth = 0.1 * degree
    return {
        "longitude": _initial("longitude", tenth),
        "latitude": _initial("latitude", tenth),
        "velocity": _initial("velocity", 10.0),
        "flight-path angle": _initial("flight_path_angle", tenth),
        "heading": _initial("heading", tenth),
    }


@functools.cache
def air_and_vehicle() -> dict[str, Dispersion]:
    """At 3 sigma 30 % of the density, 10 % of each coefficient and 5 % of the mass."""
    coefficient = Normal(1.0, 0.1 / 3.0)
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Normal(1.0, 0.3 / 3.0)),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, coefficient),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, coefficient),
        "mass": Dispersion(
            lambda s: s.vehicle.mass, Normal(1.0, 0.05 / 3.0), apply=multiply
        ),
    }


@functools.cache
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()
