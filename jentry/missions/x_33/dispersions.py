"""Dispersions of the X-33 mission: initial state, air and vehicle."""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add
from ...campaign.distributions import Uniform
from .cases import CASES


def _initial(name: str) -> Dispersion:
    most = max(abs(getattr(errors, name)) for errors in CASES)
    where = lambda s: getattr(s.initial_state, name)
    return Dispersion(where, Uniform(-most, most), apply=add)


@computed_once
def initial_errors() -> dict[str, Dispersion]:
    """All errors of the initial state at once, uniform, up to the largest of the tables."""
    return {
        "altitude": _initial("altitude"),
        "velocity": _initial("velocity"),
        "flight-path angle": _initial("flight_path_angle"),
    }


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """Density by 10 %, lift and drag coefficients by 5 %, uniform; the paper has none."""
    coefficient = Uniform(0.95, 1.05)
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.9, 1.1)),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, coefficient),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, coefficient),
    }


@computed_once
def everything() -> dict[str, Dispersion]:
    """Initial errors, air and vehicle together."""
    return initial_errors() | air_and_vehicle()
