"""Common parts of the missions of the NPCG Toolbox: Earth, air, entry, dispersions, bank.

The Earth is that of the examples `Earth_Apollo10` and `Earth_CAVH` of the NPCG Toolbox of
Iowa State University (Y. Lee, D. Y. Lee, B. Wie, 2024), which calls the air "Hicks 2009".
The dispersions, the step and the ceiling are our own round numbers.
"""

import equinox as eqx
import jax.numpy as jnp

from .._computed_once import computed_once
from .._math import sincos
from ..campaign.dispersions import Dispersion, add
from ..campaign.distributions import Normal
from ..flight.scenario import Scenario
from ..guidance.bank_shapes import LinearBankShape
from ..motion.quantities import energy
from ..motion.state import EntryState
from ..units import degree, km
from ..world.atmosphere import ExponentialAtmosphere
from ..world.gravity import InverseSquareGravity
from ..world.perturbed_atmosphere import PerturbedAtmosphere
from ..world.planet import Planet
from ..world.tabulated_atmosphere import TabulatedAtmosphere
from ..world.us_standard_atmosphere import USStandardAtmosphere1976


ROTATION_RATE = 7.292115e-5
"""Rotation rate, rad/s, of WGS 84; the toolbox has one turn in 86 400 s, 0.3 % slower"""
CEILING = 125.0 * km
"""Altitude above which a flight has skipped out"""
STEP = 0.5
"""Length of a step, s; the bank is smooth within a guidance cycle"""


def earth(heating_coefficient: float, heating_exponent: int | float = 3) -> Planet:
    """A rotating sphere with an exponential atmosphere."""
    return Planet(
        radius=6378.137 * km,
        gravity=InverseSquareGravity(3.98600435507e14),
        atmosphere=ExponentialAtmosphere(1.225, 1.0 * km / 0.14),
        rotation_rate=ROTATION_RATE,
        heating_coefficient=heating_coefficient,
        heating_exponent=heating_exponent,
    )


def relative_entry(
    planet: Planet,
    *,
    radius: float,
    longitude: float,
    latitude: float,
    velocity: float,
    flight_path_angle: float,
    heading: float,
) -> EntryState:
    """State relative to the rotating planet, of an inertial entry.

    Velocity (m/s), flight-path angle and heading (rad) are inertial. The radius is that
    from the centre, m.
    """
    sin_path, cos_path = sincos(jnp.asarray(flight_path_angle))
    sin_heading, cos_heading = sincos(jnp.asarray(heading))
    carried = planet.rotation_rate * radius * jnp.cos(latitude)
    up = velocity * sin_path
    north = velocity * cos_path * cos_heading
    east = velocity * cos_path * sin_heading - carried
    level = jnp.hypot(north, east)
    return EntryState(
        altitude=radius - planet.radius,
        longitude=longitude,
        latitude=latitude,
        velocity=jnp.hypot(up, level),
        flight_path_angle=jnp.arctan2(up, level),
        heading=jnp.arctan2(east, north),
    )


def linear_bank(
    planet: Planet,
    end: EntryState,
    *,
    first: float,
    final: float,
    largest: float,
    kind: type[LinearBankShape] = LinearBankShape,
) -> LinearBankShape:
    """Bank that is linear over the energy, from the present bank to that at the end, rad.

    `first` is the present bank before the first correction.
    """
    return kind(
        end=energy(planet, end),
        final=final,
        largest=largest,
        first=1.0 - first / largest,
    )


def through_us_1976(scenario: Scenario) -> Scenario:
    """US Standard Atmosphere 1976; the onboard model has the exponential atmosphere."""
    return eqx.tree_at(
        lambda s: s.planet.atmosphere, scenario, USStandardAtmosphere1976()
    )


def mars_density_and_temperature(altitude):
    """Density (kg/m3) and temperature (K) of the air of Mars, at altitudes in m.

    The example `ex_Mars_robotic` has these fits. It names AAS 18-485 as its source, which
    we have not read.
    """
    h = altitude
    temperature = 1.4e-13 * h**3 - 8.85e-9 * h**2 - 1.245e-3 * h + 205.3645
    surface = 559.351005946503 / (188.95110711075 * temperature)
    return surface * jnp.exp(-0.000105 * h), temperature


def through_fitted_mars_air(scenario: Scenario) -> Scenario:
    """The fitted air of Mars; the onboard model has the exponential one.

    The fit is tabulated each kilometre, which changes its density by less than 1e-6.
    """
    altitudes = jnp.arange(-8.0 * km, 136.0 * km, km)
    densities, temperatures = mars_density_and_temperature(altitudes)
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


def _initial(name: str, three_sigma: float) -> Dispersion:
    where = lambda s: getattr(s.initial_state, name)
    return Dispersion(where, Normal(0.0, three_sigma / 3.0), apply=add)


@computed_once
def entry_errors() -> dict[str, Dispersion]:
    """Entry state: a tenth of a degree of each angle, and 10 m/s, at 3 sigma."""
    tenth = 0.1 * degree
    return {
        "longitude": _initial("longitude", tenth),
        "latitude": _initial("latitude", tenth),
        "velocity": _initial("velocity", 10.0),
        "flight-path angle": _initial("flight_path_angle", tenth),
        "heading": _initial("heading", tenth),
    }


@computed_once
def air_and_coefficients() -> dict[str, Dispersion]:
    """Density by 30 % and each coefficient by 10 % at 3 sigma."""
    coefficient = Normal(1.0, 0.1 / 3.0)
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Normal(1.0, 0.3 / 3.0)),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, coefficient),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, coefficient),
    }
