"""Worlds of the mission `msl`: wind and waves, and the range trigger."""

import dataclasses

from ...flight.scenario import Scenario
from ...flight.termination import RangeToGoBelow, Termination, VelocityBelow
from ...motion.quantities import from_ground_track
from ...units import km
from ...world.perturbed_atmosphere import DensityWave, PerturbedAtmosphere
from ...world.random_air import RandomWind
from ...world.random_profile import RandomAltitudeProfile
from ...world.wind import StillAir
from ..mars.air_with_waves import WAVES


LENGTH = 10.0 * km
"""Correlation length of the wind over the altitude, m; chosen"""

TRIGGER_RANGE = 2.0 * km
"""Range to go at which the parachute opens, m; chosen"""
SLOWEST = 350.0
"""Velocity at which it opens in any case, m/s; chosen"""


def wind_and_waves(scenario: Scenario) -> Scenario:
    """Random winds and waves of the density, which no onboard model knows.

    Their sizes are zero until dispersed."""
    waves = tuple(DensityWave(0.0, wavelength) for wavelength, _ in WAVES)
    gusts = RandomAltitudeProfile(LENGTH, 0.0, 80.0 * km, nodes=21)
    planet = dataclasses.replace(
        scenario.planet,
        atmosphere=PerturbedAtmosphere(scenario.planet.atmosphere, waves),
        wind=RandomWind(StillAir(), gusts, gusts, 0.0),
    )
    return dataclasses.replace(scenario, planet=planet)


def range_trigger(scenario: Scenario) -> Scenario:
    """The parachute opens at a range to go, as that of Mars 2020, and not at a velocity.

    A flight that passes the target farther away than the trigger opens it at the lowest
    velocity.
    """
    target, conditions = scenario.place, scenario.termination.conditions
    origin = scenario.initial_state if target.origin is None else target.origin
    longitude, latitude = from_ground_track(
        scenario.planet, origin, target.downrange, target.crossrange
    )
    by = conditions["velocity"].by
    conditions = conditions | {
        "range": RangeToGoBelow(
            range=TRIGGER_RANGE, longitude=longitude, latitude=latitude, by=by
        ),
        "velocity": VelocityBelow(velocity=SLOWEST, by=by),
    }
    return dataclasses.replace(
        scenario,
        termination=Termination(conditions, scenario.termination.time_limit),
    )
