"""Quantities at the edge are read as SI values."""

import math

import pytest

from jentry.units import by_suffix, parse_quantity


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.9", 0.9),
        (" -3 ", -3.0),
        ("1e-3", 1e-3),
        ("126.1 km", 126_100.0),
        ("126.1km", 126_100.0),
        ("-14.4deg", math.radians(-14.4)),
        ("+14.4 deg", math.radians(14.4)),
        ("0.5 rad", 0.5),
        ("6.75 km/s", 6750.0),
        ("7 m/s", 7.0),
        ("25000 ft/s", 7620.0),
        ("1000 ft", 304.8),
        ("10 nmi", 18_520.0),
        ("3 min", 180.0),
        ("2 h", 7200.0),
        ("10 s", 10.0),
        ("1e3m", 1000.0),
        ("5000 lb", 2267.96185),
        ("100 slug", 1459.3902937206364),
        ("95 %", 0.95),
    ],
)
def test_a_number_with_a_unit_is_its_si_value(text, value):
    # The product rounds once.
    assert parse_quantity(text) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("suffix", by_suffix)
def test_every_unit_is_read(suffix):
    assert parse_quantity(f"2.5{suffix}") == 2.5 * by_suffix[suffix]
    assert parse_quantity(f"-2.5 {suffix}") == -2.5 * by_suffix[suffix]


@pytest.mark.parametrize(
    "text", ["", "km", "fast", "12 parsec", "1 km/h", "1,5", "1 2", "--3", "3 deg deg"]
)
def test_what_is_no_quantity_is_refused_with_the_units_known(text):
    with pytest.raises(ValueError, match="is not a number.*km.*deg") as raised:
        parse_quantity(text)
    assert repr(text) in str(raised.value)
