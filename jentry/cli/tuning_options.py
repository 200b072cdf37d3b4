"""Options of `jentry tune`: scales of the loss, bounds and scales of leaves."""

import math
from collections.abc import Iterable

from ..addresses import leaves_by_address, nearest, require_address, unit_of
from ..fields import units_of
from ..flight.miss import Misses
from ..flight.scenario import Scenario
from ..tuning.losses import ScaledMisses
from ..tuning.maps import Bounds, Scale
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


def parse_ranges(
    bounds: Iterable[str], scales: Iterable[str], scenario: Scenario
) -> dict[str, Bounds | Scale]:
    """`ADDRESS=LOW:HIGH` and `ADDRESS=VALUE` of the command line, by address."""
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
                f"{name} {address} is given twice: once, by --bounds or by --scale"
            )
        unit = unit_of(scenario, address)
        try:
            ends = [parse_quantity(x, unit) for x in ([low, high] if colon else [low])]
        except ValueError as error:
            raise ValueError(f"{name} {option}: {error}") from None
        ranges[address] = Bounds(*ends) if colon else Scale(*ends)
    return ranges
