"""Options of `jentry tune`: scales of the loss; bounds and scales of leaves."""

import math
from collections.abc import Iterable

from ..addresses import leaves_by_address, nearest, require_address, unit_of
from ..analysis.damping import Damping
from ..fields import units_of
from ..flight.miss import Misses, misses
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..parameters.maps import Bounds, Scale
from ..tuning.batch_gradients import Outputs
from ..tuning.losses import MissesAndPeaks, ScaledMisses
from ..tuning.penalties import DampingBelow
from ..units import km, parse_quantity


_MISSES = units_of(Misses)


def parse_scales(options: Iterable[str], scenario: Scenario) -> ScaledMisses:
    """Loss scales from `QUANTITY=SCALE`, for misses and peaks of path constraints.

    **Raises:** `ValueError` for a quantity that is neither.
    """
    scales = {}
    units = _MISSES | {n: c.unit for n, c in scenario.constraints.items()}
    for option in options:
        name, equals, scale = option.partition("=")
        if name not in units:
            raise ValueError(
                f"--of {option}: no miss or path constraint {name!r}; "
                f"{nearest(name, units)}"
            )
        if name in _MISSES and name in scenario.constraints:
            raise ValueError(
                f"--of {option}: {name} is a miss and a path constraint: give the "
                "constraint another name"
            )
        unit = units[name]
        if name in scales:
            raise ValueError(f"--of {name} is given twice: give it once")
        if not equals and unit != "m":
            raise ValueError(f"--of {option}: write {name}=SCALE")
        try:
            scales[name] = parse_quantity(scale, unit) if equals else km
        except ValueError as error:
            raise ValueError(f"--of {option}: {error}") from None
        if not 0.0 < scales[name] < math.inf:
            raise ValueError(f"--of {option}: the scale must be greater than zero")
    if not scales:
        scales = {"downrange": km}
        if scenario.dynamics.has_crossrange:
            scales["crossrange"] = km
    return ScaledMisses(tuple(scales.items()))


def outputs_for(scaled: ScaledMisses, scenario: Scenario) -> Outputs:
    """Outputs of a flight that a loss needs: its misses, and the peaks in the loss."""
    peaks = tuple(name for name, _ in scaled.scales if name in scenario.constraints)
    return MissesAndPeaks(peaks) if peaks else misses


DAMPING_POINTS = 60
"""Number of points of a flight at which its damping is computed"""


def damping_penalty(
    scenario: Scenario,
    solver: AbstractSolver,
    least: float | None,
    faster_than: float | None,
) -> DampingBelow | None:
    """The requested penalty, None for none.

    **Raises:** `ValueError` for a ratio that is not above 0 and at most 1, and for a ratio
    without `faster_than`.
    """
    if least is None:
        return None
    if not 0.0 < least <= 1.0:
        raise ValueError(f"--least-damping is {least}: it must be above 0, at most 1")
    if faster_than is None:
        raise ValueError(
            "--least-damping needs --faster-than 0.1, or another magnitude in rad/s: "
            "slow states look undamped when the loop is frozen"
        )
    damping = Damping.of(
        scenario, points=DAMPING_POINTS, faster_than=faster_than, solver=solver
    )
    return DampingBelow(damping, least)


def parse_ranges(
    bounds: Iterable[str], scales: Iterable[str], scenario: Scenario
) -> dict[str, Bounds | Scale]:
    """Bounds from `ADDRESS=LOW:HIGH` and scales from `ADDRESS=VALUE`, by address."""
    ranges: dict[str, Bounds | Scale] = {}
    known = leaves_by_address(scenario)
    given = [("--bounds", "LOW:HIGH", option) for option in bounds]
    given += [("--scale", "VALUE", option) for option in scales]
    for name, form, option in given:
        address, equals, value = option.partition("=")
        low, colon, high = value.partition(":")
        if not equals or bool(colon) is not (":" in form):
            raise ValueError(f"{name} {option}: write ADDRESS={form}")
        require_address(known, address)
        if address in ranges:
            raise ValueError(
                f"{name} {address} is given twice: give it once, by --bounds or --scale"
            )
        unit = unit_of(scenario, address)
        try:
            ends = [parse_quantity(x, unit) for x in ([low, high] if colon else [low])]
        except ValueError as error:
            raise ValueError(f"{name} {option}: {error}") from None
        ranges[address] = Bounds(*ends) if colon else Scale(*ends)
    return ranges
