"""Equations of motion of a user's own: one class, which flies, varies and is refused."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import mars_scenario, with_leaf

from jentry import fly, monte_carlo
from jentry.fields import Scalar, scalar
from jentry.flight import AltitudeBelow, FixedStep, Outcome, Termination
from jentry.motion import AbstractDynamics, EntryState
from jentry.motion.singularities import at_rest, step_is_too_long


class FlatGround(AbstractDynamics):
    """A projectile above flat ground without air."""

    gravity: Scalar = scalar(unit="m/s2", positive=True)

    constant = {"heading": 1.0}
    singular_points = (at_rest,)

    def rates(self, planet, vehicle, state, controls):
        sine, cosine = (
            jnp.sin(state.flight_path_angle),
            jnp.cos(state.flight_path_angle),
        )
        nothing = jnp.zeros_like(sine)
        return EntryState(
            altitude=state.velocity * sine,
            longitude=state.velocity * cosine / planet.radius,
            latitude=nothing,
            velocity=-self.gravity * sine,
            flight_path_angle=-self.gravity * cosine / state.velocity,
            heading=nothing,
        )


UP, ALONG, HEIGHT, GRAVITY = 300.0, 900.0, 5000.0, 3.7
"""Of the throw, m/s and m; and the gravity, m/s2"""


def thrown(heading=1.0, up=UP, along=ALONG):
    start = EntryState(
        HEIGHT, 0.0, 0.1, np.hypot(up, along), np.arctan2(up, along), heading
    )
    return dataclasses.replace(
        mars_scenario(dynamics=FlatGround(GRAVITY)),
        initial_state=start,
        termination=Termination({"ground": AltitudeBelow(0.0)}, 400.0),
    )


def test_a_projectile_falls_as_it_must():
    """The parabola, its duration and the derivative of that, in closed form."""
    scenario = thrown()

    @eqx.filter_jit
    def flown(gravity):
        other = with_leaf(scenario, lambda s: s.dynamics.gravity, gravity)
        flight = fly(other, FixedStep(0.1))
        return flight.time, flight

    (time, flight), slope = jax.jvp(flown, (jnp.asarray(GRAVITY),), (jnp.ones(()),))
    root = np.sqrt(UP**2 + 2.0 * GRAVITY * HEIGHT)
    duration = (UP + root) / GRAVITY
    # Of fourth order, in steps of 0.1 s: the path turns within some 100 s.
    np.testing.assert_allclose(time, duration, rtol=1e-9)
    np.testing.assert_allclose(slope[0], HEIGHT / (GRAVITY * root) - duration / GRAVITY)
    end, radius = flight.state, float(scenario.planet.radius)
    np.testing.assert_allclose(end.longitude * radius, ALONG * duration, rtol=1e-9)
    np.testing.assert_allclose(end.velocity, np.hypot(ALONG, root), rtol=1e-9)
    assert (end.latitude, end.heading) == (0.1, 1.0)


def test_it_varies_and_what_it_keeps_does_not():
    scenario = thrown()
    campaign = monte_carlo(
        scenario, inputs={"dynamics.gravity": [GRAVITY, 2.0 * GRAVITY]}
    )
    for gravity, time in zip(
        (GRAVITY, 2.0 * GRAVITY), np.asarray(campaign.flights.time), strict=True
    ):
        duration = (UP + np.sqrt(UP**2 + 2.0 * gravity * HEIGHT)) / gravity
        np.testing.assert_allclose(time, duration, rtol=1e-9)
    with pytest.raises(
        ValueError, match=r"heading has no effect .* FlatGround holds it"
    ):
        monte_carlo(scenario, inputs={"initial_state.heading": [1.0]})
    with pytest.raises(
        ValueError, match=r"heading is 114.592 deg: FlatGround holds it at 57.2958 deg;"
    ):
        fly(thrown(heading=2.0))


def test_it_stops_where_it_is_singular_and_only_there():
    """Straight up and down again is a way through rest. The heading is of no concern."""
    at_the_top = fly(thrown(along=1e-3), FixedStep(0.1))
    assert Outcome(int(at_the_top.outcome)) is Outcome.SINGULAR
    # Within ten steps: from there on they turn, over a way that is next to none.
    np.testing.assert_allclose(at_the_top.time, UP / GRAVITY, rtol=0.0, atol=1.0)
    assert Outcome(int(fly(thrown(along=100.0)).outcome)) is Outcome.REACHED


def test_motion_without_singular_points():
    state = thrown().initial_state
    below = dataclasses.replace(state, velocity=-1.0)
    assert not step_is_too_long(state, below, ())
    assert FlatGround(GRAVITY).is_singular(state, below)
