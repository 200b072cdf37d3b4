"""Lateral logic: where the flight would pass, and which way it is banked."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_entry, mars_planet

from jentry.guidance import LateralCorridor
from jentry.guidance.lateral import predicted_crossrange, reverse_bank
from jentry.guidance.open_loop import vertical_lift_command
from jentry.motion import EntryState, ground_track
from jentry.units import degree, km


ORIGIN = eqx.tree_at(
    lambda s: (s.longitude, s.latitude, s.heading),
    mars_entry(),
    tuple(jnp.asarray(x * degree) for x in (20.0, 35.0, 60.0)),
)


def after(planet, state, distance):
    """The point at a distance along the great circle: the textbook formula."""
    angle = distance / planet.radius
    latitude = jnp.arcsin(
        jnp.sin(state.latitude) * jnp.cos(angle)
        + jnp.cos(state.latitude) * jnp.sin(angle) * jnp.cos(state.heading)
    )
    longitude = state.longitude + jnp.arctan2(
        jnp.sin(state.heading) * jnp.sin(angle) * jnp.cos(state.latitude),
        jnp.cos(angle) - jnp.sin(state.latitude) * jnp.sin(latitude),
    )
    return eqx.tree_at(
        lambda s: (s.longitude, s.latitude), state, (longitude, latitude)
    )


def turned(state: EntryState, angle):
    return eqx.tree_at(lambda s: s.heading, state, state.heading + angle)


@pytest.mark.parametrize("angle", [-3.0, -0.2, 0.4, 2.0])
@pytest.mark.parametrize("distance", [0.0, 100 * km, 700 * km])
def test_prediction_is_where_the_great_circle_leads(angle, distance):
    planet = mars_planet()
    # Somewhere near the entry plane: on a great circle 1 degree off, 60 km from its start.
    state = turned(after(planet, turned(ORIGIN, degree), 60 * km), angle * degree)
    distance = jnp.asarray(distance)
    predicted = predicted_crossrange(planet, ORIGIN, state, distance)
    _, crossrange = ground_track(planet, ORIGIN, after(planet, state, distance))
    # What is left out is crossrange^3 / (6 radius^2), 0.4 m at 30 km.
    assert abs(predicted - crossrange) < 1.0
    assert abs(ground_track(planet, ORIGIN, state)[1]) > 1 * km


def test_straight_ahead_there_is_no_crossrange():
    predicted = predicted_crossrange(
        mars_planet(), ORIGIN, ORIGIN, jnp.asarray(700 * km)
    )
    assert abs(predicted) < 1e-6  # rounding of the planet's radius


def test_bank_is_reversed_outside_of_the_corridor_only():
    sign = jax.vmap(reverse_bank, in_axes=(0, 0, None))
    before = jnp.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    crossrange = jnp.array([0.9, -0.9, 1.1, 1.1, -1.1, -1.1])
    # Left of the corridor it turns to the right, which is positive.
    wanted = [1.0, -1.0, 1.0, 1.0, -1.0, -1.0]
    np.testing.assert_array_equal(sign(before, crossrange, jnp.asarray(1.0)), wanted)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_the_edge_of_the_corridor_the_bank_stays(side, sign):
    edge = jnp.asarray(1.0)
    just_beyond = jnp.asarray(side * np.nextafter(1.0, 2.0))
    assert reverse_bank(jnp.asarray(sign), side * edge, edge) == sign
    assert reverse_bank(jnp.asarray(sign), just_beyond, edge) == side


def test_the_choice_of_a_side_has_no_derivative():
    gradient = jax.grad(reverse_bank, argnums=(0, 1, 2))
    assert gradient(jnp.asarray(1.0), jnp.asarray(-2.0), jnp.asarray(1.0)) == (0, 0, 0)


def test_corridor_narrows_with_velocity_to_its_floor():
    corridor = LateralCorridor(floor=300.0, widening=4e-4)
    assert corridor.half_width(jnp.asarray(0.0)) == 300.0
    assert corridor.half_width(jnp.asarray(5000.0)) == 300.0 + 4e-4 * 25e6


@pytest.mark.parametrize("cos_bank", [-1.3, -0.4, 0.7, 1.3])
def test_bank_to_the_left_mirrors_bank_to_the_right(cos_bank):
    angle_of_attack = jnp.asarray(0.0)
    right = vertical_lift_command(jnp.asarray(cos_bank), angle_of_attack)
    left = vertical_lift_command(jnp.asarray(cos_bank), angle_of_attack, -1.0)
    assert left.cos_bank == right.cos_bank
    assert left.sin_bank == -right.sin_bank
    assert right.sin_bank >= 0.0
