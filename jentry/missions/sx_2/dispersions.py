"""What is uncertain in the SX-2 mission: the initial state, the air and the vehicle."""

import functools

from ...campaign.dispersions import Dispersion, Uniform, add
from ...motion.state import EntryState
from ...units import degree, foot


INITIAL_ERRORS = {
    "altitude": 1000.0 * foot,
    "longitude": 0.1 * degree,
    "latitude": 0.1 * degree,
    "velocity": 100.0 * foot,
    "flight_path_angle": 0.1 * degree,
    "heading": 0.1 * degree,
}
"""Largest error of each component of the initial state, to either side"""


def off_by(state: EntryState, **errors: float) -> EntryState:
    """A state with errors in units of the largest ones, such as `altitude=-1`."""
    moved = {
        name: getattr(state, name) + share * INITIAL_ERRORS[name]
        for name, share in errors.items()
    }
    return EntryState(**{**vars(state), **moved})


@functools.cache
def initial_errors() -> dict[str, Dispersion]:
    """All errors of the initial state at once, uniform; the paper has one at a time."""

    def moved(name: str) -> Dispersion:
        most = INITIAL_ERRORS[name]
        where = lambda s: getattr(s.initial_state, name)
        return Dispersion(where, Uniform(-most, most), apply=add)

    return {name.replace("_", " "): moved(name) for name in INITIAL_ERRORS}


@functools.cache
def air_and_vehicle() -> dict[str, Dispersion]:
    """Density by 20 %, lift and drag coefficients by 5 %, uniform."""
    coefficient = Uniform(0.95, 1.05)
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2)),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, coefficient),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, coefficient),
    }


@functools.cache
def everything() -> dict[str, Dispersion]:
    """Initial errors, air and vehicle together."""
    return initial_errors() | air_and_vehicle()
