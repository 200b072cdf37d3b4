"""Mars Science Laboratory: planet, capsule, entry and target.

Vehicle, entry, target and limits are those of the example `ex_Mars_robotic` of the NPCG
Toolbox of Iowa State University (Y. Lee, D. Y. Lee, B. Wie, 2024). It cites Dutta and Braun
(2014) for the entry; we have not read that paper. Numbers that are not from the toolbox are
marked.

Altitudes are above a sphere of 3397 km, as in the toolbox. The ground at the landing site
is 5.9 km below it: its radius is 3391.1 km (description of the data of Holstein-Rathlou,
Withers and Maue, "Atmospheric studies from the Mars Science Laboratory Entry, Descent and
Landing atmospheric structure reconstruction", 2015).
"""

import dataclasses

import jax.numpy as jnp

from ...flight.scenario import Scenario, Target
from ...flight.termination import (
    AltitudeAbove,
    AltitudeBelow,
    Outcome,
    Termination,
    VelocityBelow,
)
from ...guidance.open_loop import BankProfile
from ...motion.constraints import DynamicPressure, HeatRate, LoadFactor, MachNumber
from ...motion.quantities import ground_track
from ...motion.state import EntryState
from ...onboard.profiles import PolynomialProfile
from ...units import degree, km
from ...world.aerodynamics import ConstantAerodynamics
from ...world.planet import Planet
from ...world.vehicle import Vehicle
from ..mars.drag_tracking import mars
from ..npcg_toolbox import relative_entry


RADIUS_AT_ENTRY = 3522.0 * km
"""Distance from the centre of Mars at the entry: 125 km above the sphere"""
INERTIAL_VELOCITY = 6083.3
"""Inertial velocity at the entry, m/s. Relative to the planet it is 5.844 km/s. The
spacecraft had 5.845 km/s (D. W. Way, J. L. Davis, J. D. Shidner, AAS 13-420, 2013,
introduction)"""
INERTIAL_PATH_ANGLE, INERTIAL_HEADING = -15.4892 * degree, 93.2065 * degree
LONGITUDE, LATITUDE = 126.72 * degree, -3.9186 * degree
TARGET_LONGITUDE, TARGET_LATITUDE = 137.431 * degree, -4.552 * degree
END_VELOCITY = 406.0
"""Velocity relative to the planet at which the parachute opens, m/s"""
EXPECTED_ALTITUDE = 6.9 * km
"""Altitude from which altitude errors are counted, m: where the undispersed flight under
the terminal-point law ends, to 0.1 km. No law controls it. The toolbox has 12 km, which is
nearly its height above the landing site"""
CEILING = 135.0 * km
"""Altitude above which a flight has skipped out; chosen"""


def planet() -> Planet:
    """Mars as in `mars-drag-tracking`, which has the same radius, with its rotation.

    The air is exponential. That of the toolbox is the world `fitted-air`.
    """
    return dataclasses.replace(mars(), rotation_rate=7.0882e-5)


def capsule() -> Vehicle:
    """The capsule: 3300 kg, 15.588 m2, a lift-to-drag ratio of 0.24 and 146 kg/m2.

    The nose radius is a quarter of the diameter of 4.5 m, as of the capsules of Viking. It
    is chosen, and affects only the heat rate.
    """
    return Vehicle(
        mass=3300.0,
        reference_area=15.588,
        aerodynamics=ConstantAerodynamics(0.348, 1.45),
        nose_radius=1.125,
    )


def entry_state(planet: Planet) -> EntryState:
    """State at the entry interface, relative to the rotating planet."""
    return relative_entry(
        planet,
        radius=RADIUS_AT_ENTRY,
        longitude=LONGITUDE,
        latitude=LATITUDE,
        velocity=INERTIAL_VELOCITY,
        flight_path_angle=INERTIAL_PATH_ANGLE,
        heading=INERTIAL_HEADING,
    )


def entry() -> Scenario:
    """The entry, with zero bank in place of a law, to the velocity of the parachute.

    A flight that falls to the altitude 0 before has crashed: the parachute needs the 5.9 km
    that remain to the ground; chosen.
    """
    around = planet()
    start = entry_state(around)
    there = dataclasses.replace(
        start, longitude=TARGET_LONGITUDE, latitude=TARGET_LATITUDE
    )
    downrange, crossrange = ground_track(around, start, there)
    return Scenario(
        planet=around,
        vehicle=capsule(),
        initial_state=start,
        guidance=BankProfile(PolynomialProfile(jnp.ones(1))),
        termination=Termination(
            {
                "velocity": VelocityBelow(velocity=END_VELOCITY),
                "too_low": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED),
                "skip_out": AltitudeAbove(altitude=CEILING),
            },
            time_limit=600.0,
        ),
        target=Target(
            EXPECTED_ALTITUDE, END_VELOCITY, downrange, crossrange, origin=start
        ),
        constraints={
            "heat_rate": HeatRate(1e6),
            "load_factor": LoadFactor(15.0),
            "dynamic_pressure": DynamicPressure(21e3),
            "mach": MachNumber(),
        },
        values_at_end=("mach", "dynamic_pressure"),
    )
