"""By how much a flight missed its target."""

import equinox as eqx

from .._types import Scalar
from ..motion.quantities import ground_track
from .fly import Flight
from .scenario import Scenario


class Misses(eqx.Module):
    """Differences at the end of the flight, actual minus desired."""

    downrange: Scalar
    """m, positive is too far"""
    crossrange: Scalar
    """m, positive is to the left"""
    altitude: Scalar
    """m"""
    velocity: Scalar
    """m/s"""


def misses(scenario: Scenario, flight: Flight) -> Misses:
    """Misses of a flight of this scenario, along and across its entry direction."""
    target, end = scenario.target, flight.state
    downrange, crossrange = ground_track(scenario.planet, scenario.initial_state, end)
    return Misses(
        downrange=downrange - target.downrange,
        crossrange=crossrange - target.crossrange,
        altitude=end.altitude - target.altitude,
        velocity=end.velocity - target.velocity,
    )
