"""The mission SX-2: its laws, and the cases of the paper."""

import dataclasses

import numpy as np

from ...flight.scenario import Scenario
from ...onboard.model import OnboardModel
from ...units import km, nautical_mile
from ..inertial import SHUTTLE_TILT, Errors, Inertial, Sensors, doubt, shuttle_sensors
from ..mission import Change, Mission, PublishedValue
from . import predictor_corrector
from .dispersions import (
    INITIAL_ERRORS,
    air_and_vehicle,
    everything,
    initial_errors,
    off_by,
    one_at_a_time,
)
from .scenario import earth, full, measured, replanned, scheduled, small_angle, vehicle


def _off(**errors: float) -> Change:
    """Change of a scenario to an initial state with these errors: see `off_by`."""

    def change(scenario: Scenario) -> Scenario:
        start = off_by(scenario.initial_state, **errors)
        return dataclasses.replace(scenario, initial_state=start)

    return change


def figures(scenario: Scenario) -> Scenario:
    """Start of figures 1 to 6: 1000 ft higher, and 0.1 degrees ahead and to the left."""
    return _off(altitude=1.0, longitude=1.0, latitude=1.0)(scenario)


def cases() -> dict[str, dict[str, float]]:
    """The twelve initial errors of the paper, one at a time, as shares of the largest."""
    return {
        f"{name.replace('_', '-')}-{side}": {name: sign}
        for name in INITIAL_ERRORS
        for side, sign in (("high", 1.0), ("low", -1.0))
    }


def _case(name: str, errors: dict[str, float]) -> Change:
    change = _off(**errors)
    quantity, side = name.rsplit("-", 1)
    change.__doc__ = (
        f"The largest initial error of the {quantity.replace('-', ' ')}, too {side}."
    )
    return change


def _largest(name: str, variable: str) -> PublishedValue:
    return PublishedValue(
        f"largest {name} error",
        1.0,
        "n mile",
        lambda v: np.max(np.abs(v[variable])) / nautical_mile,
    )


def _sensors(cycle: float) -> Sensors:
    share = doubt(everything(), "density", "drag")
    return shuttle_sensors(OnboardModel(earth(), vehicle()), share, 700.0, cycle)


NAVIGATION = Inertial(
    Errors(position=1.0 * km / 3.0, velocity=1.0 / 3.0, tilt=SHUTTLE_TILT),
    decided=("energy",),
    usual=everything,
    sensors=_sensors,
)
"""Attitude of the Space Shuttle at its entry. Position and velocity are chosen. The
instruments are those of `Errors`. The guided flight ends at the energy that the vehicle
believes, where terminal area energy management begins"""


MISSION = Mission(
    name="sx-2",
    title="SX-2, ground-track tracking by feedback linearization, angle of attack and "
    "bank",
    source='Bharadwaj, Rao and Mease, "Entry Trajectory Tracking Law via Feedback '
    'Linearization"',
    laws={
        "full": full,
        "small-angle": small_angle,
        "measured": measured,
        "scheduled": scheduled,
        "replanned": replanned,
        "predictor-corrector": predictor_corrector.guided,
    },
    cases={
        "figures": figures,
        **{name: _case(name, errors) for name, errors in cases().items()},
    },
    worlds={"inertial": NAVIGATION.world, "aided": NAVIGATION.aided},
    former_variants={name: f"full case {name}" for name in ("figures", *cases())},
    dispersions={
        "initial-errors": initial_errors,
        "one-at-a-time": one_at_a_time,
        "air-and-vehicle": air_and_vehicle,
        "everything": everything,
        "knowledge": NAVIGATION.knowledge,
        "everything-and-knowledge": NAVIGATION.usual_and_knowledge,
    },
    gains=("guidance.gains",),
    published=(
        _largest("downrange", "downrange_error"),
        _largest("crossrange", "crossrange_error"),
    ),
    published_note="the bound of its text for errors one at a time",
    published_law="full",
    published_dispersions="one-at-a-time",
    published_runs=1000,
)
