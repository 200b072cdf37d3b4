"""Objects print their numbers in the units people read, whatever stands in their fields."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_entry, mars_planet, mars_vehicle

from jentry._printed import as_text, in_words, quantity_in_words
from jentry.fields import Scalar, in_unit, scalar, units_of
from jentry.flight import Flight, Misses, Target
from jentry.motion import Controls, EntryState
from jentry.motion.constraints import (
    AbstractConstraint,
    ConstraintValues,
    PathPoint,
    constraint_values,
    excesses,
    usual_constraints,
)
from jentry.units import degree, km


def controls_at(bank, angle_of_attack):
    return Controls.from_bank(jnp.asarray(bank), jnp.asarray(angle_of_attack))


def lines(text):
    """What is printed beside each name."""
    first, *rest = text.splitlines()
    return {line.strip().split("  ")[0]: line.split("  ")[-1].strip() for line in rest}


def test_misses_in_units():
    numbers = (-2500.0, 0.0, 40.0, -3.5, 0.2 * degree)
    missed = Misses(*map(jnp.asarray, numbers), None)
    text = str(missed)
    assert text.startswith("Misses\n") and "heading" not in text
    distance = np.sqrt(2.5**2 + 0.04**2)
    assert lines(text) == {
        "downrange": "-2.5 km",
        "crossrange": "0 m",
        "altitude": "0.04 km",
        "velocity": "-3.5 m/s",
        "flight-path angle": "0.2 deg",
        "distance": f"{distance:.6g} km",
    }


def test_state_and_controls_in_units():
    shown = lines(str(mars_entry()))
    assert shown["altitude"] == "126.1 km" and shown["velocity"] == "6750 m/s"
    assert shown["flight-path angle"] == "-14.4 deg" and shown["heading"] == "90 deg"
    controls = lines(str(controls_at(-50 * degree, 0.1)))
    assert controls["bank angle"] == "-50 deg"
    assert controls["angle of attack"] == f"{np.degrees(0.1):.6g} deg"


def test_a_vehicle_with_what_is_in_it():
    text = str(mars_vehicle())
    shown = lines(text)
    assert shown["mass"] == "992 kg" and shown["reference area"] == "16 m2"
    assert shown["aerodynamics"] == "ConstantAerodynamics"
    assert "    lift coefficient" in text


def test_members_of_a_tuple_are_printed():
    class Wave(eqx.Module):
        length: Scalar = scalar(unit="m")

    class Air(eqx.Module):
        waves: tuple[Wave, ...]
        order: int = eqx.field(static=True, default=3)

    text = as_text(Air((Wave(25 * km), Wave(8 * km))))
    assert text.count("Wave") == 2 and "25 km" in text and "8 km" in text
    assert lines(text)["order"] == "3"


def test_many_numbers_by_their_extremes():
    shown = quantity_in_words(np.array([[1e3, -2.5e3], [np.nan, 2e4]]), "m")
    assert shown == "2 x 2 numbers, -2.5 to 20 km, 1 not finite"
    assert quantity_in_words(np.full(3, np.nan), "s") == (
        "3 numbers, none of them finite s"
    )
    assert quantity_in_words(np.nan, "m/s") == "nan m/s"


def test_peaks_have_the_units_of_their_constraints():
    """Through what JAX does to them; what exceeds a limit is a share, without a unit."""

    class Temperature(AbstractConstraint):
        limit: Scalar | None = scalar(1000.0, unit="K")
        unit = "K"

        def value(self, point):
            return 0.0 * point.air.drag + 1500.0

    constraints = usual_constraints() | {"nose": Temperature()}
    controls = controls_at(0.3, 0.0)
    state = dataclasses.replace(mars_entry(), altitude=40 * km)
    point = PathPoint.of(mars_planet(), mars_vehicle(), state, controls)
    values = jax.jit(lambda point: constraint_values(constraints, point, {}))(point)
    shown = lines(str(jax.tree.map(lambda x: x, values)))
    assert shown["nose"] == "1500 K"
    assert (
        shown["dynamic pressure"] == f"{float(values.dynamic_pressure) / 1e3:.6g} kPa"
    )
    assert shown["heat rate"] == f"{float(values.heat_rate) / 1e4:.6g} W/cm2"
    assert shown["load factor"].endswith(" g") and shown["drag"].endswith(" m/s2")
    assert lines(str(excesses(constraints, values))) == {"nose": "0.5"}
    assert "1500 K" not in repr(values)
    other_order = dict(reversed(constraints.items()))
    assert jax.tree.structure(constraint_values(other_order, point, {})) == (
        jax.tree.structure(values)
    )


OBJECTS = {
    "vehicle": mars_vehicle,
    "planet": mars_planet,
    "state": mars_entry,
    "controls": lambda: controls_at(0.3, 0.1),
    "target": lambda: Target(10 * km, 503.0, 723 * km),
    "misses": lambda: Misses(*map(jnp.asarray, (1.0, 2.0, 3.0, 4.0))),
}


@pytest.mark.parametrize("made", OBJECTS.values(), ids=OBJECTS)
def test_what_has_no_numbers_yet_is_printed_by_its_type(made):
    tree, texts = made(), []

    @jax.jit
    def traced(tree):
        texts.extend((str(tree), repr(tree)))
        return 0.0

    traced(tree)
    jax.vmap(traced, axis_size=2, in_axes=None)(tree)
    assert "float64[]" in texts[0]
    assert texts[1] == eqx.tree_pformat(tree)
    holders = jax.tree.map(lambda x: object(), tree)
    assert "object at" in str(holders)
    shapes = jax.eval_shape(lambda: tree)
    assert "float64[]" in str(shapes)


def test_no_number_of_an_output_lacks_its_unit():
    """A field that is forgotten would be in no table, and in no result."""
    for kind in (Misses, EntryState):
        fields = {field.name for field in dataclasses.fields(kind)}
        assert fields <= set(units_of(kind))
    assert units_of(Misses)["distance"] == "m"
    assert units_of(Controls)["bank_angle"] == "rad"

    class Own(eqx.Module):
        mass: Scalar = scalar(unit="kg")
        name: str = "x"

        @property
        @in_unit("kg")
        def half(self):
            return 0.5 * self.mass

        @property
        def other(self):
            return 1.0

    assert units_of(Own) == {"mass": "kg", "half": "kg"}
    assert lines(str(as_text(Own(3.0))))["half"] == "1.5 kg"


def test_a_miss_that_is_not_finite_is_no_hit():
    nan = jnp.asarray(np.nan)
    zero = jnp.asarray(0.0)
    assert np.isnan(Misses(nan, zero, zero, zero).distance)
    assert np.isnan(Misses(zero, zero, nan, zero).distance)
    value, slope = jax.value_and_grad(lambda x: Misses(x, zero, zero, zero).distance)(
        zero
    )
    assert (float(value), float(slope)) == (0.0, 0.0)


def test_words():
    assert in_words("flight_path_angle_error") == "flight-path angle error"
    assert in_words("peak_heat_rate") == "peak heat rate"


def test_a_flight_says_how_it_ended():
    """Several flights, and one that is traced, have no single outcome."""
    number = jnp.asarray(2.0)
    values = ConstraintValues({"drag": number}, {"drag": "m/s2"})
    state = EntryState(12e3, 0.0, 0.0, 503.0, -0.3, 1.5)
    flight = Flight(number, state, jnp.asarray(2), jnp.asarray(0), values, {}, {}, None)
    text = str(flight)
    assert text.startswith("Flight: met the surface\n")
    shown = lines(text)
    assert (shown["time"], shown["altitude"]) == ("2 s", "12 km")
    assert shown["drag"] == "2 m/s2"

    several = jax.tree.map(lambda x: jnp.stack([x, x]), flight)
    assert str(several).startswith("Flight\n")
    assert lines(str(several))["altitude"] == "2 numbers, 12 to 12 km"

    traced = []
    jax.jit(lambda f: traced.append(str(f)))(flight)
    assert traced[0].startswith("Flight\n")
