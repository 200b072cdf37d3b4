"""Apollo 10: the capsule, its return from the Moon, and the law that flies it.

Numbers are those of the example `Earth_Apollo10` of the NPCG Toolbox of Iowa State
University (Y. Lee, D. Y. Lee, B. Wie, 2024). It names as its sources the analysis of the
flown entry (Szelc 1969, Apollo 10 Mission Report, Supplement 10, NASA TM-X-69555) and, for
the limits, Pavlosky and St. Leger (1974); the air is "Hicks 2009" there. These have not
been read here. What is not of the toolbox says so.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from ..._math import sincos
from ...flight.scenario import Scenario, Target
from ...flight.termination import (
    AltitudeAbove,
    AltitudeBelow,
    Termination,
)
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import PredictedCrossrange
from ...guidance.path_limits import PathLimits
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.constraints import DynamicPressure, HeatRate, LoadFactor
from ...motion.quantities import ground_track
from ...motion.state import EntryState
from ...onboard.model import OnboardModel
from ...units import degree, km
from ...world.aerodynamics import ConstantAerodynamics
from ...world.planet import Planet
from ...world.vehicle import Vehicle
from .. import npcg_toolbox as toolbox


RADIUS_AT_ENTRY = 6498.270 * km
"""From the centre of the Earth"""
INERTIAL_VELOCITY = 11_067.15
"""m/s"""
INERTIAL_PATH_ANGLE, INERTIAL_HEADING = -6.6198381 * degree, 71.9317 * degree
LONGITUDE, LATITUDE = 174.24384 * degree, -23.51457 * degree
"""At the entry, the latitude geocentric"""
TARGET_LONGITUDE, TARGET_LATITUDE = 194.8501 * degree, -15.4121 * degree
END_ALTITUDE, END_VELOCITY = 5683.0, 119.67
"""m, m/s"""
SKIP_RANGE = 5000.0 * km
FIRST_BANK, FINAL_BANK = 70.0 * degree, 30.0 * degree
"""Of the linear bank: where it begins, before the first correction, and at its end"""
LARGEST_BANK = 85.0 * degree
"""Our own; 180 degrees in the toolbox. With more than this a capsule that is as slow as at
its end falls vertically, where the state has no heading"""
LEAST_EFFECT = 1500.0
"""m, our own: where the bank has no more of the range left than that, it stays"""

_HEATING = 20e-9 * 11_356.539
"""Of a formula of Young and Smith's (1967) as the toolbox has it: 20 sqrt(density) times
the cube of the velocity, in Btu/(ft2 s), the toolbox's digits of which are these, with the
density in kg/m3 and the velocity in km/s. The number looks like one for slug/ft3 and
thousands of ft/s, in which Detra, Kemp and Riddell have 20.5 for a nose of one foot; heat
rates would be 1.56 times as large then"""


def earth() -> Planet:
    """A rotating sphere with an exponential atmosphere."""
    return toolbox.earth(_HEATING)


def capsule() -> Vehicle:
    """5498.22 kg and 12.017 m2, with a lift-to-drag ratio of 0.325 at every speed.

    The formula of the heat rate has no nose radius: where jentry divides by one it is 1 m.
    """
    return Vehicle(
        mass=5498.22,
        reference_area=12.017,
        aerodynamics=ConstantAerodynamics(0.40815, 1.2569),
    )


def entry_state(planet: Planet) -> EntryState:
    """At the entry interface, relative to the rotating planet."""
    sin_path, cos_path = sincos(jnp.asarray(INERTIAL_PATH_ANGLE))
    sin_heading, cos_heading = sincos(jnp.asarray(INERTIAL_HEADING))
    carried = planet.rotation_rate * RADIUS_AT_ENTRY * jnp.cos(LATITUDE)
    up = INERTIAL_VELOCITY * sin_path
    north = INERTIAL_VELOCITY * cos_path * cos_heading
    east = INERTIAL_VELOCITY * cos_path * sin_heading - carried
    level = jnp.hypot(north, east)
    return EntryState(
        altitude=RADIUS_AT_ENTRY - planet.radius,
        longitude=LONGITUDE,
        latitude=LATITUDE,
        velocity=jnp.hypot(up, level),
        flight_path_angle=jnp.arctan2(up, level),
        heading=jnp.arctan2(east, north),
    )


def lateral() -> PredictedCrossrange:
    """Our own: up to ten reversals.

    With six at most, and a factor of 2, they are used up before the end, and the crossrange
    is missed by more than the range is now: the reversals that come last leave an error
    along the track, since the bank can do no more about it.
    """
    return PredictedCrossrange(factor=2.0, most=10.0)


def guided() -> Scenario:
    """A bank that is linear over the energy, within the limits, down to the altitude.

    The toolbox ends at an energy, that of this altitude and velocity, or within 100 m of
    the target; a capsule falls at its terminal velocity by then, so that it is the altitude
    which ends it. There the lift is held upwards for 90 s, which keeps the load; here the
    limits do so (`PathLimits`).
    """
    planet = earth()
    start = entry_state(planet)
    there = dataclasses.replace(
        start,
        altitude=END_ALTITUDE,
        velocity=END_VELOCITY,
        longitude=TARGET_LONGITUDE,
        latitude=TARGET_LATITUDE,
    )
    downrange, crossrange = ground_track(planet, start, there)
    law = PredictorCorrector(
        model=OnboardModel(planet, capsule()),
        shape=toolbox.linear_bank(
            planet, there, first=FIRST_BANK, final=FINAL_BANK, largest=LARGEST_BANK
        ),
        end=GuidedEnd(altitude=END_ALTITUDE, ceiling=toolbox.CEILING),
        lateral=lateral(),
        limits=PathLimits(),
        least_effect=LEAST_EFFECT,
        steps=400,
    )
    return Scenario(
        planet=planet,
        vehicle=capsule(),
        initial_state=start,
        guidance=law,
        termination=Termination(
            {
                "altitude": AltitudeBelow(altitude=END_ALTITUDE),
                "skip_out": AltitudeAbove(altitude=toolbox.CEILING),
            },
            time_limit=1200.0,
        ),
        target=Target(END_ALTITUDE, END_VELOCITY, downrange, crossrange, origin=start),
        constraints={
            "heat_rate": HeatRate(6e6),
            "load_factor": LoadFactor(10.0),
            "dynamic_pressure": DynamicPressure(30e3),
        },
        step=toolbox.STEP,
    )


def skip(scenario: Scenario) -> Scenario:
    """Out of the air and in again, to a point 5000 km straight ahead, a choice of our own.

    Far beyond it the ceiling would have to be higher.
    """
    return eqx.tree_at(
        lambda s: (s.target.downrange, s.target.crossrange),
        scenario,
        (jnp.asarray(SKIP_RANGE), jnp.asarray(0.0)),
    )


def unlimited() -> Scenario:
    """A linear bank with no regard to the limits: it exceeds those of load and pressure."""
    scenario = guided()
    law = dataclasses.replace(scenario.guidance, limits=None)
    return dataclasses.replace(scenario, guidance=law)
