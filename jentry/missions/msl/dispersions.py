"""Dispersions of the mission `msl`.

Only the error of the flight-path angle is published. The others are chosen: they are the
round numbers of the other missions of this package, and were chosen before any ellipse was
computed.
"""

import math

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add, multiply
from ...campaign.distributions import Constant, Normal, Uniform
from ...units import degree
from ..mars.air_with_waves import WAVES
from ..npcg_toolbox import air_and_coefficients, entry_errors as rounded_entry_errors


GUST = 20.0
"""Standard deviation of the wind towards east and towards north, m/s"""


@computed_once
def entry_errors() -> dict[str, Dispersion]:
    """Entry state: 0.2 degrees of flight-path angle at 3 sigma, as was required.

    The requirement before the launch was 0.2 degrees in either direction (T. J. Martin-Mur
    and others, "Mars Science Laboratory Navigation Results", 2012, abstract). We read it as
    3 sigma, and as the angle relative to the planet: the abstract does not say which one
    it means. A change of the inertial angle changes the relative one by 1.04 times as much.
    Chosen, at 3 sigma: a tenth of a degree of longitude, latitude and heading, and
    2 m/s.
    """
    chosen = rounded_entry_errors()
    state = lambda name: lambda s: getattr(s.initial_state, name)
    return {
        **{name: chosen[name] for name in ("longitude", "latitude", "heading")},
        "velocity": Dispersion(state("velocity"), Normal(0.0, 2.0 / 3.0), apply=add),
        "flight-path angle": Dispersion(
            state("flight_path_angle"), Normal(0.0, 0.2 * degree / 3.0), apply=add
        ),
    }


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """Density by 30 %, each coefficient by 10 % and the mass by 1 %, at 3 sigma; chosen."""
    mass = Dispersion(lambda s: s.vehicle.mass, Normal(1.0, 0.01 / 3.0), apply=multiply)
    return air_and_coefficients() | {"mass": mass}


@computed_once
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()


@computed_once
def wind() -> dict[str, Dispersion]:
    """Random winds of the world `wind-and-waves`, of 20 m/s at one sigma; chosen."""
    air = lambda s: s.planet.wind
    return {
        "wind": Dispersion(lambda s: air(s).standard_deviation, Constant(GUST)),
        "wind east": Dispersion(lambda s: air(s).east.seed, Uniform(0.0, 1.0)),
        "wind north": Dispersion(lambda s: air(s).north.seed, Uniform(0.0, 1.0)),
    }


@computed_once
def waves() -> dict[str, Dispersion]:
    """Density waves of the world `wind-and-waves`: those of `mars-range-tracking`.

    They are 5 % of the density with a wavelength of 25 km over the altitude, and 2 % with
    8 km.
    """
    table = {}
    for place, (_, amplitude) in enumerate(WAVES):
        wave = lambda s, place=place: s.planet.atmosphere.waves[place]
        table[f"wave {place}"] = Dispersion(
            lambda s, wave=wave: wave(s).amplitude, Constant(amplitude)
        )
        table[f"phase {place}"] = Dispersion(
            lambda s, wave=wave: wave(s).phase, Uniform(0.0, 2.0 * math.pi)
        )
    return table


@computed_once
def everything_with_wind() -> dict[str, Dispersion]:
    """Entry, air and vehicle, with wind and waves."""
    return everything() | wind() | waves()
