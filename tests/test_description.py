"""Campaigns and losses in plain values: nothing is lost, each difference is named."""

import base64
import functools
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from helpers import mars_scenario

from jentry import FixedStep, _setup
from jentry.campaign.description import (
    _plain,
    describe,
    first_difference,
    leaf_of,
    scalars_of,
)
from jentry.campaign.parts import claim
from jentry.onboard.profiles import quintic_profile
from jentry.tuning.record import told


LONG = "guidance.cos_bank.coefficients"


def with_table(nodes, last=0.3):
    """A scenario with a table of six numbers for each interval."""
    x = np.linspace(0.0, 1.0, nodes)
    value = np.append(np.sin(x[:-1]), last)
    profile = quintic_profile(
        *map(jnp.asarray, (0.0, x[1], value, np.cos(x), -np.sin(x)))
    )
    scenario = mars_scenario()
    return eqx.tree_at(lambda s: s.guidance.cos_bank, scenario, profile)


def described(nodes, last=0.3):
    scenario = with_table(nodes, last)
    # As it is read from the file that it is written to.
    return json.loads(json.dumps(describe(scenario, None, 0, FixedStep(), None)))


def test_long_tables_by_their_bytes():
    value = described(40)["scenario"][LONG]["value"]
    table = with_table(40).guidance.cos_bank.coefficients
    assert value["shape"] == [39, 6] and value["type"] == "float64"
    read = np.frombuffer(base64.b64decode(value["base64"]), "<f8").reshape(39, 6)
    np.testing.assert_array_equal(read, table)


def test_short_tables_in_digits():
    value = described(10)["scenario"][LONG]["value"]
    np.testing.assert_array_equal(value, with_table(10).guidance.cos_bank.coefficients)


@pytest.mark.parametrize("nodes", [10, 40])
def test_scalars_without_tables(nodes):
    """What a part of a campaign says of its scenario, where HDF5 takes 64 kB."""
    known = described(nodes)
    scalars = scalars_of(known)
    assert LONG in known["scenario"] and LONG not in scalars
    assert scalars["vehicle.mass"] == known["scenario"]["vehicle.mass"]
    assert all(isinstance(x["value"], float | int) for x in scalars.values())


@pytest.mark.parametrize("nodes", [10, 40])
def test_a_table_that_differs_is_named(nodes, tmp_path):
    known, wanted = described(nodes), described(nodes, 0.3 + 1e-12)
    assert first_difference(known, known) is None
    assert first_difference(known, wanted) in (
        f"scenario.{LONG} differs",
        f"scenario.{LONG}.value differs",
    )
    claim(tmp_path, known)
    agreed, _ = claim(tmp_path, wanted)  # no runs yet: it is taken over
    assert first_difference(agreed, wanted) is None


def test_options_of_the_compiler_are_part_of_it(monkeypatch):
    """With others the same runs come out otherwise, by rounding."""
    usual = described(5)
    assert usual["xla_options"] == _setup.xla_options() != []
    monkeypatch.setenv("XLA_FLAGS", "")
    assert described(5)["xla_options"] == []
    assert first_difference(usual, described(5)).startswith("xla_options differs")


@pytest.mark.parametrize("shape", [(), (3,), (4, 5), (101,), (7, 31)])
def test_leaves_are_had_back_to_the_last_bit(shape):
    """Short ones by their digits, long ones by their bytes; through JSON as well."""
    values = np.random.default_rng(0).normal(size=shape) * np.pi**20
    for leaf in (values, (1e3 * values).astype(np.int64)):
        plain = json.loads(json.dumps(_plain(leaf)))
        again = leaf_of(plain)
        assert again.shape == leaf.shape
        np.testing.assert_array_equal(again, leaf)


class Plain(eqx.Module):
    function: object = eqx.field(static=True)
    numbers: jax.Array


def some_function():
    pass


def test_what_is_told_of_a_loss():
    """Functions by their names, modules and what they are made of by their fields."""
    thing = Plain(functools.partial(some_function, 0.05), jnp.arange(2.0))
    name = f"{__name__}.some_function"
    assert told(thing) == {
        "type": "Plain",
        "function": [name, [0.05], {}],
        "numbers": [0.0, 1.0],
    }
    assert told(lambda: 0).endswith("<lambda>")
    assert told(optax.adam(0.1)) == "GradientTransformationExtraArgs"
