"""What the neural law reads: its inputs, their derivatives, and the flow."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from great_circles import by_trigonometry
from helpers import fly_compiled
from neural_laws import (
    ANGLES,
    MIDDLE,
    SOLVER,
    aim_of,
    flown,
    law_of,
    network_of,
    read_at,
    scenario_of,
    sensed,
    state_at,
)
from winds_on_board import STATE, WINDS, air_velocity, sensed as sensed_in

from jentry.guidance.neural_law import (
    INPUTS,
    inputs_of,
)
from jentry.missions.mars.drag_tracking import entry
from jentry.onboard import (
    FlowSensors,
)
from jentry.units import degree, km


@pytest.mark.parametrize("wind", WINDS)
def test_the_drag_of_the_model_is_that_in_its_wind(wind):
    """In the wind of the model and of the air alike the drag is that of the model."""
    law, wind = law_of(), WINDS[wind]
    model = dataclasses.replace(
        law.model, planet=dataclasses.replace(law.model.planet, wind=wind)
    )
    aim = aim_of(law)
    law = dataclasses.replace(law, model=model)
    read = inputs_of(model, aim, sensed(STATE, law=law), jnp.asarray(0.0))
    read = dict(zip(INPUTS, np.asarray(read), strict=True))
    density = 0.0158 * np.exp(-float(STATE.altitude) / 9354.5)
    drag = 0.5 * density * np.sum(air_velocity(wind) ** 2) / 115.0
    unit = 6750.0**2 / (723.32 * km)
    expected = np.log(np.hypot(drag / unit, 1e-3))
    assert read["ln of the drag of the model"] == pytest.approx(expected, abs=1e-10)
    assert read["ln of the sensed drag, over that of the model"] == 0.0
    still = 0.5 * density * float(STATE.velocity) ** 2 / 115.0
    assert abs(drag / still - 1.0) > 1e-3


BLOWN = {"head": (-50.0, 0.0), "side": (0.0, -50.0)}
"""Wind along the heading and to its right, m/s"""


@pytest.mark.parametrize("wind", BLOWN)
def test_a_law_reads_the_wind_from_the_flow(wind):
    """Behind its other inputs, over a hundredth of the velocity of the origin."""
    law = law_of(reads_flow=True, angles=ANGLES)
    sensors = FlowSensors(least_dynamic_pressure=0.0)
    law = dataclasses.replace(law, aim=aim_of(law))
    read = law.reads(sensed_in(WINDS[wind], sensors), jnp.asarray(0.2))
    expected = [1.0, *(x / 67.5 for x in BLOWN[wind])]
    np.testing.assert_allclose(read[-3:], expected, atol=1e-12)
    plain = dataclasses.replace(law_of(angles=ANGLES), aim=law.aim)
    others = plain.reads(sensed_in(WINDS[wind]), jnp.asarray(0.2))
    np.testing.assert_array_equal(read[:-3], others)
    thin = FlowSensors(least_dynamic_pressure=1e9)
    unseen = law.reads(sensed_in(WINDS[wind], thin), jnp.asarray(0.2))
    np.testing.assert_array_equal(unseen[-3:], 0.0)


def test_a_law_that_reads_the_flow_needs_sensors_and_a_network_for_them():
    with pytest.raises(ValueError, match="give the scenario flow_sensors, such as"):
        flown(law_of(reads_flow=True))
    with pytest.raises(ValueError, match="it lacks 'whether the flow is sensed'"):
        law_of(network_of(), reads_flow=True)
    with pytest.raises(ValueError, match="the law has no 'whether the flow is sensed'"):
        law_of(network_of(flow=True))


@pytest.mark.slow
def test_the_flow_changes_the_flight_where_it_is_sensed():
    law = law_of(reads_flow=True, network=network_of(flow=True, size=20.0))
    ends = []
    for pressure in (850.0, 1e9):
        scenario = dataclasses.replace(
            scenario_of(law), flow_sensors=FlowSensors(least_dynamic_pressure=pressure)
        )
        flight = fly_compiled(scenario, SOLVER, None)
        assert np.isfinite(float(flight.state.longitude))
        ends.append(float(flight.state.longitude))
    assert abs(ends[0] - ends[1]) > 1e-5


ENTRY = {
    "altitude": 126.1 * km,
    "velocity": 6750.0,
    "flight_path_angle": -14.4 * degree,
}


def periapsis(altitude, velocity, flight_path_angle, **others):
    """By energy and angular momentum, in vectors: least radius of a Kepler orbit, m."""
    parameter = float(entry().planet.gravity.gravitational_parameter)
    radius = 3397.0 * km + altitude
    place = np.array([radius, 0.0])
    speed = velocity * np.array([np.sin(flight_path_angle), np.cos(flight_path_angle)])
    momentum = radius * speed[1]
    pull = place * (speed @ speed - parameter / radius) - speed * (place @ speed)
    eccentricity = np.hypot(np.linalg.norm(pull) / parameter, 1e-3)
    return momentum**2 / parameter / (1.0 + eccentricity)


def test_the_inputs_are_those_of_their_formulas():
    """Every input by numpy, of the state, the target and an exponential atmosphere."""
    read = read_at(state_at(**MIDDLE), bank=0.7, lift_factor=1.1, drag_factor=0.9)
    speed, length, radius = 6750.0, 723.32 * km, 3397.0 * km
    here = MIDDLE["longitude"], MIDDLE["latitude"], MIDDLE["heading"]
    ahead, left = by_trigonometry(radius, here, (length / radius, 0.0))
    density = 0.0158 * np.exp(-MIDDLE["altitude"] / 9354.5)
    drag = 0.5 * density * MIDDLE["velocity"] ** 2 / 115.0
    unit = speed**2 / length

    def ln(force):
        return np.log(np.hypot(force / unit, 1e-3))

    to_go = np.hypot(ahead / length, 0.003)
    square, end = (MIDDLE["velocity"] / speed) ** 2, (503.0 / speed) ** 2
    excess = 0.5 * (square - end + np.hypot(square - end, 0.1 * end))
    needed = np.log(0.5 * excess / to_go)
    expected = [
        MIDDLE["velocity"] / speed,
        np.log(MIDDLE["velocity"] / speed),
        (MIDDLE["altitude"] - 10.0 * km) / (126.1 * km),
        MIDDLE["flight_path_angle"],
        ahead / length,
        np.tanh(ahead / length / 0.03),
        -left / length / to_go,
        -left / length / 0.02,
        needed,
        needed - ln(drag),
        ln(drag),
        ln(0.9 * drag) - ln(drag),
        ln(1.1 * 0.18 * drag) - ln(0.18 * drag),
        np.sin(0.7),
        np.cos(0.7),
        np.tanh((periapsis(**MIDDLE) - periapsis(**ENTRY)) / (0.1 * 126.1 * km)),
        # The plane of origin and aim is the equator: its normal points to the north.
        -np.cos(MIDDLE["latitude"]) * np.cos(MIDDLE["heading"]),
    ]
    np.testing.assert_allclose(list(read.values()), expected, rtol=1e-10)


@pytest.mark.parametrize("more", [-0.3, 0.05, 0.2])
def test_a_shallow_entry_has_a_higher_periapsis(more):
    """By some degrees at the entry, in a Kepler orbit."""
    moved = ENTRY | {"flight_path_angle": ENTRY["flight_path_angle"] + more * degree}
    read = read_at(state_at(**moved))
    found = read["periapsis of a free flight, close to that of the aim's origin"]
    expected = np.tanh((periapsis(**moved) - periapsis(**ENTRY)) / (0.1 * 126.1 * km))
    assert found == pytest.approx(expected, rel=1e-9)
    assert 0.05 < abs(found) < 0.95 and np.sign(found) == np.sign(more)


@pytest.mark.parametrize(
    "moved",
    [
        {},
        {"altitude": 400.0 * km},
        {"velocity": 200.0, "altitude": 9.0 * km},
        {"longitude": 723.32 / 3397.0},
        {"longitude": 730.0 / 3397.0, "latitude": 0.0},
    ],
)
def test_inputs_and_their_derivatives_are_finite_everywhere(moved):
    """Above the air, slower than the aim, over the target and beyond it."""
    law = law_of()
    aim, state = aim_of(law), state_at(**{**MIDDLE, **moved})

    def read(state):
        return inputs_of(law.model, aim, sensed(state), jnp.asarray(0.1))

    value, slopes = read(state), jax.jacfwd(read)(state)
    assert np.all(np.isfinite(value))
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slopes))


def test_a_place_to_the_right_is_a_positive_number():
    """The heading is east: south is to the right."""
    read = read_at(
        state_at(**{**MIDDLE, "latitude": 0.5 * degree, "heading": math.pi / 2})
    )
    assert read["range to the right"] > 0.0
    assert read[COURSE] == pytest.approx(0.0, abs=1e-12)
    south = read_at(
        state_at(**{**MIDDLE, "latitude": 0.5 * degree, "heading": 0.6 * math.pi})
    )
    assert south[COURSE] > 0.1
    assert read["range to the right, over the distance to go"] > 0.0


COURSE = "sine of the course to the right of the plane of origin and aim"

ORIGIN = {"longitude": 0.3, "latitude": -0.4, "heading": 0.9}


def direction(longitude, latitude):
    """Unit vector from the centre of the planet, and those to the east and the north."""
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    out = np.array([np.cos(longitude), np.sin(longitude), 0.0]) * np.cos(latitude)
    out[2] = np.sin(latitude)
    return out, east, np.cross(out, east)


def course(origin, angle, across, state):
    """Component of the level course along the normal of the plane of origin and aim, over
    the sine of the downrange, by vectors; the crossrange of the aim is to the left."""
    up, east, north = direction(origin["longitude"], origin["latitude"])
    ahead = np.sin(origin["heading"]) * east + np.cos(origin["heading"]) * north
    aim = np.cos(angle) * up + np.sin(angle) * ahead
    aim = np.cos(across) * aim + np.sin(across) * np.cross(up, ahead)
    _, east, north = direction(state["longitude"], state["latitude"])
    level = np.sin(state["heading"]) * east + np.cos(state["heading"]) * north
    return -np.cross(up, aim) @ level / np.sin(angle)


@jax.jit
def read_course(origin, angle, across, state):
    law, start = law_of(), entry().initial_state
    origin, state = (dataclasses.replace(start, **x) for x in (origin, state))
    aim = dataclasses.replace(
        aim_of(law),
        origin=origin,
        downrange=angle * law.model.planet.radius,
        crossrange=across * law.model.planet.radius,
    )
    read = inputs_of(law.model, aim, sensed(state), jnp.asarray(0.0))
    return read[INPUTS.index(COURSE)]


def as_arrays(numbers):
    return {name: jnp.asarray(x) for name, x in numbers.items()}


@pytest.mark.parametrize("angle, across", [(0.37, 8e-4), (1.2, -0.01), (2.9, 0.0)])
def test_the_course_is_that_from_the_plane_of_origin_and_aim(angle, across):
    state = {"longitude": 0.8, "latitude": 0.2, "heading": 2.1}
    found = read_course(
        as_arrays(ORIGIN), jnp.asarray(angle), jnp.asarray(across), as_arrays(state)
    )
    expected = course(ORIGIN, angle, across, state)
    assert float(found) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("moved", [{}, {"latitude": 0.0, "heading": math.pi / 2}])
@pytest.mark.slow
def test_the_course_is_regular_at_the_antipode_and_without_a_downrange(moved):
    """There it is that from the plane of the origin's course, also for an aim aside."""
    origin = ORIGIN | moved
    state = as_arrays({"longitude": 0.8, "latitude": 0.2, "heading": 2.1})
    expected = course(origin, 1.0, 0.0, state)  # no crossrange: the same at any angle
    slopes = jax.jit(jax.jacfwd(jax.jacrev(read_course, (0, 1, 2, 3)), (0, 1, 2, 3)))
    for angle in (0.0, math.pi):
        for across in (0.0, 8e-4):
            numbers = jnp.asarray(angle), jnp.asarray(across)
            found = read_course(as_arrays(origin), *numbers, state)
            there = math.cos(across) * expected
            assert float(found) == pytest.approx(there, abs=1e-12)
            if angle == 0.0:  # the other inputs are over the downrange
                continue
            second = slopes(as_arrays(origin), *numbers, state)
            assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(second))


def test_the_course_is_bounded_beside_the_antipode():
    """The plane turns by less than half a right angle for an aim that is aside."""
    state = as_arrays({"longitude": 0.8, "latitude": 0.2, "heading": 2.1})
    angles = math.pi + np.concatenate([-np.logspace(-9, -1), np.logspace(-9, -1)])
    many = jax.vmap(read_course, (None, 0, None, None))
    found = many(as_arrays(ORIGIN), jnp.asarray(angles), jnp.asarray(0.01), state)
    assert np.max(np.abs(found)) < math.sqrt(2.0)
