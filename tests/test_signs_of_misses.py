"""Misses of one flight from targets that are off by known amounts, with their signs."""

import dataclasses
import functools
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import ahead, fly_compiled, free_scenario

from jentry.campaign.campaign import fly_run
from jentry.flight import FixedStep, Misses, Target, misses
from jentry.units import degree, km


START, HEADING = (20.0, 35.0), 60.0
"""Longitude and latitude, and the heading: none of them special, deg"""

RADIUS = 3397 * km


@functools.cache
def flown():
    """A flight to the north-east that banks to the right."""
    longitude, latitude = START
    scenario = eqx.tree_at(
        lambda s: [getattr(s.initial_state, n) for n in PLACE],
        free_scenario(50 * degree),
        [jnp.asarray(x * degree) for x in (longitude, latitude, HEADING)],
    )
    return scenario, fly_compiled(scenario, FixedStep(1.0))


PLACE = ("longitude", "latitude", "heading")


def upwards(longitude, latitude):
    return np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )


def along_and_left(state):
    """Arcs along the great circle of the start and to its left, by vectors, m."""
    origin = upwards(*np.radians(START))
    in_front = upwards(*np.radians(ahead(START, HEADING, 90.0)[:2]))
    place = upwards(float(state.longitude), float(state.latitude))
    left = place @ np.cross(origin, in_front)
    along = np.arctan2(place @ in_front, place @ origin)
    return RADIUS * along, RADIUS * np.arcsin(left)


OFF = {
    "downrange": 12 * km,
    "crossrange": -7 * km,
    "altitude": 0.3 * km,
    "velocity": -4.5,
    "flight_path_angle": 0.02,
    "heading": -0.03,
}
"""By how much the flight ends beyond its target"""


def aimed_off():
    scenario, flight = flown()
    downrange, crossrange = along_and_left(flight.state)
    ended = vars(flight.state) | {"downrange": downrange, "crossrange": crossrange}
    target = Target(**{name: float(ended[name]) - off for name, off in OFF.items()})
    return dataclasses.replace(scenario, target=target), flight


def test_each_miss_is_actual_minus_desired():
    missed = misses(*aimed_off())
    for name, off in OFF.items():
        # Rounding of an arc of 700 km, or of its angle.
        close = 1e-14 * RADIUS if name.endswith("range") else 1e-12
        assert float(getattr(missed, name)) == pytest.approx(off, abs=close), name


def test_to_the_right_is_negative_and_too_far_is_positive():
    scenario, flight = flown()
    downrange, crossrange = along_and_left(flight.state)
    assert downrange > 500 * km and crossrange < -10 * km
    # The shortest way is the one that is measured: at the end as at the start.
    here = dataclasses.replace(
        scenario, target=Target(flight.state.altitude, flight.state.velocity, 0.0)
    )
    missed = misses(here, flight)
    assert float(missed.downrange) == pytest.approx(downrange, rel=1e-12)
    assert float(missed.crossrange) == pytest.approx(crossrange, rel=1e-12)


def test_what_the_target_leaves_open_is_no_miss():
    scenario, flight = flown()
    missed = misses(scenario, flight)
    assert missed.flight_path_angle is None and missed.heading is None


def test_distance_is_of_place_alone_and_of_many_flights():
    missed = misses(*aimed_off())
    expected = np.sqrt(
        sum(OFF[n] ** 2 for n in ("downrange", "crossrange", "altitude"))
    )
    assert float(missed.distance) == pytest.approx(expected, rel=1e-11)
    many = jax.tree.map(lambda x: jnp.stack([x, 2.0 * x]), missed)
    np.testing.assert_allclose(many.distance, [expected, 2.0 * expected], rtol=1e-11)


def test_distance_has_a_derivative_also_on_the_target():
    def distance(downrange):
        nothing = jnp.zeros(())
        return Misses(downrange, nothing, nothing, nothing).distance

    for derivative in (jax.grad(distance), jax.jacfwd(distance)):
        assert float(derivative(jnp.asarray(0.0))) == 0.0
        assert float(derivative(jnp.asarray(-2.0))) == -1.0


def test_misses_of_a_run_are_counted_from_the_target_of_what_it_flew(monkeypatch):
    """Nothing is flown: what would be flown, and from where the misses are counted."""
    scenario, flight = flown()
    given = []

    def looked_at(scenario, solver, history):
        given.append((scenario, solver, history))
        return flight

    monkeypatch.setattr(sys.modules[fly_run.__module__], "fly", looked_at)
    inputs = {
        "initial_state.heading": jnp.asarray(1.0),
        "initial_state.altitude": jnp.asarray(120e3),
        "target.downrange": jnp.asarray(650e3),
        "planet.radius": jnp.asarray(3400e3),
    }
    found, counted = fly_run(scenario, inputs, FixedStep(0.3), 4.0)
    ((dispersed, solver, history),) = given
    assert found is flight and (solver, history) == (FixedStep(0.3), 4.0)
    assert float(dispersed.initial_state.heading) == 1.0
    assert float(dispersed.initial_state.altitude) == 120e3
    assert counted is dispersed
    assert eqx.tree_equal(counted.target.origin, scenario.target.origin)
    assert float(counted.target.downrange) == 650e3
    assert float(counted.planet.radius) == 3400e3
