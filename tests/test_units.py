"""Quantities at the edge are read as SI values of what they are given for."""

import math
import subprocess
import sys
import tokenize
from pathlib import Path

import pint
import pytest

import jentry
from jentry.units import degree, parse_quantity, quantity


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0.9", "1", 0.9),
        (" -3 ", "m", -3.0),
        ("1e-3", "rad", 1e-3),
        ("126.1 km", "m", 126_100.0),
        ("126.1km", "m", 126_100.0),
        ("-14.4deg", "rad", math.radians(-14.4)),
        ("+14.4 deg", "rad", math.radians(14.4)),
        ("720 deg", "rad", 4.0 * math.pi),
        ("20 °", "rad", math.radians(20.0)),
        ("0.5 rad", "rad", 0.5),
        ("6.75 km/s", "m/s", 6750.0),
        ("7 m/s", "m/s", 7.0),
        ("25000 ft/s", "m/s", 7620.0),
        ("36 km/h", "m/s", 10.0),
        ("1000 ft", "m", 304.8),
        ("10 nmi", "m", 18_520.0),
        ("3 min", "s", 180.0),
        ("2 h", "s", 7200.0),
        ("10 s", "s", 10.0),
        ("1e3m", "m", 1000.0),
        ("5000 lb", "kg", 2267.96185),
        ("100 slug", "kg", 1459.3902937206364),
        ("900000 g", "kg", 900.0),
        ("95 %", "1", 0.95),
        ("200 ppm", "1", 2e-4),
        ("3 m/m", "1", 3.0),
        ("4 deg/s", "rad/s", math.radians(4.0)),
        ("2 1/deg", "1/rad", 2.0 * 180.0 / math.pi),
        ("1 W/cm2", "W/m2", 1e4),
        ("1 W/cm²", "W/m2", 1e4),
        ("50 µm", "m", 50e-6),
        ("50 µgee", "m/s2", 50e-6 * 9.80665),
        ("0.287 kJ/(kg K)", "J/(kg K)", 287.0),
        ("2 g^0.5/cm", "kg^0.5/m", 2.0 * math.sqrt(1e-3) * 100.0),
        ("3 s2/km", "s2/m", 3e-3),
        ("1 psf", "Pa", 47.88025898033584),
    ],
)
def test_a_number_with_a_unit_is_its_si_value(text, unit, value):
    # The factor and the product each round once or twice.
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-15)


def test_degrees_and_kilometres_are_those_of_the_missions():
    """To the last bit: the same flight, whoever writes it."""
    assert parse_quantity("-14.2deg", "rad") == -14.2 * degree
    assert parse_quantity("126.1 km", "m") == 126.1 * 1000.0


NAMES = {
    "m": "m mm cm km Mm um nm pm in ft yd mi nmi meter metre kilometer feet miles",
    "s": "s ms us ks min h hr d minute hours days",
    "kg": "kg g mg t lb slug tonne pound Mg",
    "K": "K mK kelvin degR",
    "Pa": "Pa hPa kPa MPa GPa bar mbar atm psi pascal",
    "J": "J kJ MJ",
    "W": "W kW MW mW",
    "N": "N kN lbf",
    "Hz": "Hz kHz",
    "m/s": "km/s ft/s km/h mi/h kn",
    "W/m2": "W/cm2 kW/m2 MW/m2 W/ft2",
    "kg/m3": "g/cm3 lb/ft3 slug/ft3 kg/km3",
    "m3/s2": "km3/s2 ft3/s2",
}


@pytest.fixture(scope="module")
def standard():
    """The units as pint lists them, which is where ours are judged."""
    return pint.UnitRegistry()


@pytest.mark.parametrize("unit", NAMES)
def test_factors_are_those_of_the_standard_list(unit, standard):
    powers = str.maketrans({"2": "**2", "3": "**3"})
    for name in NAMES[unit].split():
        expected = standard.Quantity(1.0, standard.parse_units(name.translate(powers)))
        expected = expected.to(standard.parse_units(unit.translate(powers))).magnitude
        # A knot there is a nautical mile an hour, a slug one to twelve digits.
        assert parse_quantity(f"1 {name}", unit) == pytest.approx(expected, rel=1e-12)


