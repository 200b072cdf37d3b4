"""The dispersed runs of a tuning run: those to tune on, and those to judge by."""

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
    """What is dispersed, and how many draws are tuned on and judged by.

    Draws(mission.dispersion_table(), jax.random.key(0), runs=256)
    """

    dispersions: Mapping[str, Dispersion]
    key: Key[Array, ""]
    runs: int = 256
    """Draws of which the loss is"""
    held_out: int = 5000
    """Other draws, which tuning never sees, to judge by"""
    fresh: bool = False
    """Whether each gradient has new draws; the best point is still judged by the same"""

    def __post_init__(self):
        if not self.dispersions:
            raise ValueError("nothing is dispersed: give dispersions")
        for name in ("runs", "held_out"):
            value = getattr(self, name)
            if value < 2:
                raise ValueError(f"{name} is {value}: it must be at least 2")

    def inputs(self, scenario: Scenario, step: int = 0) -> dict[str, np.ndarray]:
        """Dispersed leaves of the runs of a step, by address. The steps share no draw."""
        runs = step * self.runs + np.arange(self.runs)
        return drawn_inputs(scenario, self.dispersions, self.key, runs)

    def check(self, scenario: Scenario, steps: int) -> None:
        """Refuse dispersions, and any draw of so many steps or held out, that cannot be
        flown."""
        check_dispersions(scenario, self.dispersions)
        if self.fresh:
            runs = np.arange((steps + 1) * self.runs)
            check_draws(scenario, self.dispersions, self.key, runs)
        unseen = np.arange(self.held_out)
        drawn_inputs(scenario, self.dispersions, held_out(self.key), unseen)


def held_out(key: Key[Array, ""]) -> Key[Array, ""]:
    """The key of draws that tuning with a key never sees."""
    return jax.random.fold_in(key, zlib.crc32(b"held-out"))
