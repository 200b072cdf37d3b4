"""Flights over a pole, through the vertical and through rest, integrated as vectors."""

import cartesian
import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from vector_cases import (
    BELOW,
    CASES,
    FROM_EQUATOR,
    FROM_POLE,
    FROM_VERTICAL,
    MU,
    ORDINARY,
    RADIUS,
    SINGULAR,
    VACUUM,
    fly_all,
    lane_of,
)

from jentry.flight import Outcome
from jentry.motion import EntryDynamics, VectorDynamics
from jentry.units import degree


@pytest.fixture(scope="module")
def flights():
    """The flights of all cases, by one compiled program."""
    return fly_all(CASES, VectorDynamics())


@pytest.fixture(scope="module")
def angles():
    """The same flights with altitude and angles."""
    return fly_all(CASES, EntryDynamics())


def place_of(case):
    return next(i for i, other in enumerate(CASES) if other is case)


def of(flights, case):
    return lane_of(flights, place_of(case))


@pytest.mark.parametrize("name", SINGULAR)
def test_passes_agree_with_an_independent_integration(flights, name):
    case = SINGULAR[name]
    flight = of(flights, case)
    falls = case.ground > BELOW
    assert int(flight.outcome) == (Outcome.CRASHED if falls else Outcome.TIMED_OUT)
    position, velocity = case.expected(flight.time)
    found = cartesian.from_entry_state(RADIUS, jax.tree.map(float, flight.state), np)
    # RK4 with 0.1 s on changes within some 10 s: 1e-8 of the changes of 1e3 m and m/s.
    assert np.linalg.norm(found[0] - position) < 2e-5
    assert np.linalg.norm(found[1] - velocity) < 1e-6
    for leaf in jax.tree.leaves(flight):
        assert np.all(np.isfinite(leaf))


def test_the_cases_are_singular_with_angles(angles):
    """Those that come to a singular point itself, and none of the ordinary ones."""
    for name in ("through a pole", "up and down", "in a head wind without lift"):
        assert int(of(angles, SINGULAR[name]).outcome) == Outcome.SINGULAR
    assert not any(
        int(of(angles, case).outcome) == Outcome.SINGULAR for case in ORDINARY
    )


def test_ordinary_flights_are_those_of_entry_dynamics(flights, angles):
    """Longitude and heading count the same turns, and the peaks are equal."""
    for case in ORDINARY:
        found, expected = of(flights, case), of(angles, case)
        assert found.outcome == expected.outcome
        # Both err by 1e-9 of their changes, in steps of 0.1 s: 1e-6 m of 1e6 m.
        for name, close in (
            ("altitude", 1e-6),
            ("longitude", 1e-12),
            ("latitude", 1e-12),
            ("velocity", 1e-8),
            ("flight_path_angle", 1e-10),
            ("heading", 1e-10),
        ):
            pair = getattr(found.state, name), getattr(expected.state, name)
            np.testing.assert_allclose(*pair, rtol=0.0, atol=close, err_msg=name)
        for name, peak in found.peaks.items():
            np.testing.assert_allclose(peak, expected.peaks[name], rtol=1e-9)
    # Over the branch of the arc tangent.
    assert of(flights, ORDINARY[0]).state.longitude > np.pi
    assert of(flights, ORDINARY[1]).state.longitude < -np.pi


@pytest.mark.slow
def test_a_batch_is_the_flights_alone(flights):
    for case in (SINGULAR["over a pole"], SINGULAR["a fall from rest"]):
        alone = fly_all([case], VectorDynamics())
        together = of(flights, case)
        for one, other in zip(
            jax.tree.leaves(alone), jax.tree.leaves(together), strict=True
        ):
            # Another order of fusion: rounding, which 2000 steps add up.
            np.testing.assert_allclose(one[0], other, rtol=1e-11, atol=1e-9)


