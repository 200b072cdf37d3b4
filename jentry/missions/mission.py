"""What a mission is: a scenario with a name, its dispersions and its published table."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..campaign.dispersions import Dispersion
from ..flight.scenario import Scenario


@dataclasses.dataclass(frozen=True)
class PublishedValue:
    """A number that a paper prints of its runs, and how the same is taken from ours."""

    name: str
    value: float
    unit: str
    statistic: Callable[[Mapping[str, Any]], float]
    """Of the variables of a result, by name, each of shape (runs,)"""


@dataclasses.dataclass(frozen=True)
class Mission:
    """One published system, whole."""

    name: str
    title: str
    source: str
    variants: Mapping[str, Callable[[], Scenario]]
    """Builders of the scenario; the first is the mission's own"""
    dispersions: Mapping[str, Callable[[], Mapping[str, Dispersion]]]
    """Readings of the dispersion table; the first is the mission's own. Functions, so
    that importing a mission makes no array"""
    gains: tuple[str, ...] = ("guidance.gains", "guidance.observer")
    """What `jentry tune` tunes unless told otherwise: addresses, or the beginnings of
    some; those that a variant does not have are left out"""
    train: Callable[..., dict[str, dict[str, Any]]] | None = None
    """Trains the mission's networks: of a folder, a seed and options to model cards"""
    published: tuple[PublishedValue, ...] = ()
    published_note: str = ""
    published_variant: str = ""
    published_dispersions: str = ""
    """What the published values belong to"""
    published_runs: int = 1000
    """Of which the published statistics are: the size of the sets they are compared with"""

    def scenario(self, variant: str | None = None) -> Scenario:
        """The nominal scenario. Raises `ValueError` for an unknown variant."""
        return _choose(self.variants, variant, "variant", self.name)()

    def dispersion_table(self, reading: str | None = None) -> Mapping[str, Dispersion]:
        """What is dispersed. Raises `ValueError` for an unknown reading."""
        return _choose(self.dispersions, reading, "dispersions", self.name)()


def _choose(
    options: Mapping[str, Any], name: str | None, what: str, mission: str
) -> Any:
    if name is None:
        return next(iter(options.values()))
    if name not in options:
        raise ValueError(
            f"mission {mission} has no {what} {name!r}: choose from {', '.join(options)}"
        )
    return options[name]


def standard_deviation(values: Any) -> float:
    """Of a sample: divided by the number less one."""
    return float(np.std(values, ddof=1))
