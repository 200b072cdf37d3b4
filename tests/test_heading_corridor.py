"""Heading corridors: heading errors, widths and bank reversals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_planet, with_leaf
from lateral_states import ORIGIN, TIME, after, seen

from jentry.guidance import HeadingCorridor, SmoothReversals
from jentry.units import degree, km


def bearing(state, longitude, latitude):
    """From vectors: the angle between the horizontal parts of heading and target."""
    up, target = (
        np.array([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])
        for a, b in (
            (float(state.longitude), float(state.latitude)),
            (longitude, latitude),
        )
    )
    east = np.cross([0.0, 0.0, 1.0], up)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    to_east, to_north = target @ east, target @ north
    return np.arctan2(to_east, to_north)


TARGETS = [(30.0, 40.0), (-100.0, 20.0), (20.5, 35.5), (150.0, -50.0), (21.0, 34.0)]
"""Longitude and latitude, deg: near and far, to the left and to the right, and behind"""


def corridor_to(longitude, latitude, **given):
    where = longitude * degree, latitude * degree
    widths = {"velocities": [2e3, 7e3], "half_widths": [5 * degree, 15 * degree]}
    return HeadingCorridor(*where, 3397 * km, **(widths | given))


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("heading", [0.0, 60.0, 200.0, 350.0])
def test_heading_error_is_counted_clockwise_to_the_bearing(target, heading):
    state = with_leaf(ORIGIN, lambda s: s.heading, heading * degree)
    found = corridor_to(*target).heading_error(state)
    wanted = bearing(state, *np.radians(target)) - np.radians(heading)
    wanted = np.arctan2(np.sin(wanted), np.cos(wanted))
    np.testing.assert_allclose(found, wanted, atol=1e-13)


@pytest.mark.parametrize(
    ("velocity", "width"),
    [(100.0, 5.0), (2000.0, 5.0), (4500.0, 10.0), (7000.0, 15.0), (9000.0, 15.0)],
)
def test_width_of_a_heading_corridor_is_linear_and_held_beyond(velocity, width):
    found = corridor_to(0.0, 0.0).half_width(jnp.asarray(velocity))
    np.testing.assert_allclose(found, width * degree, rtol=1e-14)
    table = {"velocities": [1e3, 2e3, 8e3], "half_widths": [0.1, 0.3, 0.2]}
    corridor = corridor_to(0.0, 0.0, **table)
    found = corridor.half_width(jnp.asarray(velocity))
    wanted = np.interp(velocity, [1e3, 2e3, 8e3], [0.1, 0.3, 0.2])
    np.testing.assert_allclose(found, wanted, rtol=1e-14)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right", "left"])
@pytest.mark.parametrize("beyond", [-0.01, 0.01])
def test_heading_corridor_turns_towards_its_target(target, side, beyond):
    """A hundredth of a degree beyond it, and within it; at 4500 m/s it is 10 deg wide."""
    off = side * (10.0 + beyond) * degree
    heading = bearing(ORIGIN, *np.radians(target)) - off
    state = with_leaf(ORIGIN, lambda s: s.heading, heading)
    state = with_leaf(state, lambda s: s.velocity, 4500.0)
    corridor = corridor_to(*target)
    for before in (1.0, -1.0):
        after = corridor.update(TIME, seen(state), jnp.asarray(before), None)
        assert float(after) == (side if beyond > 0.0 else before)


def test_at_its_target_a_heading_corridor_leaves_the_bank():
    corridor = corridor_to(20.0, 35.0)
    for before in (1.0, -1.0):
        assert corridor.update(TIME, seen(ORIGIN), jnp.asarray(before), None) == before


def test_a_surrogate_shares_the_reversal_of_a_heading_corridor_out():
    """Over the distance by which the target would be passed: 1 km of 2 km beyond it."""
    planet, distance = mars_planet(), 400 * km
    target = after(planet, ORIGIN, distance)
    where = (float(x) / degree for x in (target.longitude, target.latitude))
    corridor = corridor_to(
        *where,
        velocities=[1.0],
        half_widths=[0.01],
        switching=SmoothReversals(2 * km),
    )

    def sign(heading):
        state = with_leaf(ORIGIN, lambda s: s.heading, heading)
        return corridor.update(TIME, seen(state), jnp.asarray(-1.0), None)

    heading = ORIGIN.heading - 0.01 - 1 * km / distance
    np.testing.assert_allclose(sign(heading), 0.0, atol=1e-9)
    slope = jax.grad(sign)(heading)
    # Twice the share, which falls as the heading rises.
    np.testing.assert_allclose(slope, -2.0 * distance / (2 * km), rtol=1e-9)


def test_lists_of_a_heading_corridor_must_fit():
    with pytest.raises(ValueError, match="two lists of one length"):
        corridor_to(0.0, 0.0, half_widths=[0.1])
    with pytest.raises(ValueError, match="two lists of one length"):
        corridor_to(0.0, 0.0, velocities=[], half_widths=[])
