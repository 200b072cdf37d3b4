"""What a user changes of a mission is understood, or refused with the nearest names."""

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario

from jentry.campaign import (
    Normal,
    TruncatedNormal,
    Uniform,
    add,
    disperse,
    multiply,
    replace,
)
from jentry.overrides import (
    AtAddresses,
    apply_values,
    read_inputs,
    read_overrides,
    require_addresses,
)
from jentry.units import degree


@pytest.fixture
def written(tmp_path):
    """Writes a file and tells where."""

    def write(contents):
        path = tmp_path / "file.txt"
        if isinstance(contents, str):
            contents = contents.encode()
        path.write_bytes(contents)
        return path

    return write


def test_nothing_given_changes_nothing():
    overrides = read_overrides(None)
    assert (overrides.variant, overrides.reading, overrides.dispersions) == (None,) * 3
    assert overrides.values == {}


def test_both_spellings_of_an_address_and_units(written):
    path = written(
        """
        variant = "steep"
        dispersions = "mass-only"
        [set]
        "initial_state.flight_path_angle" = "-14.2 deg"
        vehicle.mass = 900
        [set.planet]
        density_scale = 1.1
        atmosphere.scale_height = "9 km"
        """
    )
    overrides = read_overrides(path)
    assert (overrides.variant, overrides.reading) == ("steep", "mass-only")
    assert overrides.values == {
        "initial_state.flight_path_angle": -14.2 * degree,
        "vehicle.mass": 900.0,
        "planet.density_scale": 1.1,
        "planet.atmosphere.scale_height": 9000.0,
    }


def test_assignments_come_last(written):
    path = written("[set]\nvehicle.mass = 900\nplanet.density_scale = 1.1")
    given = ["vehicle.mass=950", " initial_state.velocity = 6.7 km/s"]
    assert read_overrides(path, given).values == {
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


DISPERSIONS = """
[dispersions.density]
address = "planet.density_scale"
distribution = "uniform"
lower = 0.7
upper = "130 %"

[dispersions.coefficients]
address = ["vehicle.lift_scale", "vehicle.drag_scale"]
distribution = "truncated_normal"
mean = 1
standard_deviation = 0.1
lower = 0.8
upper = 1.2
apply = "multiply"

[dispersions.path]
address = "initial_state.flight_path_angle"
distribution = "normal"
mean = 0
standard_deviation = "0.1 deg"
apply = "add"
"""


def test_a_table_of_dispersions(written):
    path = written(DISPERSIONS)
    table = read_overrides(path).dispersions
    require_addresses(cheap.scenario(), table)
    kinds = {name: type(d.distribution) for name, d in table.items()}
    assert kinds == {
        "density": Uniform,
        "coefficients": TruncatedNormal,
        "path": Normal,
    }
    assert [d.apply for d in table.values()] == [replace, multiply, add]
    assert table["density"].distribution.upper == 1.3
    assert table["path"].distribution.standard_deviation == 0.1 * degree
    moved = disperse(cheap.scenario(), table, dict.fromkeys(table, jnp.asarray(0.9)))
    assert set(moved) == {
        "planet.density_scale",
        "vehicle.lift_scale",
        "vehicle.drag_scale",
        "initial_state.flight_path_angle",
    }
    assert moved["vehicle.drag_scale"] == 0.9


def test_equal_addresses_are_equal_lenses(written):
    """So that the same file is not compiled twice."""
    first, second = (read_overrides(written(DISPERSIONS)).dispersions for _ in range(2))
    assert first["density"].where == second["density"].where
    assert hash(AtAddresses(("a", "b"))) == hash(AtAddresses(("a", "b")))


def test_a_dispersion_of_an_unknown_address_is_refused(written):
    table = read_overrides(
        written(DISPERSIONS.replace("density_scale", "density"))
    ).dispersions
    with pytest.raises(
        ValueError, match="dispersions.density.address: .*nearest: planet.density_scale"
    ):
        require_addresses(cheap.scenario(), table)


def uniform(**changes):
    entries = {"address": '"a"', "distribution": '"uniform"', "lower": 0, "upper": 1}
    lines = [f"{k} = {v}" for k, v in (entries | changes).items() if v is not None]
    return "\n".join(["[dispersions.x]", *lines])


WRONG = {
    "no TOML": ("variant = ", "file.txt is no valid TOML"),
    "no text": (b"\xff\xfe\x00", "file.txt is no valid TOML"),
    "unknown key": ('varaint = "a"', "unknown key 'varaint'; nearest: variant"),
    "variant no name": ("variant = 3", "variant is 3: it must be a name"),
    "dispersions no name": ("dispersions = 3", "dispersions is 3: it must be a name"),
    "set no table": ("set = 3", r"set is 3: write a table, \[set\]"),
    "set a word": ('[set]\na.b = "much"', "set.a.b: 'much' is not a number"),
    "set a flag": ("[set]\na.b = true", "set.a.b is True: it must be a number"),
    "set a list": ("[set]\na.b = [1, 2]", r"set.a.b is \[1, 2\]: it must be a number"),
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


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "of a spreadsheet"])
def test_inputs_are_columns_of_numbers(written, mark):
    path = written(f"{mark}vehicle.mass, planet.density_scale\n900,1.1\r\n\n950, 0.9\n")
    given = read_inputs(path)
    assert list(given) == ["vehicle.mass", "planet.density_scale"]
    assert np.array_equal(given["vehicle.mass"], [900.0, 950.0])
    assert np.array_equal(given["planet.density_scale"], [1.1, 0.9])


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        ("", "no rows"),
        ("vehicle.mass\n\n", "no rows"),
        ("vehicle.mass\nheavy\n", "heavy"),
        ("a,b\n1,2\n3\n", "columns"),
        ("a,b\n1\n2\n", "2 addresses in its first line and 1 columns"),
        ("a,b,a\n1,2,3\n", "has a twice"),
        (b"\xff\xfe\x00", "decode"),
    ],
)
def test_inputs_that_are_not_understood_are_refused(written, contents, message):
    path = written(contents)
    with pytest.raises(ValueError, match=message) as raised:
        read_inputs(path)
    assert str(path) in str(raised.value)
