"""What a user changes of a mission is understood, or refused with the nearest names."""

import tomllib

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario

from jentry._files import write_toml
from jentry.addresses import leaves_by_address
from jentry.campaign import (
    LogNormal,
    Normal,
    TruncatedNormal,
    Uniform,
    add,
    disperse,
    multiply,
    replace,
)
from jentry.cli.overrides import (
    AtAddresses,
    apply_values,
    in_si,
    read_inputs,
    read_overrides,
)
from jentry.cli.stated_correlations import correlated
from jentry.missions.choice import Choice
from jentry.tuning.saving import with_unit
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


def read(*given, scenario=None):
    """In SI, of a scenario."""
    return in_si(read_overrides(*given), scenario or cheap.scenario())


def test_nothing_given_changes_nothing():
    overrides = read_overrides(None)
    assert overrides.choice == Choice()
    assert overrides.reading is overrides.dispersions is None
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
    assert (overrides.choice.law, overrides.reading) == ("steep", "mass-only")
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
    table = read(path).dispersions
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
    first, second = (read(written(DISPERSIONS)).dispersions for _ in range(2))
    assert first["density"].where == second["density"].where
    assert hash(AtAddresses(("a", "b"))) == hash(AtAddresses(("a", "b")))


def test_a_dispersion_of_an_unknown_address_is_refused(written):
    path = written(DISPERSIONS.replace("density_scale", "density"))
    with pytest.raises(
        ValueError, match="dispersions.density.address: .*nearest: planet.density_scale"
    ):
        read(path)


def uniform(**changes):
    entries = {"address": '"a"', "distribution": '"uniform"', "lower": 0, "upper": 1}
    lines = [f"{k} = {v}" for k, v in (entries | changes).items() if v is not None]
    return "\n".join(["[dispersions.x]", *lines])


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
    "reading no name": (
        "[dispersions]\nreading = 1",
        "dispersions.reading is 1: it must",
    ),
    "replace and reading": (
        '[dispersions]\nreplace = true\nreading = "a"\n' + uniform(),
        "dispersions.reading is 'a', and dispersions.replace leaves out",
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
        ("", "empty; expected a line"),
        ("vehicle.mass\n\n", "line 1: 0 rows"),
        ("vehicle.mass\nheavy\n", "heavy"),
        ("a,b\n1,2\n3\n", "line 3: 1 values; expected 2: a,b"),
        ("a,b\n1\n2\n", "line 2: 1 values"),
        ("a,b,a\n1,2,3\n", "column 'a' appears more than once"),
        (b"\xff\xfe\x00", "decode"),
    ],
)
def test_inputs_that_are_not_understood_are_refused(written, contents, message):
    path = written(contents)
    with pytest.raises(ValueError, match=message) as raised:
        read_inputs(path)
    assert str(path) in str(raised.value)


# Files that are written.


def write_overrides(path, comment, variant, values, dispersions):
    """As `Tuned.save` does, of numbers without a unit."""
    set_to = {address: with_unit(value, "1") for address, value in values.items()}
    contents = {"law": variant, "set": set_to, "dispersions": dispersions}
    if isinstance(dispersions, str):
        contents = {"dispersions": contents.pop("dispersions"), **contents}
    write_toml(path, comment, contents)


VALUES = {
    "a third": 1.0 / 3.0,
    "a sum": 0.1 + 0.2,
    "smallest": 5e-324,
    "largest": 1.7976931348623157e308,
    "negative zero": -0.0,
    "whole": 900.0,
    "exponent": -1e-7,
    "long": 12345678901234567.0,
}


def numbers_of(given):
    return [numbers_of(x) for x in given] if isinstance(given, list) else given.number


def same(first, second):
    """To the last bit."""
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    return first.shape == second.shape and first.tobytes() == second.tobytes()


def test_written_values_are_read_back_to_the_last_bit(tmp_path):
    path = tmp_path / "tuned.toml"
    values = {f"guidance.{name}": value for name, value in VALUES.items()}
    # Numbers as tuning has them, arrays without axes, and tables of them.
    values |= {f"array.{name}": jnp.asarray(x) for name, x in VALUES.items()}
    rng = np.random.default_rng(20261121)
    tables = {
        "table": rng.normal(size=5) * 10.0 ** rng.integers(-300, 300, 5),
        "one": np.array([1.0 / 3.0]),
        "matrix": jnp.asarray(rng.normal(size=(2, 3))),
        "deep": rng.normal(size=(2, 1, 3)),
    }
    write_overrides(path, "", "right", values | tables, "all")
    found = read_overrides(path).values
    assert list(found) == [*values, *tables]
    for address, value in (values | tables).items():
        assert same(numbers_of(found[address]), value)


