"""Factors between the units of the edge and SI: multiply in, divide out.

altitude = 125 * km
flight_path_angle = -14.2 * degree
altitude / km
"""

import math


km = 1000.0
degree = math.pi / 180.0
foot = 0.3048
nautical_mile = 1852.0
slug = 14.593902937206364
pound = 0.45359237
minute = 60.0
hour = 3600.0
micro_g = 9.80665e-6
"""m/s2"""
standard_gravity = 9.80665
"""m/s2, the g in which load factors are counted"""

by_suffix = {
    "m": 1.0,
    "km": km,
    "ft": foot,
    "nmi": nautical_mile,
    "rad": 1.0,
    "deg": degree,
    "m/s": 1.0,
    "km/s": km,
    "ft/s": foot,
    "s": 1.0,
    "min": minute,
    "h": hour,
    "kg": 1.0,
    "slug": slug,
    "lb": pound,
    "%": 0.01,
}
"""What may follow a number on the command line and in configuration files."""


def parse_quantity(text: str) -> float:
    """SI value of a number with an optional unit: `"126.1 km"`, `"-14.4deg"`, `"0.9"`.

    Raises `ValueError` that names the text and the units that are known.
    """
    stripped = text.strip()
    for suffix in sorted(by_suffix, key=len, reverse=True):
        number = stripped.removesuffix(suffix)
        if number == stripped:
            continue
        try:
            return float(number) * by_suffix[suffix]
        except ValueError:
            continue
    try:
        return float(stripped)
    except ValueError:
        raise ValueError(
            f"{text!r} is not a number: write it in SI units, or with one of "
            f"{', '.join(by_suffix)}"
        ) from None
