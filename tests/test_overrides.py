"""Values that a user sets reach the scenario, in their units, or are refused."""

import cheap
import numpy as np
import pytest
from helpers import mars_scenario
from override_files import read, uniform

from jentry.cli.overrides import apply_values, read_overrides
from jentry.missions.choice import Choice
from jentry.units import degree


def test_nothing_given_changes_nothing():
    overrides = read_overrides(None)
    assert overrides.choice == Choice()
    assert overrides.base is overrides.dispersions is None
    assert overrides.values == {}


def test_both_spellings_of_an_address_and_units(written):
    path = written(
        """
        law = "steep"
        dispersions = "mass-only"
        [set]
        "initial_state.flight_path_angle" = "-14.2 deg"
        vehicle.mass = 900
        [set.planet]
        density_scale = 1.1
        atmosphere.scale_height = "9 km"
        """
    )
    overrides = read(path)
    assert (overrides.choice.law, overrides.base) == ("steep", "mass-only")
    assert overrides.values == {
        "initial_state.flight_path_angle": -14.2 * degree,
        "vehicle.mass": 900.0,
        "planet.density_scale": 1.1,
        "planet.atmosphere.scale_height": 9000.0,
    }


def test_assignments_come_last(written):
    path = written("[set]\nvehicle.mass = 900\nplanet.density_scale = 1.1")
    given = ["vehicle.mass=950", " initial_state.velocity = 6.7 km/s"]
    assert read(path, given).values == {
        "vehicle.mass": 950.0,
        "planet.density_scale": 1.1,
        "initial_state.velocity": 6700.0,
    }


def test_values_reach_the_scenario():
    changed = apply_values(cheap.scenario(), {"vehicle.mass": 900.0})
    assert changed.vehicle.mass == 900.0
    with pytest.raises(ValueError, match="nearest: vehicle.mass"):
        apply_values(cheap.scenario(), {"vehicle.mas": 1.0})
    with pytest.raises(ValueError, match=r"table of shape \(2,\)"):
        apply_values(mars_scenario(), {"guidance.cos_bank.coefficients": 0.5})


WRONG = {
    "no TOML": ("law = ", "file.txt is no valid TOML"),
    "no text": (b"\xff\xfe\x00", "file.txt is no valid TOML"),
    "unknown key": ('lwa = "a"', "unknown key 'lwa'; nearest: law"),
    "law no name": ("law = 3", "law is 3: it must be a name"),
    "dispersions no name": ("dispersions = 3", "dispersions is 3: it must be a name"),
    "set no table": ("set = 3", r"set is 3: write a table, \[set\]"),
    "set a word": ('[set]\na.b = "much"', "set.a.b: 'much' is not a number"),
    "set a flag": ("[set]\na.b = true", "set.a.b is True: it must be a number"),
    "set a ragged list": ("[set]\na.b = [[1, 2], 3]", "set.a.b has rows of unequal"),
    "dispersion no table": (
        "[dispersions]\nx = 3",
        r"write a table, \[dispersions.x\]",
    ),
    "distribution unknown": (
        uniform(distribution='"unifrom"'),
        "dispersions.x.distribution is 'unifrom': choose from normal, uniform",
    ),
    "distribution missing": (uniform(distribution=None), "distribution is None"),
    "distribution a list": (uniform(distribution="[1]"), r"distribution is \[1\]"),
    "parameter unknown": (
        uniform(uper=2),
        r"unknown key 'uper' in \[dispersions.x\]; nearest: upper",
    ),
    "parameter missing": (uniform(upper=None), r"\[dispersions.x\] lacks upper"),
    "parameter a word": (uniform(upper='"a"'), "dispersions.x.upper: 'a' is not a num"),
    "address missing": (uniform(address=None), r"\[dispersions.x\] lacks address"),
    "address a number": (uniform(address=3), "dispersions.x.address is 3"),
    "address of numbers": (uniform(address="[3]"), r"dispersions.x.address is \[3\]"),
    "apply unknown": (uniform(apply='"plus"'), "apply is 'plus': choose from replace"),
    "set twice": (
        '[set]\nvehicle.mass = 1\n"vehicle.mass" = 2',
        "set.vehicle.mass is given twice",
    ),
    "law a table": ("[law]\na = 1", "law is {'a': 1}: it must be a name"),
    "replace no flag": (
        "[dispersions]\nreplace = 1",
        "dispersions.replace is 1: it must",
    ),
    "base no name": (
        "[dispersions]\nbase = 1",
        r"`base` of \[dispersions\] is 1: it must",
    ),
    "replace and base": (
        '[dispersions]\nreplace = true\nbase = "a"\n' + uniform(),
        r"`base` of \[dispersions\] is 'a', and `replace` leaves out",
    ),
    "replaced by nothing": (
        "[dispersions]\nreplace = true",
        r"\[dispersions\] is empty",
    ),
    "no dispersions": ("[dispersions]", r"\[dispersions\] is empty"),
    "no addresses": (uniform(address="[]"), r"address is \[\]: write one"),
    "too deep": ("set = " + "[" * 5000, "nested too deep"),
    "deep in dots": ("set." + ".".join("a" * 5000) + " = 1", "nested too deep"),
    "a number too long": ("set.a = " + "9" * 5000, "no valid TOML"),
    "a number too large": ("set.a = 1" + "0" * 400, "set.a: .*too large"),
    "apply a list": (uniform(apply="[]"), r"apply is \[\]: choose from replace"),
}