def test_a_written_scenario_is_the_same_to_the_last_bit(tmp_path):
    """All of its leaves, of which one is a table."""
    path = tmp_path / "tuned.toml"
    leaves = leaves_by_address(mars_scenario())
    moved = {a: np.asarray(x) * (1.0 + 1.0 / 3.0) + 0.1 for a, x in leaves.items()}
    write_overrides(path, "All of it", "right", moved, "all")
    values = {a: numbers_of(x) for a, x in read_overrides(path).values.items()}
    changed = apply_values(mars_scenario(), values)
    found = leaves_by_address(changed)
    assert moved["guidance.cos_bank.coefficients"].shape == (2,)
    assert all(same(found[address], value) for address, value in moved.items())


def test_a_written_file_names_variant_and_dispersions(tmp_path):
    path = tmp_path / "tuned.toml"
    write_overrides(path, "Two\n[lines]", 'the "right" one', {}, "mass-only")
    overrides = read_overrides(path)
    assert overrides.choice.law == 'the "right" one'
    assert overrides.reading == "mass-only"
    assert overrides.dispersions is None and overrides.values == {}
    assert path.read_text().startswith("# Two\n# [lines]\n")


def test_a_reading_that_is_changed_and_dispersions_of_these_names(written):
    path = written('[dispersions]\nreading = "mass-only"\n' + DISPERSIONS)
    overrides = read(path)
    assert (overrides.reading, overrides.replaces) == ("mass-only", False)
    assert set(overrides.dispersions) == {"density", "coefficients", "path"}
    assert overrides.written_with("all")["reading"] == "all"
    path = written(uniform(address='"vehicle.mass"').replace("s.x]", "s.replace]"))
    overrides = read(path)
    assert set(overrides.dispersions) == {"replace"} and not overrides.replaces
    path = written("[dispersions]\nreplace = true\n" + DISPERSIONS)
    assert read(path).replaces and "reading" not in read(path).written_with("all")
    path = written('[dispersions]\nreading = "mass-only"')
    assert (read(path).reading, read(path).dispersions) == ("mass-only", None)
    assert read(path).written_with("all") == "all"


AWKWARD = """
[dispersions]
replace = true

[dispersions."density, \\"Mars\\" (3.5 ρ)"]
address = "planet.density_scale"
distribution = "uniform"
lower = 0.30000000000000004
upper = 1e16
"""


@pytest.mark.parametrize("contents", [DISPERSIONS, AWKWARD], ids=["units", "names"])
def test_a_written_table_of_dispersions_is_the_same(written, tmp_path, contents):
    """With the units and the names that the first file had."""
    first = read(written(contents))
    path = tmp_path / "tuned.toml"
    values = {"vehicle.mass": 900.0}
    write_overrides(path, "Again", "right", values, first.written)
    again = read(path)
    assert again.reading is None
    assert again.values == values
    assert again.written == first.written == tomllib.loads(contents)["dispersions"]
    assert list(again.dispersions) == list(first.dispersions)
    for name, dispersion in first.dispersions.items():
        assert again.dispersions[name].where == dispersion.where
        assert again.dispersions[name].apply is dispersion.apply
        numbers = leaves_by_address(dispersion.distribution)
        found = leaves_by_address(again.dispersions[name].distribution)
        assert type(again.dispersions[name].distribution) is type(
            dispersion.distribution
        )
        assert found == numbers


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


MOVED = """
[dispersions.x]
address = ["initial_state.altitude", "{other}"]
distribution = "normal"
mean = {mean}
standard_deviation = {width}
apply = "{apply}"
"""


def moved(**given):
    given = {"other": "termination.conditions.ground.altitude", "apply": "add"} | given
    return MOVED.format(**given)


def test_a_dispersion_is_in_units_of_its_leaves_or_without_one(written):
    table = read(written(moved(mean='"-1 km"', width='"2 ft"'))).dispersions
    assert table["x"].distribution.mean == -1000.0
    assert table["x"].distribution.standard_deviation == 2 * 0.3048
    factor = moved(mean='"100 %"', width=0.1, apply="multiply", other="vehicle.mass")
    table = read(written(factor)).dispersions
    assert table["x"].distribution.mean == 1.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mean": '"1 kg"', "width": 1}, "dispersions.x.mean: '1 kg' is"),
        ({"mean": 0, "width": '"1 deg"'}, "dispersions.x.standard_deviation: '1 deg'"),
        ({"mean": '"1 m"', "width": 1, "apply": "multiply"}, "a plain number"),
        ({"mean": 0, "width": 1, "other": "vehicle.mass"}, r"vehicle.mass \(kg\)"),
    ],
)
def test_another_unit_of_a_dispersion_is_refused(written, given, message):
    with pytest.raises(ValueError, match=message):
        read(written(moved(**given)))


