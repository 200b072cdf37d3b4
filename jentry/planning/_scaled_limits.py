"""Parameters and constraints of a flight as vectors of scaled numbers, for a solver."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..parameters.maps import Linear
from ..parameters.parameters import Parameters
from ._constrained import Limits, Linearized
from .flight_constraints import Constraint


def parted(parameters: Parameters, x: Any) -> dict[str, Any]:
    """Free numbers by address, from one vector of all free numbers."""
    found, first = {}, 0
    for address, each in in_order(parameters):
        found[address] = x[first : first + each.start.size].reshape(each.start.shape)
        first += each.start.size
    return found


def in_order(parameters: Parameters) -> list[tuple[str, Linear]]:
    """The maps in the order of the vector: by address, as JAX sorts a dictionary."""
    maps = sorted(parameters.maps.items())
    return [(address, each) for address, each in maps if isinstance(each, Linear)]


class ScaledLimits(NamedTuple):
    """The limits of all values in one vector, with the names of the constraints."""

    x: Limits
    """Limits in units of the scales and sizes"""
    scales: np.ndarray
    """(n,) Scales of the parameters"""
    sizes: np.ndarray
    """(m,) Scales of the constrained values"""
    inside: np.ndarray
    """(m,) Values within the limits, in units of the sizes"""
    names: list[str]
    shapes: list[tuple[int, ...]]

    def named(self, row: np.ndarray) -> dict[str, np.ndarray]:
        named, first = {}, 0
        for name, shape in zip(self.names, self.shapes, strict=True):
            size = math.prod(shape)
            named[name] = row[first : first + size].reshape(shape)
            first += size
        return named


def scaled_limits(
    parameters: Parameters,
    asked: Mapping[str, Constraint],
    shapes: Sequence[tuple[int, ...]],
) -> ScaledLimits:
    """Scaled limits of parameters, and of constraints whose values have these shapes."""
    maps = [each for _, each in in_order(parameters)]

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([np.ravel(getattr(each, name)) for each in maps])

    start, scales = all_of("start"), all_of("scale")
    lower, upper = ((all_of(x) - start) / scales for x in ("lower", "upper"))

    def row(of: Callable[[Constraint], float]) -> np.ndarray:
        each = zip(shapes, asked.values(), strict=True)
        rows = [np.full(math.prod(shape), of(constraint)) for shape, constraint in each]
        return np.concatenate([np.zeros(0), *rows])

    sizes = row(lambda each: each.size)
    least, most = (row(of) / sizes for of in (lambda c: c.least, lambda c: c.most))
    from_one_side = np.where(np.isfinite(least), least + 1.0, most - 1.0)
    both = np.isfinite(least) & np.isfinite(most)
    with np.errstate(invalid="ignore"):
        inside = np.where(both, 0.5 * (least + most), from_one_side)
    x = Limits(lower, upper, least, most)
    return ScaledLimits(x, scales, sizes, inside, list(asked), list(shapes))


_STILL = 1e-12
"""Derivative below which it is rounding, in the units of the problem"""


def what_is_wrong(limits: ScaledLimits, here: Linearized) -> str:
    """Description of why a point is not feasible.

    It names the constraints that do not depend on the parameters, or else the constraints
    that are not met, the worst first.
    """
    values, equal = here.constraints, limits.x.least == limits.x.most
    rows = np.max(np.abs(here.rows), axis=1, initial=0.0)
    still = limits.named(equal & (rows < _STILL))
    named = [name for name, x in still.items() if np.any(x)]
    if named:
        return (
            f"{', '.join(named)} must equal a value, but does not depend on the parameters "
            "there: leave the constraint out, or look at how the flight ends"
        )
    beyond = np.maximum(limits.x.least - values, values - limits.x.most)
    worst = {n: float(np.max(x, initial=0.0)) for n, x in limits.named(beyond).items()}
    named = sorted(worst, key=lambda name: -worst[name])
    off = [
        f"{name} by {worst[name]:.2g} of its scale"
        for name in named
        if worst[name] > 1e-6
    ]
    if not off:
        return "all constraints are met there"
    return f"not met there: {', '.join(off)}"
