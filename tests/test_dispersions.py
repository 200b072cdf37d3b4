"""A dispersion changes the leaves that it names, and refuses what it cannot change."""

import dataclasses
import types

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario
from laws import observer_law

from jentry.addresses import leaves_by_address
from jentry.campaign import (
    Discrete,
    Dispersion,
    Normal,
    TruncatedNormal,
    Uniform,
    add,
    disperse,
    monte_carlo,
    multiply,
)
from jentry.campaign.dispersions import (
    check_dispersions,
    dispersed_inputs,
    scaled_dispersions,
)
from jentry.guidance import BankProfile


mass = lambda s: s.vehicle.mass
density = lambda s: s.planet.density_scale


def test_each_way_to_move_a_leaf(key):
    scenario = cheap.scenario()
    nominal = {
        a: float(v) for a, v in leaves_by_address(scenario).items() if not v.ndim
    }
    draws = {"mass": 1.04, "density": 0.9, "coefficients": 1.1, "path": 0.001}
    draws = {name: jnp.asarray(value) for name, value in draws.items()}
    inputs = disperse(scenario, cheap.dispersions(), draws)
    path = "initial_state.flight_path_angle"
    assert {address: float(value) for address, value in inputs.items()} == {
        "vehicle.mass": nominal["vehicle.mass"] * 1.04,
        "planet.density_scale": 0.9,
        "vehicle.lift_scale": 1.1,
        "vehicle.drag_scale": 1.1,
        path: nominal[path] + 0.001,
    }


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [(add, multiply, (1.0 + 2.0) * 3.0), (multiply, add, 1.0 * 2.0 + 3.0)],
    ids=["add, multiply", "multiply, add"],
)
@pytest.mark.parametrize("names", [("a", "b"), ("b", "a")], ids=str)
def test_dispersions_of_one_leaf_compose_in_their_order(
    key, first, second, expected, names
):
    """By hand and in a batch, whatever their names."""
    narrow = [Uniform(2.0, 2.0 + 1e-12), Uniform(3.0, 3.0 + 1e-12)]
    table = {
        name: Dispersion(density, distribution, apply)
        for name, distribution, apply in zip(
            names, narrow, (first, second), strict=True
        )
    }
    draws = {name: d.distribution.lower for name, d in table.items()}
    alone = disperse(cheap.scenario(), table, draws)["planet.density_scale"]
    assert alone == expected
    batch = dispersed_inputs(cheap.scenario(), table, key, jnp.arange(2))
    # As wide as the distributions.
    assert batch["planet.density_scale"] == pytest.approx(expected, abs=1e-11)


def test_a_replacement_may_be_moved_but_not_discard_another(key):
    draws = {"one": jnp.asarray(2.0), "two": jnp.asarray(0.5)}
    by_value = Dispersion(density, Uniform(0.8, 1.2))
    by_factor = Dispersion(density, Uniform(0.8, 1.2), apply=multiply)
    moved = disperse(cheap.scenario(), {"one": by_value, "two": by_factor}, draws)
    assert moved["planet.density_scale"] == 1.0
    for first in (by_value, by_factor):
        with pytest.raises(ValueError, match="'two' replaces planet.density_scale"):
            disperse(cheap.scenario(), {"one": first, "two": by_value}, draws)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        (lambda s: s.termination.names, "dispersion 'x': a lens reaches no leaf"),
        (lambda s: s.planet.densty, "dispersion 'x': .*densty"),
        (lambda s: s.termination.conditions["none"], "dispersion 'x': 'none'"),
        (lambda s: s.vehicle.mass + 1.0, "dispersion 'x'"),
        (lambda s: s.planet, "reaches a whole Planet, with planet.radius"),
        (lambda s: (s.vehicle.mass, s.planet.atmosphere), "a whole ExponentialAtmosph"),
        (lambda s: s.termination.conditions, "reaches a whole dict"),
        (lambda s: (s.vehicle.mass,) * 2, "reaches vehicle.mass twice"),
        (lambda s: s.guidance[3], "dispersion 'x'"),
    ],
    ids=["static", "no field", "no key", "computed"]
    + ["module", "number and module", "dictionary", "twice", "no list"],
)
def test_a_dispersion_that_reaches_no_leaf_is_an_error(key, where, message):
    table = {"x": Dispersion(where, Uniform(0.0, 1.0))}
    with pytest.raises(ValueError, match=message):
        disperse(cheap.scenario(), table, {"x": jnp.asarray(1.0)})
    with pytest.raises(ValueError, match=message):
        monte_carlo(cheap.scenario(), table, key, 1)


def test_a_table_of_numbers_is_not_dispersed(key):
    table = {"x": Dispersion(lambda s: s.guidance.cos_bank.coefficients, Normal(0, 1))}
    with pytest.raises(ValueError, match=r"table of shape \(2,\)"):
        monte_carlo(mars_scenario(), table, key, 1)


@pytest.mark.parametrize(
    ("distribution", "message"),
    [
        (Normal(1.0, -0.1), "dispersions.x.standard_deviation is -0.1"),
        (Normal(1.0, 0.0), "dispersions.x.standard_deviation is 0"),
        (Normal(np.nan, 0.1), "dispersions.x.mean is nan"),
        (Uniform(1.2, 0.8), "dispersions.x.lower is 1.2: .*below upper.* 0.8"),
        (TruncatedNormal(1.0, 0.1, 1.0, 1.0), "dispersions.x.lower is 1"),
        (TruncatedNormal(1.0, 0.1, 4.8, 5.0), "dispersions.x.mean is 38 standard dev"),
        (TruncatedNormal(1.0, 0.1, -5.0, -2.8), "dispersions.x.mean is 38 standard d"),
    ],
)
def test_a_distribution_that_cannot_be_drawn_from_is_an_error(distribution, message):
    table = {"x": Dispersion(density, distribution)}
    with pytest.raises(ValueError, match=message):
        check_dispersions(cheap.scenario(), table)


