"""The mission `msl`: its laws, worlds and dispersions."""

import dataclasses

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion
from ..mars.range_tracking import NAVIGATION as LANDER_NAVIGATION
from ..mission import Mission
from ..npcg_toolbox import through_fitted_mars_air
from .delivery import as_estimated
from .dispersions import (
    air_and_vehicle,
    entry_errors,
    everything,
    everything_with_wind,
    waves,
    wind,
)
from .laws import predictor_corrector, terminal_point
from .scenario import entry_state, planet
from .worlds import range_trigger, wind_and_waves


NAVIGATION = dataclasses.replace(
    LANDER_NAVIGATION, decided=("velocity", "range"), usual=everything
)
"""Errors and sensors are those of `mars-range-tracking`: position and velocity as required
of this spacecraft at its entry, 2.8 km and 2 m/s at three sigma. The sensors of the world
`aided` are those of a future lander. The vehicle opens its parachute by the velocity, or by
the range to go, that it believes"""


def _all_errors() -> dict[str, Dispersion]:
    """Entry, air, vehicle, wind, waves, and what navigation knows."""
    return everything_with_wind() | dict(NAVIGATION.knowledge())


@computed_once
def _estimated() -> dict[str, Dispersion]:
    """`everything-and-knowledge`, where the knowledge at the entry is a best estimate.

    The knowledge errors are correlated with the delivery errors.
    """
    around = planet()
    errors = dict(NAVIGATION.usual_and_knowledge())
    return as_estimated(errors, around, entry_state(around))


MISSION = Mission(
    name="msl",
    title="Mars Science Laboratory, the terminal-point law of its guided entry",
    source='NPCG Toolbox of Lee, Lee and Wie; Mendeck and McGrew, "Entry Guidance Design '
    'and Postflight Performance for 2011 Mars Science Laboratory Mission"',
    laws={
        "terminal-point": terminal_point,
        "predictor-corrector": predictor_corrector,
    },
    worlds={
        "wind-and-waves": wind_and_waves,
        "fitted-air": through_fitted_mars_air,
        "range-trigger": range_trigger,
        "inertial": NAVIGATION.world,
        "aided": NAVIGATION.aided,
    },
    dispersions={
        "everything": everything,
        "entry-errors": entry_errors,
        "air-and-vehicle": air_and_vehicle,
        "wind": wind,
        "waves": waves,
        "everything-with-wind": everything_with_wind,
        "knowledge": NAVIGATION.knowledge,
        "everything-and-knowledge": NAVIGATION.usual_and_knowledge,
        "everything-and-estimated-knowledge": _estimated,
        "everything-with-wind-and-knowledge": _all_errors,
    },
    gains=("guidance.gain", "guidance.lateral.floor"),
)
