"""Constraints on a flight: values at its end, and limits along its path."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Array

from ..flight.flight import Flight
from ..flight.scenario import Scenario
from ..motion.constraints import AbstractConstraint


Quantity = Callable[[Scenario, Flight], Any]
"""Function of a scenario and its flight: one number, or one for each history entry"""


@dataclasses.dataclass(frozen=True)
class Constraint:
    """A constraint on a quantity of a flight: it equals a value, or lies between two.

        Constraint(lambda s, f: f.state.altitude, equals=24.4 * km)
        Constraint(lambda s, f: f.peaks.load_factor, at_most=2.5)

    A quantity of the history is constrained at each entry. This is better than a constraint
    on the peak, whose place changes from flight to flight.
    """

    quantity: Quantity
    equals: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    scale: float | None = None
    """Scale of the quantity; None for the larger magnitude of the values"""

    def __post_init__(self):
        equal, least, most = self.equals, self.at_least, self.at_most
        for name in ("equals", "at_least", "at_most"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise ValueError(f"{name} is {value}: it must be a finite number")
        if equal is None and least is None and most is None:
            raise ValueError(
                "a constraint has no value: give equals=, at_least= or at_most="
            )
        if equal is not None and (least is not None or most is not None):
            raise ValueError(
                f"a constraint must equal {equal}, and be at least {least} or at most "
                f"{most}: give either equals= or the limits"
            )
        if least is not None and most is not None and not least < most:
            raise ValueError(
                f"a constraint must be at least {least} and at most {most}: the first "
                "must be the smaller; for one value give equals="
            )
        if self.scale is not None and not 0.0 < self.scale < np.inf:
            raise ValueError(f"scale is {self.scale}: it must be finite and above zero")
        if self.size == 0.0:
            raise ValueError(
                "a constraint has the value 0, from which no scale follows: "
                "give scale=, in the unit of the quantity"
            )

    @property
    def least(self) -> float:
        """The least allowed value, minus infinity if there is none."""
        return _first(self.equals, self.at_least, -np.inf)

    @property
    def most(self) -> float:
        """The largest allowed value, infinity if there is none."""
        return _first(self.equals, self.at_most, np.inf)

    @property
    def size(self) -> float:
        """The scale by which the quantity is divided."""
        values = np.abs([self.least, self.most])
        return _first(self.scale, float(np.max(values[np.isfinite(values)])))


def _first(*values: float | None) -> float:
    return next(float(value) for value in values if value is not None)


@dataclasses.dataclass(frozen=True)
class AlongPath:
    """A path constraint at each entry of the history; for an integral, its last value."""

    name: str

    def __call__(self, scenario: Scenario, flight: Flight) -> Array:
        if not isinstance(scenario.constraints[self.name], AbstractConstraint):
            return flight.peaks[self.name]
        if flight.history is None:
            raise ValueError(
                f"{self.name} is constrained at each entry of the history, and there is "
                "no history: give an interval, such as history=5.0"
            )
        return flight.history.constraints[self.name]


def within_limits(scenario: Scenario) -> dict[str, Constraint]:
    """The limits of the path constraints of a scenario, as constraints of `optimize`.

    They hold at each entry of the history, so that `optimize` needs a history.

    **Raises:** `ValueError` if no path constraint has a limit.
    """
    limits = {n: c.limit for n, c in scenario.constraints.items()}
    found = {n: float(limit) for n, limit in limits.items() if limit is not None}
    if not found:
        raise ValueError(
            "no path constraint of the scenario has a limit: give one, such as "
            'constraints={**scenario.constraints, "heat_rate": HeatRate(1e6)}'
        )
    # A constraint with a limit of zero, such as the equilibrium glide, has a scale of one.
    return {
        name: Constraint(AlongPath(name), at_most=limit, scale=abs(limit) or 1.0)
        for name, limit in found.items()
    }
