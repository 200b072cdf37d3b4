"""Factors between usual units and SI: multiply to convert to SI, divide to convert back.

altitude = 125 * km
flight_path_angle = -14.2 * degree
altitude / km
"""

import functools
import math
import re
from typing import Any, NamedTuple

import numpy as np


km = 1000.0
degree = math.pi / 180.0
deg = degree
foot = 0.3048
nautical_mile = 1852.0
slug = 14.593902937206364
pound = 0.45359237
minute = 60.0
hour = 3600.0
micro_g = 9.80665e-6
"""One micro-g in m/s2"""
standard_gravity = 9.80665
"""Standard gravity in m/s2, the unit of load factors"""

TURN = 2.0 * math.pi
"""One turn in rad; a larger angle was probably meant in degrees"""


class UnknownUnit(ValueError):
    """Error for a text that is not a known unit."""


class Quantity(NamedTuple):
    """A number from a user, with its unit if it has one."""

    number: float
    unit: str
    text: str

    def si(self, unit: str) -> float:
        """The number in an SI unit.

        Raises `ValueError` for a unit that is unknown or of another dimension, and for an
        angle without a unit beyond one turn, which was probably meant in degrees.
        """
        if not self.unit and unit == "rad" and TURN < abs(self.number) < math.inf:
            raise ValueError(
                f"{self.text} rad is beyond a turn: did you mean {self.text}deg?"
            )
        if self.unit in ("", unit):
            return self.number
        return self.number * _factor(self.unit, unit, self.text)


def quantity(given: str | float | int) -> Quantity:
    """A number with or without a unit: `"126.1 km"`, `"-14.4deg"`, `"0.9"`.

    Raises `ValueError` that names the text and examples of known units.
    """
    if not isinstance(given, str):
        return Quantity(float(given), "", f"{float(given):g}")
    text = given.strip()
    try:
        return Quantity(float(text), "", text)
    except ValueError:
        pass
    found = _QUANTITY.fullmatch(text)
    if found is None or not _UNIT.fullmatch(_spelled(found[2])):
        raise UnknownUnit(
            f"{given!r} is not a number: write it in SI units, or with a unit such as "
            f"{_SUCH_AS}"
        )
    return Quantity(float(found[1]), found[2], text)


def parse_quantity(text: str, unit: str) -> float:
    """SI value of a number with an optional unit; see `Quantity.si`.

    parse_quantity("126.1 km", "m")
    """
    return quantity(text).si(unit)


_SUCH_AS = "m, km, ft, nmi, m/s, km/s, s, min, kg, lb, Pa, kPa, K, deg, rad, %"

_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\D.{0,59})")

_SIGNS = {"%": " percent ", "°": "deg", "·": "*", "^": "**", "²": "2", "³": "3"}
_SIGNS |= {"\N{MICRO SIGN}": "u", "\N{GREEK SMALL LETTER MU}": "u"}

# Names to a power, joined by products, quotients or brackets. Anything else that pint may
# accept, such as a power of a power, is not a unit.
_UNIT = re.compile(r"(?:[A-Za-z]+(?:\*\*-?\d(?:\.\d)?)?|1(?= */)|[ */()])+")


def _spelled(unit: str) -> str:
    """A unit in the notation of pint: `m/s2` becomes `m/s**2`."""
    for sign, word in _SIGNS.items():
        unit = unit.replace(sign, word)
    return re.sub(r"(?<=[A-Za-z])(?=-?\d)", "**", unit).strip()


@functools.cache
def _registry() -> Any:
    """Units of entry flight with all prefixes, as a registry of pint.

    Importing pint takes a while. Pint's own list is not used: an angle is a plain number
    there, so that degrees would be accepted as a factor.
    """
    import pint

    registry = pint.UnitRegistry(None)  # pyright: ignore[reportArgumentType]
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


def _factor(given: str, unit: str, text: str) -> float:
    """Size of a given unit in an SI unit."""
    registry = _registry()
    wanted = registry.parse_units(_spelled("" if unit == "1" else unit))
    try:
        one = registry.parse_expression(_spelled(given))
        # A unit that cancels, such as m/m, leaves a plain number.
        one = registry.Quantity(one) if isinstance(one, int | float) else one
        dimension = one.dimensionality
    except Exception as error:  # a parser may raise anything
        raise UnknownUnit(
            f"{text!r} has a unit that is not known, {given!r}: take one such as "
            f"{_SUCH_AS}"
        ) from error
    if dimension != wanted.dimensionality:
        here = "a plain number" if unit == "1" else f"a number in {unit}"
        raise ValueError(
            f"{text!r} is {_kind(dimension)}; expected {here}, "
            f"{_kind(wanted.dimensionality)}"
        )
    return float(one.to(wanted).magnitude)


def _kind(dimension: Any) -> str:
    """Text for a dimension: `[length] / [time]`."""
    return str(dimension) if dimension else "without a dimension"


_EDGE = {"m": ("km", km), "rad": ("deg", degree), "Pa": ("kPa", 1e3)}
_EDGE |= {"W/m2": ("W/cm2", 1e4), "J/m2": ("J/cm2", 1e4)}

_SHORT = 10.0
"""Length in m; if all lengths are below it, they are shown in metres"""


