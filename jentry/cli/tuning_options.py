"""Options of `jentry tune`: scales of the loss, bounds and scales of leaves."""

import math
from collections.abc import Iterable

from ..addresses import leaves_by_address, nearest, require_address, unit_of
from ..fields import units_of
from ..flight.miss import Misses
from ..flight.scenario import Scenario
from ..tuning.losses import ScaledMisses
from ..units import km, parse_quantity


_MISSES = units_of(Misses)


def parse_scales(options: Iterable[str], scenario: Scenario) -> ScaledMisses:
    """`MISS=SCALE` of the command line. Raises `ValueError` for what is no miss."""
    scales = {}
    for option in options:
        name, equals, scale = option.partition("=")
        if name not in _MISSES:
            raise ValueError(
                f"--of {option}: no miss {name!r}; {nearest(name, _MISSES)}"
            )
        unit = _MISSES[name]
        if name in scales:
            raise ValueError(f"--of {name} is given twice: once")
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


def parse_bounds(
    options: Iterable[str], scenario: Scenario
) -> dict[str, tuple[float, float]]:
    """`ADDRESS=LOW:HIGH` of the command line."""
    bounds = {}
    known = leaves_by_address(scenario)
    for option in options:
        address, equals, interval = option.partition("=")
        low, colon, high = interval.partition(":")
        if not equals or not colon:
            raise ValueError(f"--bounds {option}: write ADDRESS=LOW:HIGH")
        require_address(known, address)
        if address in bounds:
            raise ValueError(f"--bounds {address} is given twice: once")
        unit = unit_of(scenario, address)
        try:
            bounds[address] = parse_quantity(low, unit), parse_quantity(high, unit)
        except ValueError as error:
            raise ValueError(f"--bounds {option}: {error}") from None
    return bounds


def parse_leaf_scales(options: Iterable[str], scenario: Scenario) -> dict[str, float]:
    """`ADDRESS=VALUE` of the command line."""
    scales = {}
    known = leaves_by_address(scenario)
    for option in options:
        address, equals, value = option.partition("=")
        if not equals:
            raise ValueError(f"--scale {option}: write ADDRESS=VALUE")
        require_address(known, address)
        if address in scales:
            raise ValueError(f"--scale {address} is given twice: once")
        try:
            scales[address] = parse_quantity(value, unit_of(scenario, address))
        except ValueError as error:
            raise ValueError(f"--scale {option}: {error}") from None
    return scales
