"""The SX-2 mission has the dispersions of Bharadwaj, Rao and Mease."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mission_numbers import DENSITY, DRAG, LIFT, SX_2, assert_drawn

from jentry.campaign import OneOfSeveral, Uniform, add, replace
from jentry.campaign.dispersions import draw
from jentry.missions.sx_2.scenario import entry
from jentry.units import degree, foot, nautical_mile


# The numbers of the vehicle are those of sx_2_by_hand.

SX_2_ERRORS = {
    "altitude": 1000.0 * foot,
    "longitude": 0.1 * degree,
    "latitude": 0.1 * degree,
    "velocity": 100.0 * foot,
    "flight path angle": 0.1 * degree,
    "heading": 0.1 * degree,
}


def in_start(name):
    return (f"initial_state.{name.replace(' ', '_')}",)


def test_dispersions_of_sx_2():
    scenario, table = entry(), SX_2.dispersion_table
    at_once = {
        name: (in_start(name), Uniform, (-most, most), add)
        for name, most in SX_2_ERRORS.items()
    }
    assert_drawn(scenario, table("initial-errors"), at_once)
    factors = {
        "density": ((DENSITY,), Uniform, (0.8, 1.2), replace),
        "lift": ((LIFT,), Uniform, (0.95, 1.05), replace),
        "drag": ((DRAG,), Uniform, (0.95, 1.05), replace),
    }
    assert_drawn(scenario, table("air-and-vehicle"), factors)
    assert_drawn(scenario, table("everything"), at_once | factors)
    each = {
        name: (in_start(name), OneOfSeveral, (most,), add)
        for name, most in SX_2_ERRORS.items()
    }
    assert_drawn(scenario, table("one-at-a-time"), each)


def test_one_error_of_sx_2_at_a_time(key):
    """Whatever the run: one, and each of them in some."""
    table = SX_2.dispersion_table("one-at-a-time")
    drawn = jax.vmap(lambda run: draw(table, key, run))(jnp.arange(100))
    there = np.stack(list(drawn.values())) != 0.0
    assert np.all(np.sum(there, axis=0) == 1) and np.all(np.any(there, axis=1))


def test_the_bound_of_sx_2():
    """Below 1 n mile at the end, downrange and crossrange, of errors one at a time."""
    errors = np.array([-3.0, 2.0, 1.0]) * nautical_mile
    of = {"downrange_error": errors, "crossrange_error": -0.5 * errors[1:]}
    found = {value.name: value.statistic(of) for value in SX_2.published}
    names = "largest downrange error", "largest crossrange error"
    assert found == pytest.approx(dict(zip(names, (3.0, 1.0), strict=True)))
    assert {value.name: value.value for value in SX_2.published} == dict.fromkeys(
        names, 1.0
    )
    assert {value.unit for value in SX_2.published} == {"n mile"}
    assert SX_2.published_law == "full"
    assert SX_2.published_dispersions == "one-at-a-time"
