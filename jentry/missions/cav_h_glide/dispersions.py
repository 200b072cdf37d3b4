"""Dispersions of the mission CAV-H glide, which are our own round numbers."""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, multiply
from ...campaign.distributions import Normal
from ..npcg_toolbox import air_and_coefficients, entry_errors


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """Density by 30 %, each coefficient by 10 % and mass by 5 % at 3 sigma."""
    mass = Dispersion(lambda s: s.vehicle.mass, Normal(1.0, 0.05 / 3.0), apply=multiply)
    return air_and_coefficients() | {"mass": mass}


@computed_once
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()
