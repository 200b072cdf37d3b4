"""Dispersions of the SX-2 mission: initial state, air and vehicle."""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add
from ...campaign.distributions import AbstractDistribution, OneOfSeveral, Uniform
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


def _moved(
    name: str, errors: AbstractDistribution, stream: str | None = None
) -> Dispersion:
    where = lambda s: getattr(s.initial_state, name)
    return Dispersion(where, errors, apply=add, stream=stream)


@computed_once
def initial_errors() -> dict[str, Dispersion]:
    """All errors of the initial state at once, uniform."""
    return {
        name.replace("_", " "): _moved(name, Uniform(-most, most))
        for name, most in INITIAL_ERRORS.items()
    }


@computed_once
def one_at_a_time() -> dict[str, Dispersion]:
    """An error of one component of the initial state, uniform, as in the paper."""
    count = len(INITIAL_ERRORS)
    return {
        name.replace("_", " "): _moved(
            name, OneOfSeveral(place, count, most), stream="which"
        )
        for place, (name, most) in enumerate(INITIAL_ERRORS.items())
    }


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """Density by 20 %, lift and drag coefficients by 5 %, uniform."""
    coefficient = Uniform(0.95, 1.05)
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2)),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, coefficient),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, coefficient),
    }


@computed_once
def everything() -> dict[str, Dispersion]:
    """Initial errors, air and vehicle together."""
    return initial_errors() | air_and_vehicle()
