"""Neptune aerocapture: the orbiter, its entry, its target orbit and its guidance law.

Source: AMAT, A. P. Girija and others, "AMAT: A Python package for rapid conceptual design
of aerocapture and atmospheric Entry, Descent, and Landing (EDL) missions in a Jupyter
environment", Journal of Open Source Software 6(67), 2021; repository athulpg007/AMAT on
GitHub. By file of the repository:

- `examples/example-11-neptune-aerocapture-part-2a.ipynb`: vehicle (mass, ballistic
  coefficient, lift-to-drag ratio, area), entry and target orbit of the prograde case. It
  names A. P. Girija, S. J. Saikia, J. M. Longuski and others, "Feasibility and Performance
  Analysis of Neptune Aerocapture Using Heritage Blunt-Body Aeroshells", Journal of
  Spacecraft and Rockets 57(6), 2020, section VIII A. We have not seen that paper.
- `AMAT/planet.py`: radius, rotation, gravitational parameter, ratio of heat capacities, and
  the altitude of 1000 km above which there is no air.
- `atmdata/Neptune/neptune-gram-avg.dat`: average density of NeptuneGRAM; here every 10 km.

Frame: `AMAT/vehicle.py` integrates the equations of motion of Vinh, chapter 3, over a
rotating planet. Velocity, flight-path angle and heading are relative to the planet, and a
heading of 0 is towards east, since the rate of the longitude has its cosine. The planet
rotates towards east, so that this entry is prograde.

Gravity is that of a sphere; AMAT has J2. Choices of our own are marked.
"""

import dataclasses

import jax.numpy as jnp

from ...flight.scenario import Scenario
from ...guidance.aerocapture import AerocaptureGuidance
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


MASS, BALLISTIC_COEFFICIENT, AREA = 1000.0, 200.0, 3.1416
"""kg, kg/m2, m2"""
LIFT_TO_DRAG = 0.40
ENTRY_ALTITUDE = 1000.0 * km
"""Altitude above which AMAT has no air"""
EXIT_ALTITUDE = 1001.0 * km
"""Altitude at which the vehicle has left the air: 1 km above that of the entry, since a
flight that begins at an altitude has already risen to it"""
APOAPSIS, PERIAPSIS = 400e3 * km, 4000.0 * km
"""Altitudes of the target orbit"""
EXIT_BANK = 75.0 * degree
"""Bank after the switch in predictions of the first phase; our own. With a larger one this
vehicle of little lift comes down unless it switches within some seconds"""
STEP = 1.0
"""Length of a step, s: a guidance cycle; our own"""

_AIR = (
    *(4.4021e-1, 3.0089e-1, 1.8649e-1, 1.0360e-1, 5.4321e-2, 2.7114e-2, 1.3586e-2),
    *(6.8958e-3, 3.4432e-3, 1.7363e-3, 1.0648e-3, 7.0913e-4, 5.0870e-4, 3.7803e-4),
    *(2.8112e-4, 2.0680e-4, 1.5179e-4, 1.1174e-4, 8.6537e-5, 6.7139e-5, 5.2142e-5),
    *(4.0497e-5, 3.2263e-5, 2.5720e-5, 2.0519e-5, 1.6492e-5, 1.3306e-5, 1.0743e-5),
    *(8.6794e-6, 7.0406e-6, 5.7158e-6, 4.6443e-6, 3.7617e-6, 3.0591e-6, 2.4900e-6),
    *(2.0289e-6, 1.6501e-6, 1.3476e-6, 1.1019e-6, 8.9856e-7, 7.3593e-7, 6.0350e-7),
    *(4.9555e-7, 4.0745e-7, 3.3251e-7, 2.7337e-7, 2.2506e-7, 1.8552e-7, 1.4999e-7),
    *(1.2181e-7, 9.9101e-8, 8.0517e-8, 6.6787e-8, 5.5479e-8, 4.6147e-8, 3.8431e-8),
    *(3.2038e-8, 2.6808e-8, 2.2804e-8, 1.9411e-8, 1.6534e-8, 1.4091e-8, 1.2081e-8),
    *(1.0428e-8, 9.0048e-9, 7.7788e-9, 6.7220e-9, 5.8270e-9, 5.0917e-9, 4.4509e-9),
    *(3.8921e-9, 3.4046e-9, 2.9792e-9, 2.6078e-9, 2.2835e-9, 2.0125e-9, 1.7834e-9),
    *(1.5808e-9, 1.4016e-9, 1.2432e-9, 1.1029e-9, 9.7891e-10, 8.7828e-10, 7.8816e-10),
    *(7.0744e-10, 6.3512e-10, 5.7030e-10, 5.1220e-10, 4.6012e-10, 4.1592e-10),
    *(3.7644e-10, 3.4079e-10, 3.0859e-10, 2.7950e-10, 2.5320e-10, 2.2944e-10),
    *(2.0794e-10, 1.8851e-10, 1.7092e-10, 1.5551e-10, 1.4273e-10, 1.2976e-10),
)
"""Density every 10 km from the level of 1 bar to 1010 km, kg/m3"""


def neptune() -> Planet:
    """A rotating sphere with a tabulated atmosphere.

    Temperature and gas are those of the table at 200 km; they affect only the Mach number.
    """
    return Planet(
        radius=24622.0 * km,
        gravity=InverseSquareGravity(6.8365299e15),
        atmosphere=TabulatedAtmosphere(
            altitudes=10.0 * km * jnp.arange(len(_AIR)),
            densities=jnp.array(_AIR),
            isothermal_temperature=149.80,
            gas_constant=25.072 / (5.2142e-5 * 149.80),
            heat_capacity_ratio=1.450,
        ),
        rotation_rate=1.083385e-4,
    )


def orbiter() -> Vehicle:
    """The orbiter in its blunt aeroshell, with a lift-to-drag ratio of 0.4."""
    drag = MASS / (BALLISTIC_COEFFICIENT * AREA)
    return Vehicle(
        MASS, AREA, aerodynamics=ConstantAerodynamics(LIFT_TO_DRAG * drag, drag)
    )


def target_orbit() -> OrbitTarget:
    """The elliptic orbit after the burn, without an inclination."""
    return OrbitTarget(APOAPSIS, PERIAPSIS)


def entry() -> Scenario:
    """The entry at 1000 km towards east, with zero bank in place of the law.

    Velocity and angles are relative to the rotating planet.
    """
    return Scenario(
        planet=neptune(),
        vehicle=orbiter(),
        initial_state=EntryState(
            altitude=ENTRY_ALTITUDE,
            longitude=0.0,
            latitude=0.0,
            velocity=28.0 * km,
            flight_path_angle=-13.85 * degree,
            heading=90.0 * degree,
        ),
        guidance=BankProfile(PolynomialProfile(jnp.ones(1))),
        termination=ends(EXIT_ALTITUDE, time_limit=2400.0),
        target=target_orbit(),
        constraints={
            "load_factor": LoadFactor(),
            "dynamic_pressure": DynamicPressure(),
        },
        step=STEP,
    )


def guided() -> Scenario:
    """Lift up, then a larger constant bank to one side."""
    start = entry()
    law = AerocaptureGuidance(
        model=OnboardModel(start.planet, start.vehicle),
        exit_altitude=EXIT_ALTITUDE,
        exit_bank=EXIT_BANK,
    )
    return dataclasses.replace(start, guidance=law)