@pytest.mark.parametrize(("contents", "message"), WRONG.values(), ids=WRONG)
def test_what_is_not_understood_is_refused(written, contents, message):
    with pytest.raises(ValueError, match=message):
        read_overrides(written(contents))


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("vehicle.mass", "--set 'vehicle.mass': write ADDRESS=VALUE"),
        ("vehicle.mass=", "--set vehicle.mass: '' is not a number"),
        ("vehicle.mass=heavy", "--set vehicle.mass: 'heavy' is not a number"),
    ],
)
def test_assignments_that_are_not_understood_are_refused(assignment, message):
    with pytest.raises(ValueError, match=message):
        read_overrides(None, [assignment])


def test_lists_are_tables_of_numbers_with_units(written):
    path = written(
        """
        [set]
        guidance.cos_bank.coefficients = [1, "2 %"]
        initial_state.altitude = ["2 km", -3.5]
        """
    )
    assert read(path, scenario=mars_scenario()).values == {
        "guidance.cos_bank.coefficients": [1.0, 0.02],
        "initial_state.altitude": [2000.0, -3.5],
    }


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[1, [2]]", "set.a.b has rows of unequal length"),
        ("[[1, 2], [3]]", "set.a.b has rows of unequal length"),
        ("[[1, [2]], 3]", r"set.a.b\[0\] has rows of unequal length"),
        ("[1, true]", r"set.a.b\[1\] is True: it must be a number"),
        ('[[1, 2], [3, "much"]]', r"set.a.b\[1\]\[1\]: 'much' is not a number"),
    ],
)
def test_lists_that_are_no_tables_are_refused(written, value, message):
    with pytest.raises(ValueError, match=message):
        read_overrides(written(f"[set]\na.b = {value}"))


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        ("cos_bank.coefficients", [1.0, 2.0, 3.0], r"\(2,\) .* a list of shape \(3,\)"),
        ("cos_bank.coefficients", [[1.0], [2.0]], r"\(2,\) .* of shape \(2, 1\)"),
        ("cos_bank.coefficients", [], r"\(2,\) .* of shape \(0,\)"),
        ("cos_bank.coefficients", 0.5, r"table of shape \(2,\): .* one number"),
        ("cos_bank.origin", [0.1], r"shape \(\) .* a list of shape \(1,\)"),
    ],
)
def test_a_list_of_wrong_shape_is_refused(address, value, message):
    with pytest.raises(ValueError, match=f"guidance.{address} .*{message}"):
        apply_values(mars_scenario(), {f"guidance.{address}": value})


def test_a_list_reaches_the_scenario():
    address = "guidance.cos_bank.coefficients"
    changed = apply_values(mars_scenario(), {address: [0.5, 0.25]})
    np.testing.assert_array_equal(changed.guidance.cos_bank.coefficients, [0.5, 0.25])


UNITS = {
    "a length for a mass": ("vehicle.mass=900km", r"vehicle.mass: '900km' is \[length"),
    "an angle for a length": ("initial_state.altitude=126deg", r"is \[angle\]"),
    "an angle for a factor": ("planet.density_scale=1deg", "a plain number"),
    "degrees forgotten": (
        "initial_state.flight_path_angle=-14.2",
        "initial_state.flight_path_angle: -14.2 rad is .*did you mean -14.2deg",
    ),
    "of a law": ("guidance.bank_angle=50", "did you mean 50deg"),
}


@pytest.mark.parametrize(("assignment", "message"), UNITS.values(), ids=UNITS)
def test_units_are_checked_against_the_leaf(written, assignment, message):
    with pytest.raises(ValueError, match=message):
        read(None, [assignment])
    address, _, value = assignment.partition("=")
    with pytest.raises(ValueError, match=message):
        read(written(f'[set]\n{address} = "{value}"'))


def test_plain_numbers_of_a_file_too(written):
    path = written("[set]\ninitial_state.flight_path_angle = -14.2")
    with pytest.raises(ValueError, match="did you mean -14.2deg"):
        read(path)
