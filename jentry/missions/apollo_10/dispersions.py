"""Dispersions of the Apollo 10 mission: those common to the missions of the toolbox."""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion
from ..npcg_toolbox import air_and_coefficients as air_and_vehicle, entry_errors


@computed_once
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()