def test_a_throw_through_rest_keeps_time_and_energy(flights):
    """Kepler's equation of a straight orbit, up to the highest point and down again."""
    flight, start = of(flights, VACUUM), VACUUM.state
    first, speed = RADIUS + float(start.altitude), float(start.velocity)
    last = RADIUS + VACUUM.ground
    axis = 1.0 / (2.0 / first - speed**2 / MU)

    def since_rest(radius):
        anomaly = np.arccos(1.0 - radius / axis)
        return np.sqrt(axis**3 / MU) * (np.pi - anomaly + np.sin(anomaly))

    # Differences of arcs near pi, of which the rounding of 1e-16 counts for 1e-7 s.
    time = since_rest(first) + since_rest(last)
    np.testing.assert_allclose(flight.time, time, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(flight.state.velocity, speed, rtol=1e-8)
    np.testing.assert_allclose(flight.state.flight_path_angle, -90 * degree)
    for name in ("longitude", "latitude"):
        np.testing.assert_allclose(
            getattr(flight.state, name), getattr(start, name), rtol=1e-13
        )


def test_a_start_at_a_pole_is_one_at_the_equator(flights):
    """Over a sphere at rest all places are equal; the heading counts at the longitude."""
    pole, equator = of(flights, FROM_POLE).state, of(flights, FROM_EQUATOR).state
    for name in ("altitude", "velocity", "flight_path_angle"):
        np.testing.assert_allclose(
            getattr(pole, name), getattr(equator, name), rtol=1e-12
        )
    # North at the longitude 0.7 points over the pole, to the longitude 0.7 + pi.
    start = FROM_POLE.state
    turn = pole.longitude - (start.longitude + np.pi - start.heading)
    assert abs(np.sin(turn)) < 1e-12 < np.cos(turn)
    np.testing.assert_allclose(pole.latitude, np.pi / 2 - equator.longitude)
    np.testing.assert_allclose(np.cos(pole.heading), -1.0)


def flown_in_a_plane(case, time):
    """Altitude, arc, velocity and path angle, of a flight with its lift in the vertical
    plane over a sphere at rest."""

    def rate(_, y):
        altitude, _, velocity, path = y
        density = 0.0158 * np.exp(-altitude / 9354.5)
        drag = 0.5 * density * velocity**2 / 115.0
        radius = RADIUS + altitude
        gravity, level = MU / radius**2, velocity * np.cos(path)
        return (
            velocity * np.sin(path),
            level / radius,
            -drag - gravity * np.sin(path),
            (case.lift_to_drag * drag - gravity * np.cos(path)) / velocity
            + level / radius,
        )

    start = case.state
    first = start.altitude, 0.0, start.velocity, start.flight_path_angle
    span = 0.0, float(time)
    first = [float(x) for x in first]
    solved = solve_ivp(rate, span, first, "DOP853", rtol=1e-12, atol=1e-12)
    return solved.y[:, -1]


def test_a_start_in_the_vertical_takes_its_heading(flights):
    """The lift turns it towards the heading of the start."""
    flight, start = of(flights, FROM_VERTICAL), FROM_VERTICAL.state
    altitude, arc, velocity, path = flown_in_a_plane(FROM_VERTICAL, flight.time)
    np.testing.assert_allclose(altitude, FROM_VERTICAL.ground, atol=1e-5)
    np.testing.assert_allclose(flight.state.velocity, velocity, rtol=1e-9)
    np.testing.assert_allclose(flight.state.flight_path_angle, path, rtol=1e-9)
    first, last = (
        cartesian.from_entry_state(RADIUS, jax.tree.map(float, state), np)[0]
        for state in (start, flight.state)
    )
    east, north, _ = cartesian.local_axes(first)
    heading = float(start.heading)
    ahead = np.sin(heading) * east + np.cos(heading) * north
    assert arc > 1e-5
    # The horizontal speed at the start is 2e-13 m/s by rounding, in any direction.
    np.testing.assert_allclose(
        last @ ahead / cartesian.norm(last), np.sin(arc), rtol=1e-9
    )
    np.testing.assert_allclose(flight.state.heading, heading, atol=1e-4)
