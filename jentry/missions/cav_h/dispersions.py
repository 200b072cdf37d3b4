"""Dispersions of the CAV-H mission: Table 2, sensors, air, and those for training."""

import math
from collections.abc import Callable

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add, multiply
from ...campaign.distributions import AbstractDistribution, Constant, Normal, Uniform
from ...units import degree, km, micro_g


RADIUS = 6371.0 * km
"""Radius of the Earth, on which Table 2 counts range and cross range, m"""


WAVELENGTHS = 25.0 * km, 8.0 * km
AMPLITUDES = 0.05, 0.02
"""Amplitudes of the waves of the density, as shares of it"""
TREND_ALTITUDES = 30.0 * km, 80.0 * km
TREND_DEVIATIONS = 0.1 / 3.0, 0.25 / 3.0
"""Standard deviations of the trend of the density at these altitudes, as shares of it"""
FACTOR_DEVIATION = 0.1 / 3.0
"""Standard deviation of the other factors"""


def _initial_state(
    about_zero: Callable[[float], AbstractDistribution],
) -> dict[str, Dispersion]:
    """Initial state of Table 2, each distribution from its printed number."""

    def moved(where, printed):
        return Dispersion(where, about_zero(printed), apply=add)

    return {
        "range": moved(lambda s: s.initial_state.latitude, 1.5 * km / RADIUS),
        "cross range": moved(lambda s: s.initial_state.longitude, 1.5 * km / RADIUS),
        "altitude": moved(lambda s: s.initial_state.altitude, 1.5 * km),
        "velocity": moved(lambda s: s.initial_state.velocity, 75.0),
        "flight-path angle": moved(
            lambda s: s.initial_state.flight_path_angle, 0.06 * degree
        ),
        "azimuth": moved(lambda s: s.initial_state.heading, 0.06 * degree),
    }


def _three_sigma(printed: float) -> Normal:
    return Normal(0.0, printed / 3.0)


def _factors(distribution) -> dict[str, Dispersion]:
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, distribution),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, distribution),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, distribution),
    }


@computed_once
def normal() -> dict[str, Dispersion]:
    """Table 2 with normal factors, 10 % at 3 sigma."""
    return _initial_state(_three_sigma) | _factors(Normal(1.0, FACTOR_DEVIATION))


@computed_once
def uniform() -> dict[str, Dispersion]:
    """Table 2 with uniform factors within 10 %."""
    return _initial_state(_three_sigma) | _factors(Uniform(0.9, 1.1))


@computed_once
def _accelerometers() -> dict[str, Dispersion]:
    """Bias of 100 micro-g and scale factor of 300 ppm at 3 sigma, noise of 50 micro-g in
    each sample.
    """
    bias = Normal(0.0, 100.0 * micro_g / 3.0)
    scale = Normal(0.0, 300e-6 / 3.0)
    noise = Constant(50.0 * micro_g)
    return {
        "lift bias": Dispersion(lambda s: s.accelerometers.lift_bias, bias),
        "drag bias": Dispersion(lambda s: s.accelerometers.drag_bias, bias),
        "lift scale": Dispersion(lambda s: s.accelerometers.lift_scale_error, scale),
        "drag scale": Dispersion(lambda s: s.accelerometers.drag_scale_error, scale),
        "noise": Dispersion(lambda s: s.accelerometers.noise, noise),
        "noise seed": Dispersion(lambda s: s.accelerometers.noise_seed, Uniform(0, 1)),
    }


def normal_sensed() -> dict[str, Dispersion]:
    """Dispersions `normal` with errors of the accelerometers."""
    return normal() | _accelerometers()


def uniform_sensed() -> dict[str, Dispersion]:
    """Dispersions `uniform` with errors of the accelerometers."""
    return uniform() | _accelerometers()


@computed_once
def _waves() -> dict[str, Dispersion]:
    """Dispersed atmosphere of studies of the RLV: at 3 sigma a trend of 10 % at 30 km to
    25 % at 80 km, and waves of 5 % (25 km) and 2 % (8 km).
    """
    low, high = (Constant(share) for share in TREND_DEVIATIONS)
    long, short = (Constant(amplitude) for amplitude in AMPLITUDES)
    air = lambda s: s.planet.atmosphere
    phase = Uniform(0.0, 2.0 * math.pi)
    return {
        "trend": Dispersion(lambda s: air(s).trend, Normal(0.0, 1.0)),
        "trend at 30 km": Dispersion(lambda s: air(s).share_low, low),
        "trend at 80 km": Dispersion(lambda s: air(s).share_high, high),
        "long wave": Dispersion(lambda s: air(s).waves[0].amplitude, long),
        "its phase": Dispersion(lambda s: air(s).waves[0].phase, phase),
        "short wave": Dispersion(lambda s: air(s).waves[1].amplitude, short),
        "phase of that": Dispersion(lambda s: air(s).waves[1].phase, phase),
    }


def waves_sensed() -> dict[str, Dispersion]:
    """Dispersions `normal-sensed` with a density factor that varies with altitude."""
    others = {name: d for name, d in normal().items() if name != "density"}
    return others | _waves() | _accelerometers()


def _wider(printed: float) -> Uniform:
    """Uniform within 1.5 times 3 sigma: a normal draw is outside once in 150 000."""
    return Uniform(-1.5 * printed, 1.5 * printed)


@computed_once
def training_dispersions() -> dict[str, Dispersion]:
    """Dispersions of the training flights: uniform, 1.5 times as wide as Table 2.

    Lift and drag vary by 20 %, the product of two factors at their limit of 10 %. k2 is
    dispersed too.
    """
    factor = Uniform(0.8, 1.22)
    return _initial_state(_wider) | {
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, factor, apply=multiply),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, factor, apply=multiply),
        "k2": Dispersion(lambda s: s.guidance.parameters.k2, Uniform(0.3, 1.05)),
    }


@computed_once
def state_training_dispersions() -> dict[str, Dispersion]:
    """Dispersions of the training flights of a network with only the state as input.

    They are for one curve. The network cannot know the factors, only their distribution:
    the factors have the distribution of the flights in which it is used.
    """
    return _initial_state(_wider) | _factors(Normal(1.0, FACTOR_DEVIATION))
