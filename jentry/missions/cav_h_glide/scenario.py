"""A glider like CAV-H over the rotating Earth: vehicle, entry, target and law.

Numbers are those of the example `Earth_CAVH` of the NPCG Toolbox of Iowa State University
(Y. Lee, D. Y. Lee, B. Wie, 2024). It cites Phillips (2003) for the vehicle, and P. Lu,
S. Forbes, M. Baldwin, "Gliding Guidance of High L/D Hypersonic Vehicles", AIAA 2013-4648,
for the entry and the target. It calls the air "Hicks 2009". We have not checked these
sources. Numbers that are not from the toolbox are marked.
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
"""Altitude, m, and velocity, m/s, at the end: the flight ends at their energy"""
FIRST_BANK, FINAL_BANK = 70.0 * degree, 60.0 * degree
"""Present bank before the first correction, and bank at the end, of the linear bank"""
LARGEST_BANK = 90.0 * degree

_HEATING = 9.4369e-5
"""Coefficient of the heat rate: times sqrt(density) times velocity^3.15, in SI units. It
agrees to 2e-4 with the formula of Detra, Kemp and Riddell for a nose radius of one foot,
which the toolbox does not name"""


def earth() -> Planet:
    """A rotating sphere with an exponential atmosphere."""
    return toolbox.earth(_HEATING * math.sqrt(foot), heating_exponent=3.15)


def glider() -> Vehicle:
    """The glider: 907 kg and 0.4839 m2, lift-to-drag ratio of 3.28 at every speed."""
    return Vehicle(
        mass=907.0,
        reference_area=0.4839,
        aerodynamics=ConstantAerodynamics(0.42324, 0.1292),
        nose_radius=foot,
    )


def entry_state() -> EntryState:
    """State at the entry interface, relative to the rotating planet."""
    return EntryState(
        altitude=122.0 * km,
        longitude=-72.2744 * degree,
        latitude=39.1814 * degree,
        velocity=7400.0,
        flight_path_angle=-1.0 * degree,
        heading=38.5668 * degree,
    )


def target_state() -> EntryState:
    """State of the target; only its place, altitude and velocity are used."""
    return dataclasses.replace(
        entry_state(),
        altitude=END_ALTITUDE,
        velocity=END_VELOCITY,
        longitude=TARGET_LONGITUDE,
        latitude=TARGET_LATITUDE,
    )


def linear_bank(kind: type[LinearBankShape] = LinearBankShape) -> LinearBankShape:
    """Bank that is linear over the energy, from the present bank to that at the end."""
    return toolbox.linear_bank(
        earth(),
        target_state(),
        first=FIRST_BANK,
        final=FINAL_BANK,
        largest=LARGEST_BANK,
        kind=kind,
    )


def lateral() -> PredictedCrossrange:
    """Our own lateral logic: up to ten bank reversals, with a factor of 3.

    The example of the toolbox reverses the bank at a heading error of 15 degrees, or of 5
    degrees within 300 km of the target. Another version of it reverses as here, with a
    factor of 5 and any number of reversals.
    """
    return PredictedCrossrange(factor=3.0, most=10.0)


def guided() -> Scenario:
    """A damped bank that is linear over the energy, to the energy of the target.

    The toolbox ends at that energy as well, or before it within 100 m of the target. It
    flies the first 300 s with zero bank. Here the bank is the initial one until there is
    enough drag to steer.

    The range is predicted in the vertical plane. The prediction includes the component of
    the rotation of the Earth about the axis of the great circle of the flight. A prediction
    in three dimensions would hold the bank on one side to the end, and the vehicle would
    turn in circles.
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
    """A linear bank that is also corrected at its end, for the altitude there.

    The bank at the end becomes zero, and the altitude is 0.7 km below that of the target:
    the vehicle cannot glide higher at that velocity. With less bank at the end it needs
    more bank before for an equal range: it flies deeper, and the heat rate is 1.5 times as
    large.
    """
    return _with(guided(), shape=linear_bank(TwoEndedBankShape))


def undamped() -> Scenario:
    """A linear bank without damping: the glide oscillates about its equilibrium."""
    return _with(guided(), damping=None)


def undamped_unlimited() -> Scenario:
    """A linear bank without damping and without limits, some of which it exceeds."""
    return _with(guided(), damping=None, limits=None)


def at_rest(scenario: Scenario) -> Scenario:
    """The Earth of the onboard model is at rest, as in the predictions of the toolbox."""
    return eqx.tree_at(
        lambda s: s.guidance.model.planet.rotation_rate, scenario, jnp.asarray(0.0)
    )


def _with(scenario: Scenario, **changes: Any) -> Scenario:
    law = dataclasses.replace(scenario.guidance, **changes)
    return dataclasses.replace(scenario, guidance=law)
