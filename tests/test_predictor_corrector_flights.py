"""Flights of the predictor-corrector: campaigns, derivatives, tuning, great circles."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import with_leaf
from predictor_correctors import in_plane, number, predicted
from scipy.integrate import solve_ivp

from jentry.campaign import monte_carlo
from jentry.flight import fly, misses
from jentry.missions import find_mission
from jentry.missions.mars.drag_tracking import entry, independent
from jentry.onboard import measure


def test_a_plane_over_a_planet_that_turns_is_that_of_the_great_circle():
    """By scipy: polar coordinates in the plane, of the air that turns with the planet."""
    mission = find_mission("cav-h-glide").scenario("undamped")
    planet, craft, law = mission.planet, mission.vehicle, mission.law
    turns, heading, latitude = float(planet.rotation_rate), 1.1, 0.5
    state = dataclasses.replace(
        mission.initial_state,
        altitude=jnp.asarray(46e3),
        latitude=jnp.asarray(latitude),
        velocity=jnp.asarray(6000.0),
        flight_path_angle=jnp.asarray(-1e-3),
        heading=jnp.asarray(heading),
    )
    seen = measure(planet, craft, state, craft.trim_angle_of_attack)
    law = dataclasses.replace(law, step=4.0, steps=600)
    found = predicted(law, seen, jnp.array([0.25]), 1.0, False)
    # The axis of the great circle, by vectors: longitude zero is as good as any.
    here = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    north = np.array([-np.sin(latitude), 0.0, np.cos(latitude)])
    axis = np.cross(
        here, np.sin(heading) * np.array([0, 1, 0]) + np.cos(heading) * north
    )
    rate, area = turns * axis[2], float(craft.reference_area / craft.mass)
    radius = float(planet.radius)
    parameter = float(planet.gravity.gravitational_parameter)
    lift, drag = (
        float(getattr(craft.aerodynamics, f"{n}_coefficient")) for n in ("lift", "drag")
    )
    last = float(law.end.energy)
    first = 0.5 * 6000.0**2 - parameter / (radius + 46e3)

    def relative(y):
        return np.array([y[2], y[0] * (y[3] - rate)])

    def energy(y):
        return 0.5 * np.sum(relative(y) ** 2) - parameter / y[0]

    def slope(_, y):
        rise, along = relative(y)
        speed, density = (
            np.hypot(rise, along),
            1.225 * np.exp(-0.14e-3 * (y[0] - radius)),
        )
        share = (energy(y) - first) / (last - first)
        bank = np.pi / 2 * 0.75 + share * (np.pi / 3 - np.pi / 2 * 0.75)
        push = 0.5 * density * speed * area
        up = push * (lift * np.cos(bank) * along - drag * rise)
        ahead = push * (-lift * np.cos(bank) * rise - drag * along)
        climbs = up - parameter / y[0] ** 2 + y[0] * y[3] ** 2
        return [y[2], y[3], climbs, (ahead - 2.0 * y[2] * y[3]) / y[0]]

    def spent(_, y):
        return energy(y) - last

    spent.terminal = True
    level = 6000.0 * np.cos(1e-3)
    start = [radius + 46e3, 0.0, -6000.0 * np.sin(1e-3), rate + level / (radius + 46e3)]
    solved = solve_ivp(
        slope, (0, 2400), start, method="DOP853", rtol=1e-10, atol=1e-12, events=spent
    )
    end = solved.y[:, -1]
    # Steps of 4 s, of fourth order.
    assert float(found.time) == pytest.approx(solved.t[-1], rel=1e-5)
    along = end[1] - rate * solved.t[-1]
    assert float(found.state.longitude) == pytest.approx(along, rel=1e-5)
    assert float(found.state.altitude) == pytest.approx(end[0] - radius, abs=10.0)
    still = with_leaf(law, lambda law: law.model.planet.rotation_rate, 0.0)
    found = predicted(still, seen, jnp.array([0.25]), 1.0, False)
    assert float(found.state.longitude) < 0.97 * along


@functools.cache
def campaign():
    return monte_carlo(in_plane(), independent(), jax.random.key(0), 64)


@pytest.mark.slow
def test_every_vehicle_that_can_reach_the_target_does():
    flown = monte_carlo(entry(), independent(), jax.random.key(0), 64)
    reaches = flown.misses.downrange > 0.0
    assert 55 <= np.sum(reaches) < 64
    off = np.abs(campaign().misses.downrange)
    assert np.max(off[reaches]) < 1.0
    # The others come nearly as near as with all of their lift up, from the start on.
    lost = (flown.misses.downrange - campaign().misses.downrange)[~reaches]
    assert np.all(np.abs(lost) < 150.0)


@pytest.mark.slow
def test_a_run_of_a_campaign_is_the_flight_alone():
    flown = campaign()
    for i in (3, 40):
        alone = in_plane()
        for address, values in flown.inputs.items():
            where = functools.partial(_at, address)
            alone = with_leaf(alone, where, values[i])
        ended = misses(alone, fly(alone))
        assert float(ended.altitude) == pytest.approx(
            float(flown.misses.altitude[i]), abs=1e-3
        )


def _at(address, scenario):
    for name in address.split("."):
        scenario = getattr(scenario, name)
    return scenario


@pytest.mark.slow
def test_derivative_through_all_predictions_is_that_of_differences():
    """Of the duration: the range is met whatever the vehicle is, and here the altitude."""
    scenario = in_plane()

    def duration(mass):
        return fly(with_leaf(scenario, lambda s: s.vehicle.mass, mass)).time

    pushed = jax.jit(lambda mass: jax.jvp(duration, (mass,), (jnp.ones(()),)))
    at, step = 1000.0, 0.05
    _, slope = pushed(number(at))
    beside = [float(pushed(number(at + x * step))[0]) for x in (1, -1, 0.5, -0.5)]
    wide, narrow = (beside[0] - beside[1]) / (2 * step), (beside[2] - beside[3]) / step
    numeric = narrow + (narrow - wide) / 3.0
    assert numeric < -0.05
    # Rounding of 222 s over 0.05 kg.
    assert float(slope) == pytest.approx(numeric, rel=1e-6)
    pulled = jax.jit(jax.grad(duration))(number(at))
    assert float(pulled) == pytest.approx(float(slope), rel=1e-9)
