"""The dispersed runs of a tuning run: tuning draws and held-out draws."""

import dataclasses
import zlib
from collections.abc import Mapping

import jax
import numpy as np
from jaxtyping import Array, Key

from ..campaign.campaign import check_draws, drawn_inputs
from ..campaign.dispersions import Dispersion, check_dispersions
from ..flight.scenario import Scenario


@dataclasses.dataclass(frozen=True)
class Draws:
    """Dispersions, and the numbers of draws for tuning and for the held-out evaluation.

    Draws(mission.dispersion_table(), jax.random.key(0), runs=256)
    """

    dispersions: Mapping[str, Dispersion]
    key: Key[Array, ""]
    runs: int = 256
    """Number of draws over which the loss is computed"""
    held_out: int = 5000
    """Number of held-out draws, on which the tuned scenario is evaluated. Tuning never
    uses them"""
    fresh: bool = False
    """Whether each gradient uses new draws. The losses that decide which point is best
    still use the same draws at all points"""

    def __post_init__(self):
        if not self.dispersions:
            raise ValueError("nothing is dispersed: give dispersions")
        for name in ("runs", "held_out"):
            value = getattr(self, name)
            if value < 2:
                raise ValueError(f"{name} is {value}: it must be at least 2")

    def inputs(self, scenario: Scenario, step: int = 0) -> dict[str, np.ndarray]:
        """Dispersed leaves of the runs of one step, by address. Steps share no draws."""
        runs = step * self.runs + np.arange(self.runs)
        return drawn_inputs(scenario, self.dispersions, self.key, runs)

    def check(self, scenario: Scenario, steps: int) -> None:
        """Check the dispersions, the held-out draws and fresh draws of `steps` steps.

        **Raises:** `ValueError` if any of them cannot be flown.
        """
        check_dispersions(scenario, self.dispersions)
        if self.fresh:
            runs = np.arange((steps + 1) * self.runs)
            check_draws(scenario, self.dispersions, self.key, runs)
        unseen = np.arange(self.held_out)
        drawn_inputs(scenario, self.dispersions, held_out(self.key), unseen)


def held_out(key: Key[Array, ""]) -> Key[Array, ""]:
    """The key of the held-out draws, which tuning with `key` never uses."""
    return jax.random.fold_in(key, zlib.crc32(b"held-out"))
