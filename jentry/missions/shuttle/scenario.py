"""Space Shuttle re-entry as a problem of optimal control: vehicle, planet and start.

Source: J. T. Betts, "Practical Methods for Optimal Control and Estimation Using Nonlinear
Programming", 2nd edition, SIAM 2010, section 6.1. English units, as printed.
"""

import dataclasses

import jax.numpy as jnp

from ..._math import horner
from ...fields import Scalar, Vector, optional_scalar
from ...flight.scenario import Scenario, Target
from ...flight.termination import AltitudeBelow, EnergyBelow, Outcome, Termination
from ...guidance.open_loop import ControlProfiles
from ...motion.constraints import AbstractConstraint, LoadFactor, PathPoint
from ...motion.index import EnergyIndex
from ...motion.quantities import energy
from ...motion.state import EntryState
from ...onboard.profiles import PolynomialProfile
from ...units import degree, foot, slug
from ...world.aerodynamics import PolynomialAerodynamics
from ...world.atmosphere import ExponentialAtmosphere
from ...world.gravity import InverseSquareGravity
from ...world.planet import Planet
from ...world.vehicle import Vehicle


_LIFT = -0.20704, 0.029244
_DRAG = 0.07854, -0.61592e-2, 0.621408e-3
"""Polynomial in the angle of attack in degrees"""
_HEATING = 1.0672181, -0.19213774e-1, 0.21286289e-3, -0.10117249e-5
"""Polynomial in the angle of attack in degrees"""
_BTU_PER_FT2_S = 1055.05585262 / foot**2
"""Btu/(ft2 s) in W/m2, with the international British thermal unit"""

END_ALTITUDE, END_VELOCITY, END_PATH_ANGLE = 80e3 * foot, 2500.0 * foot, -5.0 * degree
HEATING_LIMIT = 70.0 * _BTU_PER_FT2_S
START_BANK, START_ANGLE_OF_ATTACK = -45.0 * degree, 20.0 * degree
"""Controls of a flight with constant controls; these are our own"""
STEP = 2.0
"""Length of a step, s"""


def _per_radian(polynomial: tuple[float, ...]) -> Vector:
    return jnp.array([c / degree**power for power, c in enumerate(polynomial)])


class WingHeatRate(AbstractConstraint):
    """Heat rate at the leading edge of the wing, which depends on the angle of attack.

    It is 17 700 sqrt(density) (velocity / 10^4)^3.07 in Btu/(ft2 s), with slug/ft3 and
    ft/s, times a polynomial in the angle of attack.
    """

    limit: Scalar | None = optional_scalar(unit="W/m2")
    unit = "W/m2"

    def value(self, point: PathPoint) -> Scalar:
        density = point.air.density / (slug / foot**3)
        velocity = point.air.airspeed / foot
        angle = point.controls.angle_of_attack / degree
        of_angle = horner(_HEATING[::-1], angle)
        of_flow = 17_700.0 * jnp.sqrt(density) * (1e-4 * velocity) ** 3.07
        return of_angle * of_flow * _BTU_PER_FT2_S


def earth() -> Planet:
    """A sphere at rest with an exponential atmosphere."""
    return Planet(
        radius=20_902_900.0 * foot,
        gravity=InverseSquareGravity(0.14076539e17 * foot**3),
        atmosphere=ExponentialAtmosphere(0.002378 * slug / foot**3, 23_800.0 * foot),
    )


def vehicle() -> Vehicle:
    """The Shuttle: a weight of 203 000 lb over 32.174 ft/s2, and 2690 ft2."""
    return Vehicle(
        mass=203_000.0 / 32.174 * slug,
        reference_area=2690.0 * foot**2,
        aerodynamics=PolynomialAerodynamics(_per_radian(_LIFT), _per_radian(_DRAG)),
        trim_angle_of_attack=START_ANGLE_OF_ATTACK,
    )


def glide() -> Scenario:
    """The re-entry at constant bank and angle of attack, down to the energy of its end.

    A flight that ends there at the end altitude has the end velocity as well.
    """
    planet = earth()
    start = EntryState(
        altitude=260e3 * foot,
        longitude=0.0,
        latitude=0.0,
        velocity=25_600.0 * foot,
        flight_path_angle=-1.0 * degree,
        heading=90.0 * degree,
    )
    end = dataclasses.replace(start, altitude=END_ALTITUDE, velocity=END_VELOCITY)
    constant = lambda angle: PolynomialProfile(jnp.array([angle]))
    return Scenario(
        planet=planet,
        vehicle=vehicle(),
        initial_state=start,
        guidance=ControlProfiles(
            EnergyIndex(), planet, constant(START_ANGLE_OF_ATTACK), constant(START_BANK)
        ),
        termination=Termination(
            {
                "energy": EnergyBelow(energy=energy(planet, end)),
                "ground": AltitudeBelow(altitude=0.0, outcome=Outcome.CRASHED),
            },
            time_limit=4000.0,
        ),
        target=Target(
            END_ALTITUDE, END_VELOCITY, 0.0, flight_path_angle=END_PATH_ANGLE
        ),
        constraints={
            "wing_heat_rate": WingHeatRate(),
            "load_factor": LoadFactor(),
        },
        step=STEP,
    )


def limited_heating(scenario: Scenario) -> Scenario:
    """A heat rate of the wing of at most 70 Btu/(ft2 s)."""
    limited = WingHeatRate(limit=HEATING_LIMIT)
    constraints = {**scenario.constraints, "wing_heat_rate": limited}
    return dataclasses.replace(scenario, constraints=constraints)
