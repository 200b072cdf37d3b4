"""Dispersions of the RLV mission: Table 1, and the atmosphere of its third row."""

import numpy as np

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add
from ...campaign.distributions import Constant, Normal, Uniform
from ...units import degree


def _wave(where, three_sigma: float) -> Dispersion:
    return Dispersion(where, Normal(0.0, three_sigma / 3.0))


def _phase(where) -> Dispersion:
    return Dispersion(where, Uniform(0.0, 2.0 * np.pi))


@computed_once
def atmosphere() -> dict[str, Dispersion]:
    """A trend and three waves of random phase; the paper prints no numbers of them."""
    air = lambda s: s.planet.atmosphere
    # The share of the density is that at 3 sigma.
    return {
        "density trend": Dispersion(lambda s: air(s).trend, Normal(0.0, 1.0 / 3.0)),
        "long wave": _wave(lambda s: air(s).waves[0].amplitude, 0.05),
        "long wave phase": _phase(lambda s: air(s).waves[0].phase),
        "short wave": _wave(lambda s: air(s).waves[1].amplitude, 0.02),
        "short wave phase": _phase(lambda s: air(s).waves[1].phase),
        "ground wave": _wave(lambda s: air(s).ground_waves[0].amplitude, 0.02),
        "ground wave phase": _phase(lambda s: air(s).ground_waves[0].phase),
    }


@computed_once
def table_1() -> dict[str, Dispersion]:
    """Table 1 without its last row: entry, coefficients and atmosphere."""
    return {
        "flight-path angle": Dispersion(
            lambda s: s.initial_state.flight_path_angle,
            Normal(0.0, 0.1 * degree / 3.0),
            apply=add,
        ),
        "lift": Dispersion(lambda s: s.vehicle.lift_scale, Normal(1.0, 0.10 / 3.0)),
        "drag": Dispersion(lambda s: s.vehicle.drag_scale, Normal(1.0, 0.15 / 3.0)),
    } | atmosphere()


@computed_once
def table_1_noise() -> dict[str, Dispersion]:
    """Table 1 without its last row, and different accelerometer noise in each flight."""
    seed = Dispersion(lambda s: s.accelerometers.noise_seed, Uniform(0.0, 1.0))
    return table_1() | {"noise seed": seed}


@computed_once
def table_1_estimated_angle() -> dict[str, Dispersion]:
    """All of Table 1, for the law that uses the measured angle of attack: the Shuttle's."""
    error = Dispersion(lambda s: s.angle_of_attack_error, Constant(0.1 * degree))
    return table_1() | {"estimated angle of attack": error}
