"""Values and dispersions that are written to a file are read again unchanged."""

import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario
from override_files import DISPERSIONS, MORE, read, write_overrides

from jentry.addresses import leaves_by_address
from jentry.cli.overrides import apply_values, read_overrides


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
    assert overrides.base == "mass-only"
    assert overrides.dispersions is None and overrides.values == {}
    assert path.read_text().startswith("# Two\n# [lines]\n")


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
    assert again.base is None
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
