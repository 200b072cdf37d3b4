"""What the vehicle measures of its own flight."""

import equinox as eqx

from .._types import Scalar
from ..motion.forces import air_data
from ..motion.state import EntryState
from ..world.planet import Planet
from ..world.vehicle import Vehicle


class Measurement(eqx.Module):
    """All that a law may know of the true flight."""

    state: EntryState
    lift: Scalar
    """Sensed specific force across the relative wind, m/s2"""
    drag: Scalar
    """Sensed specific force along the relative wind, m/s2"""


def measure(
    planet: Planet, vehicle: Vehicle, state: EntryState, angle_of_attack: Scalar
) -> Measurement:
    """Perfect navigation and accelerometers, at an angle of attack (rad)."""
    air = air_data(planet, vehicle, state, angle_of_attack)
    return Measurement(state=state, lift=air.lift, drag=air.drag)
