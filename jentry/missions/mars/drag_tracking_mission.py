"""The mission of the Mars lander in a plane: its laws, and the values of the paper."""

import numpy as np

from ...units import km
from ..mission import Mission, PublishedValue, standard_deviation
from . import crossings
from .drag_tracking import (
    energy_index,
    independent,
    lift_to_drag_held,
    observer_feedback,
    state_feedback,
    table_3,
    time_index,
)


def _downrange(name: str, value: float, statistic) -> PublishedValue:
    """A published downrange error, which the paper counts as desired minus actual."""
    return PublishedValue(
        f"downrange error, {name}",
        value,
        "km",
        lambda v: statistic(-v["downrange_error"] / km),
    )


def _altitude(name: str, value: float, statistic) -> PublishedValue:
    """A published altitude error, which by its sign is actual minus desired."""
    return PublishedValue(
        f"altitude error, {name}",
        value,
        "km",
        lambda v: statistic(v["altitude_error"] / km),
    )


MISSION = Mission(
    name="mars-drag-tracking",
    title="Mars lander, drag tracking with a high-gain observer",
    source='Yan and He, "Drag-Tracking Guidance for Entry Vehicles Without Drag Rate '
    'Measurement"',
    laws={
        "table-3": table_3,
        "energy-index": energy_index,
        "time-index": time_index,
        "state-feedback": state_feedback,
        "observer-feedback": observer_feedback,
        "pseudospectral": crossings.pseudospectral,
        "pseudospectral-with-range": crossings.pseudospectral_with_range,
    },
    dispersions={
        "lift-to-drag-held": lift_to_drag_held,
        "independent": independent,
    },
    published=(
        _downrange("minimum |.|", 0.0028, lambda e: np.min(abs(e))),
        _downrange("maximum", 24.3249, np.max),
        _downrange("average", 2.3957, np.mean),
        _downrange("standard deviation", 6.7809, standard_deviation),
        _altitude("minimum", -0.0013, np.min),
        _altitude("maximum", 3.9263, np.max),
        _altitude("average", 0.6369, np.mean),
        _altitude("standard deviation", 0.8584, standard_deviation),
    ),
    published_note="Table 3; downrange error desired minus actual, as the paper has it",
    published_law="table-3",
    published_dispersions="lift-to-drag-held",
    published_runs=1000,
)
