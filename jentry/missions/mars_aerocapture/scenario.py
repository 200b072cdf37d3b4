"""Mars aerocapture: the orbiter, its entry, its target orbit and its guidance law.

Source: G. Gelly, P. Vernis, "Neural Networks as a Guidance Solution for Soft-Landing and
Aerocapture", AIAA 2009-5664, section IV: an orbiter of a Mars Sample Return mission. We
have not seen the paper itself. Its numbers are as quoted in the public repository
GovitPowerz/Aerocapture on GitHub (articles/markdown), whose author is the first author.
Reference area and coefficients, which the paper does not print, and the planet are those of
the same repository (configs/missions/mars.toml, configs/planets/mars.toml). The air is the
average profile of Mars-GRAM that comes with AMAT (A. P. Girija and others, Journal of Open
Source Software 6(67), 2021; atmdata/Mars/mars-gram-avg.dat), every 5 km. Choices of our own
are marked.
"""

import dataclasses

import jax.numpy as jnp

from ..._math import sincos
from ...flight.scenario import Scenario
from ...guidance.aerocapture import AerocaptureGuidance
from ...guidance.inclination import InclinationCorridor
from ...guidance.lateral import FixedSide
from ...guidance.open_loop import BankProfile
from ...motion.constraints import DynamicPressure, LoadFactor
from ...motion.orbit import OrbitTarget
from ...motion.state import EntryState
from ...onboard.model import OnboardModel
from ...onboard.profiles import PolynomialProfile
from ...units import degree, km
from ...world.aerodynamics import ConstantAerodynamics
from ...world.gravity import InverseSquareGravity
from ...world.planet import Planet
from ...world.tabulated_atmosphere import TabulatedAtmosphere
from ...world.vehicle import Vehicle
from ..aerocapture import ends


ANGLE_OF_ATTACK = -27.5 * degree
AXIAL, NORMAL = 1.269, -0.205
"""Coefficients of the force along the axis of the aeroshell, and normal to it"""
EXIT_ALTITUDE = 125.0 * km
"""Altitude at which the vehicle has left the air, where the table of the air ends; that of
the repository is 131 km"""
APOAPSIS = 500.0 * km
"""Altitude of the parking orbit"""
STEP = 1.0
"""Length of a step, s: a guidance cycle, as in the paper"""
CORRIDOR = 0.02 * degree, 4e-9 * degree
"""Floor, and widening with the square of the velocity, of the corridor of the inclination;
our own"""

_AIR = (
    *(1.319e-2, 8.976e-3, 5.762e-3, 3.596e-3, 2.190e-3, 1.302e-3, 7.659e-4),
    *(4.203e-4, 2.357e-4, 1.263e-4, 6.420e-5, 3.175e-5, 1.754e-5, 1.175e-5),
    *(7.254e-6, 4.006e-6, 2.022e-6, 9.557e-7, 4.192e-7, 1.795e-7, 7.749e-8),
    *(3.384e-8, 1.488e-8, 6.725e-9, 3.205e-9, 1.632e-9),
)
"""Density every 5 km from the ground to 125 km, kg/m3"""


def mars() -> Planet:
    """A rotating sphere with a tabulated atmosphere.

    The radius is that of the equator. Temperature and gas are those of carbon dioxide; they
    affect only the Mach number.
    """
    return Planet(
        radius=3393.94 * km,
        gravity=InverseSquareGravity(4.282829e13),
        atmosphere=TabulatedAtmosphere(
            altitudes=5.0 * km * jnp.arange(len(_AIR)),
            densities=jnp.array(_AIR),
            isothermal_temperature=150.0,
            gas_constant=188.92,
            heat_capacity_ratio=1.29,
        ),
        rotation_rate=7.088218e-5,
        heating_coefficient=1.9027e-4,
    )


def orbiter() -> Vehicle:
    """The orbiter in its aeroshell: 1089 kg, 14.7 m2 and a lift-to-drag ratio of 0.33."""
    sine, cosine = (float(x) for x in sincos(jnp.asarray(ANGLE_OF_ATTACK)))
    lift = NORMAL * cosine - AXIAL * sine
    drag = NORMAL * sine + AXIAL * cosine
    return Vehicle(1089.0, 14.7, aerodynamics=ConstantAerodynamics(lift, drag))


def target_orbit() -> OrbitTarget:
    """The circular parking orbit, 500 km high."""
    return OrbitTarget(APOAPSIS, APOAPSIS, 50.0 * degree)


def entry() -> Scenario:
    """The entry at 120 km, with zero bank in place of the law.

    Velocity and angles are relative to the rotating planet. The paper prints no place; on
    the equator its heading has the inclination of its target.
    """
    return Scenario(
        planet=mars(),
        vehicle=orbiter(),
        initial_state=EntryState(
            altitude=120.0 * km,
            longitude=0.0,
            latitude=0.0,
            velocity=5687.0,
            flight_path_angle=-10.24 * degree,
            heading=38.04 * degree,
        ),
        guidance=BankProfile(PolynomialProfile(jnp.ones(1))),
        termination=ends(EXIT_ALTITUDE, time_limit=1500.0),
        target=target_orbit(),
        constraints={
            "load_factor": LoadFactor(),
            "dynamic_pressure": DynamicPressure(),
        },
        step=STEP,
    )


def free_plane(scenario: Scenario) -> Scenario:
    """Target orbit without an inclination, and a bank to one side: our own choice."""
    target = dataclasses.replace(target_orbit(), inclination=None)
    law = scenario.guidance
    if isinstance(law, AerocaptureGuidance):
        law = dataclasses.replace(law, lateral=FixedSide())
    return dataclasses.replace(scenario, target=target, guidance=law)


def guided() -> Scenario:
    """Lift up, then a larger constant bank, with reversals for the inclination."""
    start = entry()
    law = AerocaptureGuidance(
        model=OnboardModel(start.planet, start.vehicle),
        lateral=InclinationCorridor(floor=CORRIDOR[0], widening=CORRIDOR[1]),
        exit_altitude=EXIT_ALTITUDE,
    )
    return dataclasses.replace(start, guidance=law)
