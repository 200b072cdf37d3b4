"""A leaf is found by its address, and what is no leaf is refused with its neighbours."""

import cheap
import jax
import jax.numpy as jnp
import pytest
from helpers import mars_scenario

from jentry.addresses import (
    addresses_of,
    leaves_by_address,
    modules_by_address,
    nearest,
    replace_leaves,
    require_address,
    unit_of,
)
from jentry.cli.overrides import AtAddresses


@pytest.fixture(scope="module")
def scenario():
    return mars_scenario()


def test_every_leaf_has_an_address_of_its_own(scenario):
    found = leaves_by_address(scenario)
    leaves = jax.tree.leaves(scenario)
    assert len(found) == len(leaves)
    assert all(a is b for a, b in zip(found.values(), leaves, strict=True))


def test_every_module_has_its_address(scenario):
    found = modules_by_address(scenario)
    assert found[""] is scenario
    assert found["planet.gravity"] is scenario.planet.gravity
    velocity = scenario.termination.conditions["velocity"]
    assert found["termination.conditions.velocity"] is velocity
    inside = [address.rpartition(".")[0] for address in leaves_by_address(scenario)]
    assert set(inside) <= set(found)


@pytest.mark.parametrize(
    ("address", "where"),
    [
        ("planet.density_scale", lambda s: s.planet.density_scale),
        ("initial_state.velocity", lambda s: s.initial_state.velocity),
        (
            "termination.conditions.altitude.altitude",
            lambda s: s.termination.conditions["altitude"].altitude,
        ),
        ("guidance.cos_bank.coefficients", lambda s: s.guidance.cos_bank.coefficients),
    ],
)
def test_address_and_lens_name_the_same_leaf(scenario, address, where):
    assert addresses_of(scenario, where) == [address]
    assert addresses_of(scenario, AtAddresses((address,))) == [address]
    assert leaves_by_address(scenario)[address] is where(scenario)


def test_a_tree_of_the_same_structure_may_have_other_leaves():
    """Addresses are kept from tree to tree of one structure."""
    for middle in (jnp.ones(2), 3.0, jnp.zeros(())):
        tree = {"a": [jnp.zeros(()), middle], "b": jnp.ones(3)}
        is_leaf = isinstance(middle, jax.Array)
        assert list(leaves_by_address(tree)) == ["a.0", *is_leaf * ["a.1"], "b"]
        assert addresses_of(tree, lambda t: t["b"]) == ["b"]
        if is_leaf:
            assert addresses_of(tree, lambda t: t["a"][1]) == ["a.1"]
        else:
            with pytest.raises(ValueError, match="reaches no leaf"):
                addresses_of(tree, lambda t: t["a"][1])


def test_a_lens_may_reach_several_leaves(scenario):
    both = lambda s: (s.vehicle.lift_scale, s.vehicle.drag_scale)
    assert addresses_of(scenario, both) == ["vehicle.lift_scale", "vehicle.drag_scale"]


@pytest.mark.parametrize(
    "where",
    [
        lambda s: (),
        lambda s: None,
        lambda s: s.termination.names,
        lambda s: s.termination.time_limit,
        lambda s: 2 * s.planet.density_scale,
        lambda s: (s.planet.density_scale, s.termination.names),
        lambda s: "planet.density",
    ],
)
def test_a_lens_that_reaches_no_leaf_is_refused(scenario, where):
    with pytest.raises(ValueError, match="reaches no leaf"):
        addresses_of(scenario, where)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("planet.density_scal", "planet.density_scale"),
        ("density_scale", "planet.density_scale"),
        ("initial_state.gamma", "initial_state"),
        ("vehicle.velocity", "initial_state.velocity"),
    ],
)
def test_the_nearest_names_are_told(scenario, wrong, right):
    with pytest.raises(ValueError, match=f"no leaf '{wrong}'.*nearest: .*{right}"):
        require_address(leaves_by_address(scenario), wrong)


def test_there_are_nearest_names_even_if_nothing_is_near():
    assert nearest("zzz", ["b", "a", "d", "c"]) == "nearest: a, b, c"


def test_replaced_leaves_and_no_others_are_new(scenario):
    changed = replace_leaves(scenario, {"vehicle.mass": 900, "target.altitude": 5e3})
    before, after = leaves_by_address(scenario), leaves_by_address(changed)
    assert {a for a in before if after[a] is not before[a]} == {
        "vehicle.mass",
        "target.altitude",
    }
    assert after["vehicle.mass"] == 900.0
    assert after["vehicle.mass"].dtype == before["vehicle.mass"].dtype
    assert jax.tree.structure(changed) == jax.tree.structure(scenario)


def test_replace_under_jit_vmap_and_grad(scenario):
    def mass(value):
        changed = replace_leaves(scenario, {"vehicle.mass": value})
        return changed.vehicle.mass * changed.planet.density_scale

    values = jnp.array([900.0, 1000.0])
    assert jnp.array_equal(jax.jit(jax.vmap(mass))(values), values)
    assert jax.grad(mass)(900.0) == 1.0


def test_values_of_another_shape_and_unknown_addresses_are_refused(scenario):
    with pytest.raises(ValueError, match=r"vehicle\.mass has shape \(\).*\(2,\)"):
        replace_leaves(scenario, {"vehicle.mass": [1.0, 2.0]})
    with pytest.raises(ValueError, match="nearest: vehicle.mass"):
        replace_leaves(scenario, {"vehicle.mas": 1.0})
    coefficients = jnp.array([0.5, 0.1])
    changed = replace_leaves(scenario, {"guidance.cos_bank.coefficients": coefficients})
    assert jnp.array_equal(changed.guidance.cos_bank.coefficients, coefficients)


def test_units_are_those_of_the_fields(scenario):
    units = {a: unit_of(scenario, a) for a in leaves_by_address(scenario)}
    assert units["vehicle.mass"] == "kg"
    assert units["initial_state.flight_path_angle"] == "rad"
    assert units["planet.density_scale"] == "1"
    assert units["termination.conditions.velocity.velocity"] == "m/s"
    assert unit_of(cheap.scenario(), "guidance.bank_angle") == "rad"
