"""Air that is harder to guide through: waves of the density, and sensors with errors.

Choices of our own: no source gives them together.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx

from ...campaign.dispersions import Dispersion, multiply, scaled_dispersions
from ...campaign.distributions import Constant, Normal, Uniform
from ...flight.scenario import Scenario
from ...onboard.measurement import Accelerometers, PerfectAccelerometers
from ...units import km, micro_g
from ...world.perturbed_atmosphere import DensityWave, PerturbedAtmosphere
from .drag_tracking import lift_to_drag_held


WAVES = (25.0 * km, 0.05), (8.0 * km, 0.02)
"""Wavelength (m) of each wave of the density over the altitude, and its amplitude"""

SCALE_HEIGHT = 0.05 / 3.0
"""Standard deviation of the scale height, as a share of it"""

BIAS, NOISE = 100.0 * micro_g / 3.0, 50.0 * micro_g
"""Standard deviations of the bias of an accelerometer, and of a sample, m/s2"""


def hard_air(scenario: Scenario) -> Scenario:
    """Waves in the air, which no onboard model knows, and accelerometers with errors.

    Their sizes are zero until dispersed. The accelerometers of inertial navigation stay."""
    waves = tuple(DensityWave(0.0, wavelength) for wavelength, _ in WAVES)
    air = PerturbedAtmosphere(scenario.planet.atmosphere, waves)
    scenario = eqx.tree_at(lambda s: s.planet.atmosphere, scenario, air)
    if not isinstance(scenario.accelerometers, PerfectAccelerometers):
        return scenario
    return dataclasses.replace(scenario, accelerometers=Accelerometers())


def air_and_vehicle() -> dict[str, Dispersion]:
    """The usual errors with coefficients together, and the hard air."""
    table = lift_to_drag_held() | {
        "scale height": Dispersion(
            lambda s: s.planet.atmosphere.undisturbed.scale_height,
            Normal(1.0, SCALE_HEIGHT),
            apply=multiply,
        ),
    }
    for place, (_, amplitude) in enumerate(WAVES):
        table[f"wave {place}"] = Dispersion(
            _of_wave(place, "amplitude"), Constant(amplitude)
        )
        table[f"phase {place}"] = Dispersion(
            _of_wave(place, "phase"), Uniform(0.0, 2.0 * math.pi)
        )
    return table


def hard_air_errors() -> dict[str, Dispersion]:
    """Errors of the air and the vehicle, and of accelerometers along lift and drag."""
    bias, sensors = Normal(0.0, BIAS), lambda s: s.accelerometers
    return air_and_vehicle() | {
        "lift bias": Dispersion(lambda s: sensors(s).lift_bias, bias),
        "drag bias": Dispersion(lambda s: sensors(s).drag_bias, bias),
        "noise": Dispersion(lambda s: sensors(s).noise, Constant(NOISE)),
        "noise seed": Dispersion(lambda s: sensors(s).noise_seed, Uniform(0, 1)),
    }


def without_scale_height() -> dict[str, Dispersion]:
    """Errors in hard air but for the scale height, for air that has none."""
    return {n: d for n, d in hard_air_errors().items() if n != "scale height"}


def without_noise() -> dict[str, Dispersion]:
    """Errors in hard air but for the noise of samples, for laws without guidance cycles."""
    noisy = "noise", "noise seed"
    return {n: d for n, d in hard_air_errors().items() if n not in noisy}


def wider() -> dict[str, Dispersion]:
    """Errors in hard air, 1.5 times as wide, as the law `neural` was trained.

    So are waves and noise. The phases and the seed of the noise have no width."""
    table = hard_air_errors()
    noise = Dispersion(lambda s: s.accelerometers.noise, Constant(1.5 * NOISE))
    same = {n: d for n, d in table.items() if "phase" in n or n == "noise seed"}
    waves = {
        f"wave {place}": Dispersion(_of_wave(place, "amplitude"), Constant(1.5 * share))
        for place, (_, share) in enumerate(WAVES)
    }
    return scaled_dispersions(table, 1.5) | same | waves | {"noise": noise}


def _of_wave(place: int, name: str) -> Callable[[Any], Any]:
    return lambda s: getattr(s.planet.atmosphere.waves[place], name)