def edge_unit(unit: str, values: Any, named: str | None = None) -> tuple[str, float]:
    """The usual unit for values in an SI unit, and its size in SI.

    Tables, figures and printed objects show all numbers in it. Values that are shown
    together share one unit; values that are not finite are ignored. `named` is another name
    of the unit, such as g, if there is one: the numbers then do not change.
    """
    if named is not None:
        return named, 1.0
    sizes = np.abs(np.asarray(values, dtype=float))
    if unit == "m" and np.all(sizes[np.isfinite(sizes)] < _SHORT):
        return unit, 1.0
    return _EDGE.get(unit, (unit, 1.0))


def at_edge(values: Any, unit: str, named: str | None = None) -> tuple[Any, str]:
    """Values in their usual unit, and that unit: see `edge_unit`."""
    shown, size = edge_unit(unit, values, named)
    return np.asarray(values) / size, shown


_USUAL = {
    "m": {"km": km},
    "m/s": {"km/s": km},
    "kg": {"t": 1e3},
    "rad": {"deg": degree},
    "rad/s": {"deg/s": degree},
    "Pa": {"kPa": 1e3},
    "W/m2": {"kW/m2": 1e3, "W/cm2": 1e4, "MW/m2": 1e6},
    "J/m2": {"kJ/m2": 1e3, "J/cm2": 1e4, "MJ/m2": 1e6},
    "J/(kg K)": {"kJ/(kg K)": 1e3},
    "m3/s2": {"km3/s2": km**3},
}
"""Units in which people state numbers, and their sizes, by the SI unit"""

_LIKE = 5.0
"""Ratio of two numbers up to which they are of one size. Every unit in `_USUAL` is larger
than its square, in SI, so that a number of this size in SI is not so in another unit"""


_ANGLES = "rad", "rad/s"

_LEAST_ANGLE, _LEAST_DEGREES = 0.01, 0.25
"""Smallest angle that has a size, rad, and smallest number that was meant in degrees: an
angle of nearly zero may become any other, and misalignments are small in both units"""


def forgotten_unit(value: float, present: float, unit: str) -> str:
    """Unit that was probably meant for a number that was given without one; else empty.

    It is a usual unit in which the number is of the size of the one that it replaces, which
    it is not in SI: 5.8 in place of 11 069 m/s was meant in km/s. Zeros, angles of less
    than 0.01 rad, and numbers that are not finite, are of no size.

    **Arguments:**

    - `value`: the number, in the SI unit.
    - `present`: the number that it replaces, in the SI unit.
    - `unit`: the SI unit.
    """
    ratio = abs(value / present) if present else 0.0
    if not 0.0 < ratio < math.inf:
        return ""
    if unit in _ANGLES and (abs(present) < _LEAST_ANGLE or abs(value) < _LEAST_DEGREES):
        return ""

    def off(name: str) -> float:
        return abs(math.log(ratio) + math.log(_USUAL[unit][name]))

    nearest = min(_USUAL.get(unit, ()), key=off, default="")
    return nearest if nearest and off(nearest) <= math.log(_LIKE) else ""


_DEFINITIONS = """
quecto- = 1e-30 = q-
ronto- = 1e-27 = r-
yocto- = 1e-24 = y-
zepto- = 1e-21 = z-
atto- = 1e-18 = a-
femto- = 1e-15 = f-
pico- = 1e-12 = p-
nano- = 1e-9 = n-
micro- = 1e-6 = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
deci- = 1e-1 = d-
deca- = 1e1 = da-
hecto- = 1e2 = h-
kilo- = 1e3 = k-
mega- = 1e6 = M-
giga- = 1e9 = G-
tera- = 1e12 = T-
peta- = 1e15 = P-
exa- = 1e18 = E-
zetta- = 1e21 = Z-
yotta- = 1e24 = Y-
ronna- = 1e27 = R-
quetta- = 1e30 = Q-
meter = [length] = m = metre
second = [time] = s = sec
gram = [mass] = g
kelvin = [temperature] = K
radian = [angle] = rad
percent = 0.01
ppm = 1e-6
degree = 0.017453292519943295 * radian = deg
arcminute = degree / 60 = arcmin
arcsecond = degree / 3600 = arcsec
turn = 6.283185307179586 * radian = rev = revolution
minute = 60 * second = min
hour = 3600 * second = h = hr
day = 86400 * second = d
hertz = 1 / second = Hz
inch = 0.0254 * meter = in
foot = 0.3048 * meter = ft = feet
yard = 0.9144 * meter = yd
mile = 1609.344 * meter = mi
nautical_mile = 1852 * meter = nmi = NM
knot = 1852 * meter / hour = kn
tonne = 1e6 * gram = t
pound = 453.59237 * gram = lb
slug = 14593.902937206364 * gram
newton = 1000 * gram * meter / second ** 2 = N
standard_gravity = 9.80665 * meter / second ** 2 = gee
pound_force = 0.45359237 * 9.80665 * newton = lbf
pascal = newton / meter ** 2 = Pa
bar = 1e5 * pascal
atmosphere = 101325 * pascal = atm
psf = pound_force / foot ** 2
psi = pound_force / inch ** 2
joule = newton * meter = J
watt = joule / second = W
british_thermal_unit = 1055.05585262 * joule = Btu = BTU
rankine = kelvin * 5 / 9 = degR
"""
"""Units, exact by definition. Exceptions are the slug, which is rounded, and the British
thermal unit, which is that of the International Table."""
