"""Apollo 10: the capsule, its return from the Moon, and its guidance law.

Numbers are those of the example `Earth_Apollo10` of the NPCG Toolbox of Iowa State
University (Y. Lee, D. Y. Lee, B. Wie, 2024). It cites the analysis of the actual entry
(Szelc 1969, Apollo 10 Mission Report, Supplement 10, NASA TM-X-69555) and, for the limits,
Pavlosky and St. Leger (1974). It calls the air "Hicks 2009". We have not checked these
sources. Numbers that are not from the toolbox are marked.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

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
"""Distance from the centre of the Earth at the entry"""
INERTIAL_VELOCITY = 11_067.15
"""Inertial velocity at the entry, m/s"""
INERTIAL_PATH_ANGLE, INERTIAL_HEADING = -6.6198381 * degree, 71.9317 * degree
LONGITUDE, LATITUDE = 174.24384 * degree, -23.51457 * degree
"""Longitude and geocentric latitude at the entry"""
TARGET_LONGITUDE, TARGET_LATITUDE = 194.8501 * degree, -15.4121 * degree
END_ALTITUDE, END_VELOCITY = 5683.0, 119.67
"""Altitude, m, and velocity, m/s, at the end"""
SKIP_RANGE = 5000.0 * km
FIRST_BANK, FINAL_BANK = 70.0 * degree, 30.0 * degree
"""Present bank before the first correction, and bank at the end, of the linear bank"""
LARGEST_BANK = 85.0 * degree
"""Largest bank, our own; it is 180 degrees in the toolbox. With a larger bank a capsule at
the low velocity of its end falls vertically, where the state has no heading"""
LEAST_EFFECT = 1500.0
"""Effect of the bank on the range, m, below which the bank is held; our own"""

_HEATING = 20e-9 * 11_356.539
"""Coefficient of the heat rate, from a formula of Young and Smith (1967) in the toolbox:
20 sqrt(density) times the cube of the velocity, in Btu/(ft2 s), with the density in kg/m3
and the velocity in km/s. The second factor is that Btu/(ft2 s) with the digits of the
toolbox. The number 20 looks like one for slug/ft3 and thousands of ft/s, for which Detra,
Kemp and Riddell have 20.5 at a nose radius of one foot; heat rates would then be 1.56 times
as large"""


def earth() -> Planet:
    """A rotating sphere with an exponential atmosphere."""
    return toolbox.earth(_HEATING)


def capsule() -> Vehicle:
    """The capsule: 5498.22 kg and 12.017 m2, lift-to-drag ratio of 0.325 at every speed.

    The formula of the heat rate has no nose radius. It is set to 1 m, by which jentry
    divides.
    """
    return Vehicle(
        mass=5498.22,
        reference_area=12.017,
        aerodynamics=ConstantAerodynamics(0.40815, 1.2569),
    )


def entry_state(planet: Planet) -> EntryState:
    """State at the entry interface, relative to the rotating planet."""
    return toolbox.relative_entry(
        planet,
        radius=RADIUS_AT_ENTRY,
        longitude=LONGITUDE,
        latitude=LATITUDE,
        velocity=INERTIAL_VELOCITY,
        flight_path_angle=INERTIAL_PATH_ANGLE,
        heading=INERTIAL_HEADING,
    )


def lateral() -> PredictedCrossrange:
    """Our own lateral logic: up to ten bank reversals.

    With at most six, and a factor of 2, all reversals happen before the end, and the
    crossrange error is larger than the range error is now. The last of ten reversals leave
    a range error, since the bank can no longer correct it.
    """
    return PredictedCrossrange(factor=2.0, most=10.0)


def guided() -> Scenario:
    """A bank that is linear over the energy, within the limits, down to the end altitude.

    The toolbox ends at the energy of this altitude and velocity, or within 100 m of the
    target. By then the capsule falls at its terminal velocity, so that the altitude
    determines the end. The toolbox holds the lift upwards for 90 s, which limits the load
    factor. Here `PathLimits` does so.
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
    """A skip out of the air to a target 5000 km straight ahead, which is our own choice.

    A much farther target would need a higher ceiling.
    """
    return eqx.tree_at(
        lambda s: (s.target.downrange, s.target.crossrange),
        scenario,
        (jnp.asarray(SKIP_RANGE), jnp.asarray(0.0)),
    )


def unlimited() -> Scenario:
    """A linear bank without limits: it exceeds those of load and dynamic pressure."""
    scenario = guided()
    law = dataclasses.replace(scenario.guidance, limits=None)
    return dataclasses.replace(scenario, guidance=law)
