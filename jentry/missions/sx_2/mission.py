"""The mission SX-2: its variants, the cases of the paper among them."""

import dataclasses

from ...flight.scenario import Scenario
from ..mission import Mission
from .dispersions import (
    INITIAL_ERRORS,
    air_and_vehicle,
    everything,
    initial_errors,
    off_by,
)
from .scenario import full, measured, replanned, small_angle


def case(**errors: float) -> Scenario:
    """The full law from an initial state that is off the reference; see `off_by`."""
    nominal = full()
    start = off_by(nominal.initial_state, **errors)
    return dataclasses.replace(nominal, initial_state=start)


def figure_case() -> Scenario:
    """Figures 1 to 6: 1000 ft higher, and 0.1 degrees ahead and to the left."""
    return case(altitude=1.0, longitude=1.0, latitude=1.0)


def one_at_a_time() -> dict[str, dict[str, float]]:
    """The twelve cases of the paper, by name: errors in units of the largest ones."""
    return {
        f"{name.replace('_', '-')}-{side}": {name: sign}
        for name in INITIAL_ERRORS
        for side, sign in (("high", 1.0), ("low", -1.0))
    }


def _builder(errors: dict[str, float]):
    return lambda: case(**errors)


MISSION = Mission(
    name="sx-2",
    title="SX-2, ground-track tracking by feedback linearization, angle of attack and "
    "bank",
    source='Bharadwaj, Rao and Mease, "Entry Trajectory Tracking Law via Feedback '
    'Linearization"',
    variants={
        "full": full,
        "small-angle": small_angle,
        "measured": measured,
        "replanned": replanned,
        "figures": figure_case,
        **{name: _builder(errors) for name, errors in one_at_a_time().items()},
    },
    dispersions={
        "initial-errors": initial_errors,
        "air-and-vehicle": air_and_vehicle,
        "everything": everything,
    },
    gains=("guidance.gains",),
)
