"""What a flight has to keep: values at its end, and limits along its path."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Array

from ..flight.flight import Flight
from ..flight.scenario import Scenario
from ..motion.constraints import AbstractConstraint


Quantity = Callable[[Scenario, Flight], Any]
"""Of a scenario and its flight: a number, or one for each entry of the history"""


@dataclasses.dataclass(frozen=True)
class Constraint:
    """What a flight has to keep: a quantity of it equals a value, or lies between two.

        Constraint(lambda s, f: f.state.altitude, equals=24.4 * km)
        Constraint(lambda s, f: f.peaks.load_factor, at_most=2.5)

    A quantity of the history is kept at each of its entries. That is better than to keep
    the peak, which is at another place in every flight.
    """

    quantity: Quantity
    equals: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    scale: float | None = None
    """How much of the quantity counts as a lot; the larger of the values, if not given"""

    def __post_init__(self):
        equal, least, most = self.equals, self.at_least, self.at_most
        for name in ("equals", "at_least", "at_most"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ValueError(f"{name} is {value}: it must be a finite number")
        if equal is None and least is None and most is None:
            raise ValueError(
                "a constraint has no value to keep: give equals=, at_least= or at_most="
            )
        if equal is not None and (least is not None or most is not None):
            raise ValueError(
                f"a constraint is to equal {equal}, and to be at least {least} or at most "
                f"{most}: give the one or the other"
            )
        if least is not None and most is not None and not least < most:
            raise ValueError(
                f"a constraint is to be at least {least} and at most {most}: the first "
                "must be the smaller; for one value give equals="
            )
        if self.scale is not None and not 0.0 < self.scale < np.inf:
            raise ValueError(f"scale is {self.scale}: it must be finite and above zero")
        if self.size == 0.0:
            raise ValueError(
                "a constraint is to be kept at 0, which does not tell how much is a lot: "
                "give scale=, in the unit of the quantity"
            )

    @property
    def least(self) -> float:
        """Infinite where there is none."""
        return _first(self.equals, self.at_least, -np.inf)

    @property
    def most(self) -> float:
        """Infinite where there is none."""
        return _first(self.equals, self.at_most, np.inf)

    @property
    def size(self) -> float:
        """What the quantity is divided by."""
        values = np.abs([self.least, self.most])
        return _first(self.scale, float(np.max(values[np.isfinite(values)])))


def _first(*values: float | None) -> float:
    return next(float(value) for value in values if value is not None)


@dataclasses.dataclass(frozen=True)
class AlongPath:
    """A path constraint at each entry of the history; of an integral the last value."""

    name: str

    def __call__(self, scenario: Scenario, flight: Flight) -> Array:
        if not isinstance(scenario.constraints[self.name], AbstractConstraint):
            return flight.peaks[self.name]
        if flight.history is None:
            raise ValueError(
                f"{self.name} is to be kept along the path, at each entry of the history: "
                "give an interval, such as history=5.0"
            )
        return flight.history.constraints[self.name]


def within_limits(scenario: Scenario) -> dict[str, Constraint]:
    """The limits of the path constraints of a scenario, as constraints of `optimize`.

    They are kept at each entry of the history, so `optimize` needs one.

    **Raises:** `ValueError` where no path constraint has a limit.
    """
    limits = {n: c.limit for n, c in scenario.constraints.items()}
    found = {n: float(limit) for n, limit in limits.items() if limit is not None}
    if not found:
        raise ValueError(
            "no path constraint of the scenario has a limit: give one, such as "
            'constraints={**scenario.constraints, "heat_rate": HeatRate(1e6)}'
        )
    # What has a limit of zero, such as the equilibrium glide, is in units that are a lot.
    return {
        name: Constraint(AlongPath(name), at_most=limit, scale=abs(limit) or 1.0)
        for name, limit in found.items()
    }
