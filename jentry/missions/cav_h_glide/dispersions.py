"""What is uncertain in the mission CAV-H glide. All of it is our own: round numbers."""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, multiply
from ...campaign.distributions import Normal
from ..npcg_toolbox import air_and_coefficients, entry_errors


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """At 3 sigma 30 % of the density, 10 % of each coefficient and 5 % of the mass."""
    mass = Dispersion(lambda s: s.vehicle.mass, Normal(1.0, 0.05 / 3.0), apply=multiply)
    return air_and_coefficients() | {"mass": mass}


@computed_once
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()
