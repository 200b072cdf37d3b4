"""Air over Mars that varies at random along the flight, and the dispersions flown in it.

Source: the public repository GovitPowerz/Aerocapture on GitHub, whose author is the first
author of the mission's paper: `src/rust/src/data/dispersions.rs`, and the levels that
`configs/training/common.toml` names. It multiplies the density by 1 + x, where x is an
Ornstein-Uhlenbeck process over the time, with a deviation of 5 % and a correlation time of
120 s.

Here x is a function of the distance over the ground: a sum of waves with random phases. Its
correlation is nearly that of the process. The velocity that turns the time into a distance
is our own choice. Errors of navigation and of the angle of attack, and limits on the motion
of the bank, which the source has too, are left out.
"""

import dataclasses
import math

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add, multiply
from ...campaign.distributions import Constant, Normal, Uniform
from ...flight.scenario import Scenario
from ...units import degree
from ...world.perturbed_atmosphere import GroundWave, PerturbedAtmosphere
from .dispersions import air_and_vehicle


DEVIATION = 0.05
"""Standard deviation of the perturbation, as a share of the density"""
CORRELATION_LENGTH = 120.0 * 4.5e3
"""m: the correlation time by the mean of the velocities at the entry and at the exit"""
WAVES = 8
"""Number of waves; chosen"""
_REACH = 2.0
"""Distance, in correlation lengths, up to which the correlation is that of the process"""


def random_air(scenario: Scenario) -> Scenario:
    """Waves of the density over the ground, which no onboard model knows.

    Their sizes are zero until dispersed."""
    start, planet = scenario.initial_state, scenario.planet
    waves = tuple(
        GroundWave(0.0, length, planet.radius, 0.0, start.longitude, start.latitude)
        for length, _ in wavelengths_and_shares()
    )
    air = PerturbedAtmosphere(planet.atmosphere, ground_waves=waves)
    planet = dataclasses.replace(planet, atmosphere=air)
    return dataclasses.replace(scenario, planet=planet)


def wavelengths_and_shares() -> list[tuple[float, float]]:
    """Wavelength, m, of each wave, and its share of the variance.

    They are the Fourier series of the correlation exp(-distance / correlation length) over
    distances up to `_REACH` correlation lengths. Its constant term is a wave that is a
    hundred times as long as the longest other one. The shares add up to 1.
    """
    longest = 2.0 * _REACH * CORRELATION_LENGTH
    found = [(100.0 * longest, 0.5 * (1.0 - math.exp(-_REACH)))]
    for order in range(1, WAVES):
        number = math.pi * order / _REACH
        ends = 1.0 - (-1) ** order * math.exp(-_REACH)
        found.append((longest / order, ends / (1.0 + number * number)))
    total = sum(share for _, share in found)
    return [(length, share / total) for length, share in found]


@computed_once
def everything_in_random_air() -> dict[str, Dispersion]:
    """Entry, air and vehicle of the source, with the waves of the world `random-air`."""
    entry = {
        "altitude": (lambda s: s.initial_state.altitude, 100.0),
        "longitude": (lambda s: s.initial_state.longitude, 0.1 * degree),
        "latitude": (lambda s: s.initial_state.latitude, 0.05 * degree),
        "velocity": (lambda s: s.initial_state.velocity, 1.0),
        "flight_path_angle": (
            lambda s: s.initial_state.flight_path_angle,
            0.1 * degree,
        ),
        "heading": (lambda s: s.initial_state.heading, 0.05 * degree),
    }
    table = {
        name: Dispersion(where, Normal(0.0, spread), add)
        for name, (where, spread) in entry.items()
    }
    table |= air_and_vehicle()
    table["area"] = Dispersion(
        lambda s: s.vehicle.reference_area, Uniform(0.98, 1.02), multiply
    )
    for place, (_, share) in enumerate(wavelengths_and_shares()):
        wave = lambda s, place=place: s.planet.atmosphere.ground_waves[place]
        table[f"wave {place}"] = Dispersion(
            lambda s, wave=wave: wave(s).amplitude,
            Constant(DEVIATION * math.sqrt(2.0 * share)),
        )
        table[f"phase {place}"] = Dispersion(
            lambda s, wave=wave: wave(s).phase, Uniform(0.0, 2.0 * math.pi)
        )
    return table
