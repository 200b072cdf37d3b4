"""The four cases of Tables 1 and 2, and the values that the paper prints of them."""

import dataclasses
from typing import NamedTuple

from ...flight.scenario import Scenario
from ...motion.state import EntryState
from ...units import degree, km


class Errors(NamedTuple):
    """Errors with respect to the reference, at the start or at the end, in SI units."""

    altitude: float
    velocity: float
    flight_path_angle: float
    downrange: float = 0.0


def _printed(
    altitude: float, velocity: float, path: float, downrange: float = 0.0
) -> Errors:
    """Errors from numbers in km, m/s, degrees and km."""
    return Errors(altitude * km, velocity, path * degree, downrange * km)


CASES = (
    _printed(0.5, 80.0, 0.9),
    _printed(-0.5, -80.0, -0.9),
    _printed(1.7, 50.0, 0.3),
    _printed(-1.7, -50.0, -0.3),
)
"""The initial errors, which are equal in both tables"""

TABLE_1 = (
    _printed(5.168, 315.18, 2.664, 379.59),
    _printed(-4.728, -202.239, -3.981, -296.86),
    _printed(1.656, 88.346, 1.072, 115.21),
    _printed(-1.614, -76.47, -1.200, -106.2),
)
"""Open loop, as printed. It is not reproduced with these signs of the initial errors"""

TABLE_2 = (
    _printed(-1.394e-3, 0.468, 0.002, 100.83),
    _printed(1.7488e-3, -0.894, -0.004, -83.92),
    _printed(-0.986e-3, 0.313, 0.001, 59.44),
    _printed(0.994e-3, -0.527, -0.002, -56.74),
)
"""Closed loop. The printed altitudes of cases 3 and 4 lack "e-3"; corrected"""


def off_by(state: EntryState, errors: Errors) -> EntryState:
    """A state with errors of altitude, velocity and flight-path angle."""
    return dataclasses.replace(
        state,
        altitude=state.altitude + errors.altitude,
        velocity=state.velocity + errors.velocity,
        flight_path_angle=state.flight_path_angle + errors.flight_path_angle,
    )


def case(scenario: Scenario, number: int) -> Scenario:
    """A scenario that starts with the errors of a case, from 1 to 4."""
    start = off_by(scenario.initial_state, CASES[number - 1])
    return dataclasses.replace(scenario, initial_state=start)