def test_any_mapping_is_a_table(key):
    table = types.MappingProxyType(cheap.mass_only())
    given = dispersed_inputs(cheap.scenario(), table, key, jnp.arange(2))
    assert list(given) == ["vehicle.mass"]


# What cannot matter, and what cannot be told apart.


NO_EFFECT = {
    "factor on zero": (
        lambda s: s.planet.rotation_rate,
        multiply,
        "factor on planet.rotation_rate, which is zero",
    ),
    "onboard nose radius": (
        lambda s: s.guidance.model.vehicle.nose_radius,
        multiply,
        "guidance.model.vehicle.nose_radius has no effect",
    ),
    "onboard rotation": (
        lambda s: s.guidance.model.planet.rotation_rate,
        add,
        "guidance.model.planet.rotation_rate has no effect",
    ),
    "trim of a vehicle whose lift does not depend on it": (
        lambda s: s.vehicle.trim_angle_of_attack,
        add,
        "vehicle.trim_angle_of_attack has no effect",
    ),
    "temperature without a Mach number": (
        lambda s: s.planet.atmosphere.isothermal_temperature,
        multiply,
        "planet.atmosphere.isothermal_temperature has no effect",
    ),
}


@pytest.fixture(scope="module")
def observer_scenario(reference):
    return mars_scenario(observer_law(reference))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "apply", "message"), NO_EFFECT.values(), ids=NO_EFFECT
)
def test_what_cannot_matter_is_refused(observer_scenario, where, apply, message):
    table = {"x": Dispersion(where, Uniform(0.9, 1.1), apply)}
    with pytest.raises(ValueError, match=message):
        check_dispersions(observer_scenario, table)


@pytest.mark.slow
def test_what_matters_is_taken(observer_scenario):
    """Of motion, sensors, law, peaks and misses one each; and zero may be replaced."""
    wheres = [
        (lambda s: s.planet.rotation_rate, add),
        (lambda s: s.vehicle.nose_radius, multiply),
        (lambda s: s.guidance.model.planet.radius, multiply),
        (lambda s: s.guidance.model.planet.atmosphere.scale_height, multiply),
        (lambda s: s.guidance.gains.epsilon0, multiply),
        (
            lambda s: (
                s.termination.conditions["velocity"].velocity,
                s.target.velocity,
            ),
            multiply,
        ),
        (
            lambda s: (
                s.target.altitude,
                s.termination.conditions["altitude"].altitude,
            ),
            add,
        ),
        (lambda s: s.initial_state.longitude, add),
    ]
    table = {
        str(i): Dispersion(where, Uniform(0.9, 1.1), apply)
        for i, (where, apply) in enumerate(wheres)
    }
    check_dispersions(observer_scenario, table)


def test_a_factor_on_what_another_dispersion_made_is_taken(observer_scenario):
    rotation = lambda s: s.planet.rotation_rate
    table = {
        "one": Dispersion(rotation, Uniform(1e-5, 2e-5)),
        "two": Dispersion(rotation, Uniform(0.9, 1.1), multiply),
    }
    check_dispersions(observer_scenario, table)


def test_leaves_that_move_by_one_draw_have_one_unit():
    both = lambda s: (s.vehicle.mass, s.vehicle.drag_scale)
    table = {"x": Dispersion(both, Uniform(0.9, 1.1))}
    with pytest.raises(
        ValueError, match=r"vehicle.mass \(kg\), vehicle.drag_scale \(1"
    ):
        check_dispersions(cheap.scenario(), table)
    table = {"x": Dispersion(both, Uniform(0.9, 1.1), apply=multiply)}
    check_dispersions(cheap.scenario(), table)


class Counting(BankProfile):
    """A law with a whole number among its leaves."""

    count: jax.Array = dataclasses.field(default_factory=lambda: jnp.asarray(1))


def test_a_whole_number_takes_whole_numbers(key):
    """Anything else would be flown without its fraction, and stored with it."""
    law = Counting(cheap.at_trim().guidance.cos_bank)
    scenario = dataclasses.replace(cheap.scenario(), guidance=law)
    table = {"x": Dispersion(lambda s: s.guidance.count, Discrete([2.0, 3.0]))}
    with pytest.raises(ValueError, match="'x' reaches guidance.count, a whole number"):
        monte_carlo(scenario, table, key, 1)
    with pytest.raises(ValueError, match="the inputs, run 1: guidance.count is 1.5"):
        monte_carlo(scenario, inputs={"guidance.count": [1.0, 1.5]})


def test_a_scaled_table_keeps_all_but_the_widths():
    table = types.MappingProxyType(cheap.dispersions())
    scaled = scaled_dispersions(table, 0.1)
    assert list(scaled) == list(table)
    for name, dispersion in table.items():
        assert scaled[name].where is dispersion.where
        assert scaled[name].apply is dispersion.apply
        mean, deviation = dispersion.distribution.moments()
        about, width = scaled[name].distribution.moments()
        # Rounding of the bounds over the width.
        np.testing.assert_allclose(about, mean, rtol=1e-14, atol=1e-18)
        np.testing.assert_allclose(width, 0.1 * deviation, rtol=1e-13)
    check_dispersions(cheap.scenario(), scaled)
    # The given table is left as it was.
    assert table["mass"].distribution.lower == 0.95
