"""Values and limits of path constraints at a point."""

import copy
import dataclasses
import pickle

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from constraint_cases import (
    BETA,
    DENSITY,
    G0,
    GRAVITATION,
    LIFT_TO_DRAG,
    RADIUS,
    SCALE_HEIGHT,
    NoseTemperature,
    constrained_scenario,
    point,
)

from jentry.addresses import leaves_by_address, unit_of
from jentry.fields import Scalar
from jentry.flight import fly
from jentry.motion import (
    AbstractConstraint,
    ConstraintValues,
    Controls,
    Drag,
    DynamicPressure,
    EquilibriumGlide,
    HeatLoad,
    HeatRate,
    LoadFactor,
    NormalLoadFactor,
    entry_dynamics,
    excesses,
    tightened,
)
from jentry.tuning.losses import penalty
from jentry.units import degree, km


def test_values_at_a_point():
    """Few lines of numpy for each: the coefficients do not depend on anything."""
    density = DENSITY * np.exp(-40 * km / SCALE_HEIGHT)
    pressure = 0.5 * density * 4000.0**2
    drag = pressure / BETA
    lift = LIFT_TO_DRAG * drag
    radius = RADIUS + 40 * km
    heat_rate = 1.7415e-4 * np.sqrt(density) * 4000.0**3
    weight = (GRAVITATION / radius**2 - 4000.0**2 / radius) * np.cos(-0.05)
    expected = [
        (Drag(), drag),
        (DynamicPressure(), pressure),
        (HeatRate(), heat_rate),
        (LoadFactor(), np.hypot(lift, drag) / G0),
        (NormalLoadFactor(), (lift * np.cos(0.3) + drag * np.sin(0.3)) / G0),
        (EquilibriumGlide(), (weight - lift) / G0),
        (EquilibriumGlide(60 * degree), (weight - 0.5 * lift) / G0),
        (NoseTemperature(), (heat_rate / (0.85 * 5.670374419e-8)) ** 0.25),
    ]
    for constraint, value in expected:
        found = constraint.value(point())
        np.testing.assert_allclose(found, value, rtol=1e-12, err_msg=str(constraint))
    np.testing.assert_allclose(HeatLoad().rate(point()), heat_rate, rtol=1e-12)


def test_equilibrium_glide_keeps_the_path_angle():
    """Also over a planet that turns: at a value of zero the path angle has no rate."""
    turning = point(rotation_rate=7e-5)
    rates = entry_dynamics(
        turning.planet,
        turning.vehicle,
        turning.state,
        Controls.from_bank(jnp.asarray(0.4), jnp.asarray(0.3)),
    )
    found = EquilibriumGlide(0.4).value(turning)
    np.testing.assert_allclose(
        found, -4000.0 * rates.flight_path_angle / G0, rtol=1e-14
    )
    assert abs(found - EquilibriumGlide(0.4).value(point())) > 0.01


# Limits and what exceeds them.


def test_tightened_limits_are_lower_by_a_share():
    """Those that have none are left out; one that is not positive stays."""
    constraints = {
        "drag": Drag(),
        "heat_rate": HeatRate(2e6),
        "glide": EquilibriumGlide(limit=0.0),
        "load_factor": LoadFactor(4.0),
    }
    found = tightened(constraints, 0.05)
    limits = {name: float(each.limit) for name, each in found.items()}
    assert limits == {"heat_rate": 1.9e6, "glide": 0.0, "load_factor": 3.8}
    assert {n: type(c) for n, c in found.items()} == {
        "heat_rate": HeatRate,
        "glide": EquilibriumGlide,
        "load_factor": LoadFactor,
    }
    below = tightened({"glide": EquilibriumGlide(limit=-0.5)}, 0.05)
    assert float(below["glide"].limit) == -0.5


def test_what_exceeds_a_limit():
    constraints = {
        "drag": Drag(),
        "heat_rate": HeatRate(2e6),
        "glide": EquilibriumGlide(limit=0.0),
        "load_factor": LoadFactor(4.0),
    }
    values = {"drag": 9.0, "heat_rate": 3e6, "glide": 0.25, "load_factor": 3.9}
    values = ConstraintValues({n: jnp.asarray(x) for n, x in values.items()})
    found = excesses(constraints, values)
    # As shares of the limits; of that of the glide, which is zero, in its own unit.
    assert dict(found) == {"glide": 0.25, "heat_rate": 0.5, "load_factor": 0.0}
    assert constraints["drag"].excess(jnp.asarray(9.0)) == 0.0
    of_flights = ConstraintValues(
        {"a": jnp.array([0.0, 0.5]), "b": jnp.array([1.0, 0.0])}
    )
    assert penalty(of_flights) == 0.5 * (0.25 + 1.0)
    with pytest.raises(ValueError, match="no path constraint .* has a limit"):
        penalty(excesses({"drag": Drag()}, values))


def test_a_limit_is_a_leaf_with_a_unit():
    scenario = constrained_scenario()
    assert unit_of(scenario, "constraints.nose_temperature.limit") == "K"
    leaves = leaves_by_address(scenario)
    assert leaves["constraints.heat_load.limit"] == 5e6
    assert "constraints.drag.limit" not in leaves


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"constraints": {"heat rate": HeatRate()}}, "the name 'heat rate'"),
        ({"constraints": {"drag": eqx.nn.Identity()}}, "constraints.drag is Identity"),
        (
            {"constraints": {"drag_error": Drag()}},
            "'drag_error': columns .* _error are misses; .* drag_deviation",
        ),
        ({"located_peaks": ("heat",)}, "located_peaks has 'heat', .* dynamic_pressure"),
        ({"constraints": {"drag": Drag(np.nan)}}, "constraints.drag.limit is nan"),
    ],
)
def test_bad_constraints_are_refused(change, message):
    given = change.get("constraints", {})
    if all(isinstance(c, AbstractConstraint) for c in given.values()):
        with pytest.raises(ValueError, match=message):
            fly(dataclasses.replace(cheap.scenario(), **change))
        return
    scenario = cheap.scenario()
    object.__setattr__(copied := copy.copy(scenario), "constraints", given)
    with pytest.raises(ValueError, match=message):
        fly(copied)


def test_a_class_without_a_unit_is_refused():
    class Nameless(AbstractConstraint):
        limit: Scalar | None = None

        def value(self, point):
            return point.air.drag

    bad = dataclasses.replace(cheap.scenario(), constraints={"x": Nameless()})
    with pytest.raises(ValueError, match="constraints.x: Nameless has no unit"):
        fly(bad)


# Values by name.


def test_values_by_name():
    values = ConstraintValues({"b": jnp.asarray(2.0), "a": jnp.asarray(1.0)})
    assert list(values) == ["a", "b"] and len(values) == 2
    assert values["b"] == values.b == 2.0
    assert list(leaves_by_address(values)) == ["a", "b"]
    doubled = jax.tree.map(lambda x: 2.0 * x, values)
    assert dict(doubled) == {"a": 2.0, "b": 4.0}
    for again in (copy.deepcopy(values), pickle.loads(pickle.dumps(values))):
        assert dict(again) == dict(values)
    with pytest.raises(AttributeError, match="no path constraint 'c' .* has a, b: add"):
        _ = values.c
    assert not hasattr(values, "_c")
