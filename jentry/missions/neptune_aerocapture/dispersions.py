"""Dispersions of the Neptune aerocapture: those of AMAT, and a published density.

Flight-path angle and lift are those of the Monte Carlo campaign of AMAT that `scenario`
names. Its densities are drawn from files of NeptuneGRAM that are not public. In their
place is the three sigma of NeptuneGRAM at the altitudes of an aerocapture, 30 %, as stated
in the abstract of A. P. Girija, "Comparative Study of Planetary Atmospheric Uncertainties
and Design Rules for Aerocapture Missions", arXiv:2310.10067, 2023.
"""

from ..._computed_once import computed_once
from ...campaign.dispersions import Dispersion, add
from ...campaign.distributions import Normal
from ...units import degree
from .scenario import LIFT_TO_DRAG


@computed_once
def entry_errors() -> dict[str, Dispersion]:
    """Error of the flight-path angle at the entry."""
    return {
        "flight_path_angle": Dispersion(
            lambda s: s.initial_state.flight_path_angle, Normal(0.0, 0.11 * degree), add
        ),
    }


@computed_once
def air_and_vehicle() -> dict[str, Dispersion]:
    """Errors of the density and the lift."""
    return {
        "density": Dispersion(lambda s: s.planet.density_scale, Normal(1.0, 0.3 / 3)),
        "lift": Dispersion(
            lambda s: s.vehicle.lift_scale, Normal(1.0, 0.013 / LIFT_TO_DRAG)
        ),
    }


@computed_once
def everything() -> dict[str, Dispersion]:
    """Entry, air and vehicle together."""
    return entry_errors() | air_and_vehicle()
