"""The entry corridor of Lee, Cho and Yan, and its derivatives."""

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
    point,
)
from helpers import mars_planet, mars_vehicle

from jentry.motion import (
    Drag,
    DynamicPressure,
    EntryState,
    EquilibriumGlide,
    HeatLoad,
    HeatRate,
    NormalLoadFactor,
    corridor_point,
    entry_corridor,
)


VELOCITY = np.array([2500.0, 2800.0, 3100.0])


def limits(**limits):
    constraints = {
        "heat_rate": HeatRate(limits.get("heat_rate", 3e5)),
        "dynamic_pressure": DynamicPressure(limits.get("pressure", 9e3)),
        "normal_load": NormalLoadFactor(limits.get("load", 2.0)),
        "glide": EquilibriumGlide(0.0, 0.0),
        "heat_load": HeatLoad(1e7),
        "drag": Drag(),
    }
    velocity, angle = jnp.asarray(VELOCITY), jnp.full(3, 0.4)
    start = EntryState(0.0, 0.0, 0.2, 1.0, -0.3, 1.1)
    points = entry_corridor(
        constraints, mars_planet(), mars_vehicle(), start, velocity, angle
    )
    # In an exponential atmosphere the drag tells the altitude.
    for each in points.values():
        density = 2.0 * BETA * each.drag / VELOCITY**2
        expected = SCALE_HEIGHT * jnp.log(DENSITY / density)
        assert isinstance(each.drag, jax.core.Tracer) or jnp.allclose(
            each.altitude, expected, rtol=1e-10, atol=0.0
        )
    return {name: each.drag for name, each in points.items()}


@pytest.mark.slow
def test_corridor_is_that_of_lee_cho_and_yan():
    """Equations (6) to (9), their heating constant from ours."""
    found = limits()
    assert set(found) == {"heat_rate", "dynamic_pressure", "normal_load", "glide"}
    # (6): the density at which 1.7415e-4 sqrt(density) V^3 is the limit.
    density = (3e5 / (1.7415e-4 * VELOCITY**3)) ** 2
    np.testing.assert_allclose(
        found["heat_rate"], density * VELOCITY**2 / (2.0 * BETA), rtol=1e-10
    )
    normal = LIFT_TO_DRAG * np.cos(0.4) + np.sin(0.4)  # (7)
    np.testing.assert_allclose(found["normal_load"], 2.0 * G0 / normal, rtol=1e-10)
    np.testing.assert_allclose(found["dynamic_pressure"], 9e3 / BETA, rtol=1e-10)  # (9)
    # (8), at the radius where that drag is found.
    altitude = SCALE_HEIGHT * np.log(
        DENSITY * VELOCITY**2 / (2.0 * BETA * np.asarray(found["glide"]))
    )
    radius = RADIUS + altitude
    needed = GRAVITATION / radius**2 - VELOCITY**2 / radius
    np.testing.assert_allclose(found["glide"], needed / LIFT_TO_DRAG, rtol=1e-10)


@pytest.mark.slow
def test_corridor_has_derivatives():
    """The drag goes with the limits of pressure and load, and with the square of (6)'s."""
    for name, power in (("heat_rate", 2.0), ("pressure", 1.0), ("load", 1.0)):
        at = {"heat_rate": 3e5, "pressure": 9e3, "load": 2.0}[name]
        key = {"pressure": "dynamic_pressure", "load": "normal_load"}.get(name, name)

        def drag(limit, name=name, key=key):
            return limits(**{name: limit})[key]

        value, slope = jax.jvp(drag, (jnp.asarray(at),), (jnp.ones(()),))
        np.testing.assert_allclose(slope, power * value / at, rtol=1e-9, err_msg=name)


def test_a_limit_that_is_met_nowhere_and_one_that_is_none():
    where = mars_planet(), mars_vehicle(), point().state, jnp.asarray(0.3)
    nowhere = corridor_point(DynamicPressure(1e9), *where)
    assert np.isnan(nowhere.drag) and np.isnan(nowhere.altitude)
    with pytest.raises(ValueError, match="Drag has no limit"):
        corridor_point(Drag(), *where)
    with pytest.raises(ValueError, match="HeatLoad is no quantity of a point"):
        corridor_point(HeatLoad(1.0), *where)