def test_every_unit_of_every_field_is_understood():
    """As they stand in the package: a number in the unit of a field is that number."""
    units = set()
    for path in Path(jentry.__file__).parent.rglob("*.py"):
        with open(path, encoding="utf-8") as file:
            words = [t.string for t in tokenize.generate_tokens(file.readline)]
        units |= {
            c.strip('"')
            for a, b, c in zip(words, words[1:], words[2:], strict=False)
            if (a, b) == ("unit", "=") and c[0] == '"'
        }
    assert len(units) > 15 and {"m", "rad", "J/(kg K)", "kg^0.5/m"} <= units
    for unit in units - {"1", ""}:
        # Another spelling, so that pint reads both.
        assert parse_quantity(f"2.5 ({unit})", unit) == 2.5


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("900km", "kg", r"'900km' is \[length\].* a number in kg, \[mass\]"),
        ("126deg", "m", r"\[angle\].* a number in m, \[length\]"),
        ("1deg", "1", r"\[angle\].* a plain number, without a dimension"),
        ("1rad", "1", r"\[angle\]"),
        ("5 %", "m", "without a dimension.* a number in m"),
        ("5 %", "rad", "without a dimension.* a number in rad"),
        ("1 m", "m/s", r"\[length\].*m/s"),
        ("1 m/s", "m", r"\[length\] / \[time\]"),
        ("1 m2", "m", r"\[length\] \*\* 2"),
        ("3 deg deg", "rad", r"\[angle\] \*\* 2"),
        ("1 1/s", "rad/s", r"rad/s"),
        ("9 lb", "N", r"\[mass\]"),
    ],
)
def test_a_unit_of_another_dimension_is_refused(text, unit, message):
    with pytest.raises(ValueError, match=message):
        parse_quantity(text, unit)


@pytest.mark.parametrize(
    "text",
    ["12 parsec", "1 KM", "1 m**s", "1 (((m", "1 ()", "1 m/", "1 * m", "3 xkm", "1 c"],
)
def test_a_unit_that_is_not_known_is_refused(text):
    with pytest.raises(ValueError, match="not known.*km.*deg") as raised:
        parse_quantity(text, "m")
    assert repr(text) in str(raised.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "km",
        "fast",
        "1,5",
        "1 2",
        "--3",
        "1 m**9**9**9",
        "0x10",
        "1.e3.km",
        "1 m^m^9",
    ]
    + ["1 __import__('os')", "1 m;m", "1 [m]", "1 " + "m" * 100],
)
def test_what_is_no_quantity_is_refused(text):
    with pytest.raises(ValueError, match="not a number.*km.*deg|not known") as raised:
        parse_quantity(text, "m")
    assert repr(text) in str(raised.value)


@pytest.mark.parametrize("text", ["-14.2", "6.2832", "1e300", " 90 "])
def test_an_angle_beyond_a_turn_was_meant_in_degrees(text):
    with pytest.raises(ValueError, match=f"did you mean {text.strip()}deg"):
        parse_quantity(text, "rad")
    assert parse_quantity(text, "rad/s") == float(text)


@pytest.mark.parametrize("text", ["6.2831", "-6.2831", "0", "7 rad", "-400 deg"])
def test_an_angle_within_a_turn_or_with_a_unit_is_taken(text):
    assert math.isfinite(parse_quantity(text, "rad"))


def test_a_number_of_a_file_is_taken_as_it_is():
    assert quantity(0.1 + 0.2).si("m") == 0.1 + 0.2
    assert quantity(7).si("1") == 7.0


_WITHOUT_PINT = """
import sys
from jentry.units import parse_quantity
parse_quantity("3", "m"), parse_quantity("3 m", "m"), parse_quantity("0.1", "rad")
assert "pint" not in sys.modules and "jax" not in sys.modules
assert parse_quantity("3 km", "m") == 3000.0
assert "pint" in sys.modules
"""


def test_plain_numbers_do_not_wait_for_pint():
    run = subprocess.run([sys.executable, "-c", _WITHOUT_PINT], capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
