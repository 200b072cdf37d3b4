"""Worlds of the mission `msl`: wind and waves, other air, and the range trigger."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from ...flight.scenario import Scenario
from ...flight.termination import RangeToGoBelow, Termination, VelocityBelow
from ...motion.quantities import from_ground_track
from ...units import km
from ...world.perturbed_atmosphere import DensityWave, PerturbedAtmosphere
from ...world.random_air import RandomWind
from ...world.random_profile import RandomAltitudeProfile
from ...world.tabulated_atmosphere import TabulatedAtmosphere
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


def density_and_temperature(altitude):
    """Density (kg/m3) and temperature (K) of the air of the toolbox, at altitudes in m.

    The toolbox names AAS 18-485 as its source, which we have not read.
    """
    h = altitude
    temperature = 1.4e-13 * h**3 - 8.85e-9 * h**2 - 1.245e-3 * h + 205.3645
    surface = 559.351005946503 / (188.95110711075 * temperature)
    return surface * jnp.exp(-0.000105 * h), temperature


def fitted_air(scenario: Scenario) -> Scenario:
    """The air of the toolbox; the onboard model has the exponential one.

    The fit is tabulated each kilometre, which changes its density by less than 1e-6.
    """
    altitudes = jnp.arange(-8.0 * km, 136.0 * km, km)
    densities, temperatures = density_and_temperature(altitudes)
    air = TabulatedAtmosphere(
        altitudes,
        densities,
        temperatures,
        gas_constant=188.95110711075,
        heat_capacity_ratio=1.29,
    )
    perturbed = isinstance(scenario.planet.atmosphere, PerturbedAtmosphere)
    return eqx.tree_at(
        lambda s: s.planet.atmosphere.undisturbed if perturbed else s.planet.atmosphere,
        scenario,
        air,
    )


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
