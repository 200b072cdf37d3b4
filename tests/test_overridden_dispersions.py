"""Dispersions and correlations of a configuration file."""

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
from override_files import DISPERSIONS, MORE, read, uniform

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
from jentry.cli.overrides import AtAddresses
from jentry.cli.stated_correlations import correlated
from jentry.units import degree


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


def test_a_reading_that_is_changed_and_dispersions_of_these_names(written):
    path = written('[dispersions]\nbase = "mass-only"\n' + DISPERSIONS)
    overrides = read(path)
    assert (overrides.base, overrides.replaces) == ("mass-only", False)
    assert set(overrides.dispersions) == {"density", "coefficients", "path"}
    assert overrides.written_with("all")["base"] == "all"
    path = written(uniform(address='"vehicle.mass"').replace("s.x]", "s.replace]"))
    overrides = read(path)
    assert set(overrides.dispersions) == {"replace"} and not overrides.replaces
    path = written("[dispersions]\nreplace = true\n" + DISPERSIONS)
    assert read(path).replaces and "base" not in read(path).written_with("all")
    path = written('[dispersions]\nbase = "mass-only"')
    assert (read(path).base, read(path).dispersions) == ("mass-only", None)
    assert read(path).written_with("all") == "all"


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
        ("lift = 0.8", "drag = 0.8", "the correlation of drag with itself is 1"),
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
