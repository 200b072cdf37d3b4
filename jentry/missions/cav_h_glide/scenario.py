"""A glider like CAV-H over the rotating Earth: vehicle, entry, target and law.

Numbers are those of the example `Earth_CAVH` of the NPCG Toolbox of Iowa State University
(Y. Lee, D. Y. Lee, B. Wie, 2024). It names as its sources Phillips (2003) for the vehicle
and P. Lu, S. Forbes, M. Baldwin, "Gliding Guidance of High L/D Hypersonic Vehicles", AIAA
2013-4648, for the entry and the target; the air is "Hicks 2009" there. These have not been
read here. What is not of the toolbox says so.
"""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ...flight.scenario import Scenario, Target
from ...flight.termination import (
    AltitudeAbove,
    AltitudeBelow,
    EnergyBelow,
    Outcome,
    Termination,
)
from ...guidance.bank_shapes import LinearBankShape, TwoEndedBankShape
from ...guidance.glide_damping import GlideDamping
from ...guidance.guided_end import GuidedEnd
from ...guidance.lateral import PredictedCrossrange
from ...guidance.path_limits import PathLimits
from ...guidance.predictor_corrector import PredictorCorrector
from ...motion.constraints import DynamicPressure, HeatRate, LoadFactor
from ...motion.quantities import energy, ground_track
from ...motion.state import EntryState
from ...onboard.model import OnboardModel
from ...units import degree, foot, km
from ...world.aerodynamics import ConstantAerodynamics
from ...world.planet import Planet
from ...world.vehicle import Vehicle
from .. import npcg_toolbox as toolbox


TARGET_LONGITUDE, TARGET_LATITUDE = 64.1166 * degree, 31.4927 * degree
END_ALTITUDE, END_VELOCITY = 30.0 * km, 2000.0
"""m, m/s: the flight ends at the energy of the two"""
FIRST_BANK, FINAL_BANK = 70.0 * degree, 60.0 * degree
"""Of the linear bank: where it begins, before the first correction, and at its end"""
LARGEST_BANK = 90.0 * degree

_HEATING = 9.4369e-5
"""Times sqrt(density) times velocity^3.15, in SI: to 2e-4 the formula of Detra, Kemp and
Riddell for a nose with a radius of one foot, which is not named there"""


def earth() -> Planet:
    """A rotating sphere with an exponential atmosphere."""
    return toolbox.earth(_HEATING * math.sqrt(foot), heating_exponent=3.15)


def glider() -> Vehicle:
    """907 kg and 0.4839 m2, with a lift-to-drag ratio of 3.28 at every speed."""
    return Vehicle(
        mass=907.0,
        reference_area=0.4839,
        aerodynamics=ConstantAerodynamics(0.42324, 0.1292),
        nose_radius=foot,
    )


def entry_state() -> EntryState:
    """At the entry interface, relative to the rotating planet."""
    return EntryState(
        altitude=122.0 * km,
        longitude=-72.2744 * degree,
        latitude=39.1814 * degree,
        velocity=7400.0,
        flight_path_angle=-1.0 * degree,
        heading=38.5668 * degree,
    )


def target_state() -> EntryState:
    """Place, altitude and velocity of the target, of which only these count."""
    return dataclasses.replace(
        entry_state(),
        altitude=END_ALTITUDE,
        velocity=END_VELOCITY,
        longitude=TARGET_LONGITUDE,
        latitude=TARGET_LATITUDE,
    )


def linear_bank(kind: type[LinearBankShape] = LinearBankShape) -> LinearBankShape:
    """Over the energy, from the bank now to that at the end."""
    return toolbox.linear_bank(
        earth(),
        target_state(),
        first=FIRST_BANK,
        final=FINAL_BANK,
        largest=LARGEST_BANK,
        kind=kind,
    )


def lateral() -> PredictedCrossrange:
    """Our own: up to ten reversals, a factor of 3.

    The example of the toolbox reverses at a heading error of 15 degrees, of 5 within
    300 km, and another version of it as here, with a factor of 5 and any number.
    """
    return PredictedCrossrange(factor=3.0, most=10.0)


def guided() -> Scenario:
    """A bank that is linear over the energy, to the energy of the target, damped.

    The toolbox ends there as well, or within 100 m of the target before. It flies the
    first 300 s with wings level; here the bank is the first one until there is drag
    enough to steer by.

    The range is predicted in the vertical plane, about an Earth of which the rotation
    counts as far as it is about the axis of the great circle that is flown. With the bank
    on its side to the end, as in three dimensions, the vehicle would turn in circles.
    """
    planet = earth()
    start = entry_state()
    there = target_state()
    last = energy(planet, there)
    downrange, crossrange = ground_track(planet, start, there)
    law = PredictorCorrector(
        model=OnboardModel(planet, glider()),
        shape=linear_bank(),
        end=GuidedEnd(energy=last, ceiling=toolbox.CEILING),
        lateral=lateral(),
        damping=GlideDamping(lowest=math.cos(LARGEST_BANK)),
        limits=PathLimits(),
        in_space=False,
        step=10.0,
        steps=300,
    )
    return Scenario(
        planet=planet,
        vehicle=glider(),
        initial_state=start,
        guidance=law,
        termination=Termination(
            {
                "energy": EnergyBelow(energy=last),
                "skip_out": AltitudeAbove(altitude=toolbox.CEILING),
                "ground": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED),
            },
            time_limit=4000.0,
        ),
        target=Target(END_ALTITUDE, END_VELOCITY, downrange, crossrange, origin=start),
        constraints={
            "heat_rate": HeatRate(8e6),
            "load_factor": LoadFactor(2.5),
            "dynamic_pressure": DynamicPressure(100e3),
        },
        step=toolbox.STEP,
    )


def two_ended() -> Scenario:
    """The bank at the end is free as well, and is corrected for the altitude there.

    It comes to wings level and to 0.7 km below the target's: at its velocity the vehicle
    glides no higher. With less bank at the end it needs more before, for the same range:
    it flies deeper, and the heat rate is larger by half.
    """
    return _with(guided(), shape=linear_bank(TwoEndedBankShape))


def undamped() -> Scenario:
    """A linear bank without damping: the glide swings about its equilibrium."""
    return _with(guided(), damping=None)


def undamped_unlimited() -> Scenario:
    """Neither damped nor within the limits, some of which it exceeds."""
    return _with(guided(), damping=None, limits=None)


def at_rest(scenario: Scenario) -> Scenario:
    """The law believes in an Earth at rest, as the predictions of the toolbox do."""
    return eqx.tree_at(
        lambda s: s.guidance.model.planet.rotation_rate, scenario, jnp.asarray(0.0)
    )


def _with(scenario: Scenario, **changes: Any) -> Scenario:
    law = dataclasses.replace(scenario.guidance, **changes)
    return dataclasses.replace(scenario, guidance=law)