def test_an_angle_of_a_dispersion_beyond_a_turn_was_meant_in_degrees(written):
    entry = uniform(address='"initial_state.heading"', lower=88, upper=92)
    with pytest.raises(ValueError, match="x.lower: 88 rad .*did you mean 88deg"):
        read(written(entry))


# Distributions of a file that have lists, and correlations.

MORE = """
[dispersions.density]
address = "planet.density_scale"
distribution = "lognormal"
median = 1.0
deviation_of_logarithm = 0.2

[dispersions.path]
address = "initial_state.flight_path_angle"
distribution = "discrete"
values = ["-14.5 deg", "-14 deg"]
probabilities = [0.25, 0.75]

[dispersions.velocity]
address = "initial_state.velocity"
distribution = "discrete"
values = ["6.7 km/s", 6750]

[dispersions.lift]
address = "vehicle.lift_scale"
distribution = "normal"
mean = 1.0
standard_deviation = 0.1

[dispersions.drag]
address = "vehicle.drag_scale"
distribution = "normal"
mean = 1.0
standard_deviation = 0.05
correlation = { lift = 0.8, mass = -0.2 }

[dispersions.mass]
address = "vehicle.mass"
distribution = "normal"
mean = 950
standard_deviation = 10
"""


def test_lognormal_and_discrete_distributions_of_a_file(written):
    table = read(written(MORE)).dispersions
    assert table["density"].distribution.moments() == LogNormal(1.0, 0.2).moments()
    path, velocity = table["path"].distribution, table["velocity"].distribution
    np.testing.assert_array_equal(path.values, [-14.5 * degree, -14.0 * degree])
    np.testing.assert_array_equal(path.probabilities, [0.25, 0.75])
    np.testing.assert_array_equal(velocity.values, [6700.0, 6750.0])
    np.testing.assert_array_equal(velocity.probabilities, [0.5, 0.5])


def test_correlations_of_a_file(written):
    overrides = read(written(MORE))
    table = correlated(overrides.dispersions, overrides.correlations)
    assert list(table) == list(overrides.dispersions)
    assert table["path"] is overrides.dispersions["path"]
    names = "lift", "drag", "mass"
    rows = np.stack([table[name].distribution.weights for name in names])
    # What is not said of lift and mass is zero.
    expected = [[1.0, 0.8, 0.0], [0.8, 1.0, -0.2], [0.0, -0.2, 1.0]]
    np.testing.assert_allclose(rows @ rows.T, expected, atol=1e-15)
    assert {table[name].stream for name in names} == {"lift and drag and mass"}


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (
            'values = ["6.7 km/s", 6750]',
            "values = 6750",
            "velocity.values is 6750: write",
        ),
        ("[0.25, 0.75]", "[0.25, 0.8]", "dispersions.path: the probabilities .* 1.05"),
        ('values = ["-14.5 deg", "-14 deg"]', "", r"\[dispersions.path\] lacks values"),
        ("[0.25, 0.75]", '["0.25 m", 0.75]', r"path.probabilities\[0\]"),
        (
            "lift = 0.8",
            "lft = 0.8",
            "drag.correlation: no dispersion 'lft'; nearest: lift",
        ),
        (
            "lift = 0.8",
            "lift = 1.8",
            "drag.correlation.lift is 1.8: it must be between",
        ),
        ("lift = 0.8", "drag = 0.8", "it is that of drag with itself, which is 1"),
        ("lift = 0.8", "path = 0.8", "dispersion 'path' is Discrete"),
        ("lift = 0.8", "lift = 0.99, mass2 = 1", "correlation.mass2 is 1"),
        ("mass = -0.2", "mass = -0.7", "not positive definite"),
        ("{ lift = 0.8, mass = -0.2 }", "0.8", "drag.correlation is 0.8: write"),
        ("median = 1.0", "median = 1.0\ncorrelation = {}", "unknown key 'correlation'"),
        (
            "mean = 950",
            "mean = 950\ncorrelation = { drag = 0.2 }",
            "mass.correlation.drag is 0.2, and dispersions.drag.correlation.mass -0.2",
        ),
    ],
    ids=str,
)
def test_what_is_no_distribution_or_correlation_is_refused(
    written, before, after, message
):
    assert before in MORE
    with pytest.raises(ValueError, match=message):
        overrides = read(written(MORE.replace(before, after)))
        correlated(overrides.dispersions, overrides.correlations)


def test_a_written_table_with_lists_and_correlations_is_the_same(written, tmp_path):
    first = read(written(MORE))
    path = tmp_path / "tuned.toml"
    write_overrides(path, "Again", "right", {}, first.written)
    again = read(path)
    assert again.correlations == first.correlations
    for name, dispersion in first.dispersions.items():
        numbers = leaves_by_address(dispersion.distribution)
        found = leaves_by_address(again.dispersions[name].distribution)
        assert jax.tree.all(jax.tree.map(np.array_equal, found, numbers))
