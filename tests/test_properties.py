"""What any entry code must have: conserved quantities, symmetries, orders."""

import cartesian
import equinox as eqx
import numpy as np
import pytest
from helpers import (
    MARS_ROTATION,
    bank_profile,
    fly_compiled,
    free_scenario,
    mars_planet,
    mars_scenario,
    with_leaf,
)
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from jentry.flight import FixedStep, Outcome
from jentry.guidance import Sampled
from jentry.motion import EntryState
from jentry.units import degree, km


HOW = FixedStep(0.1), 1.0
"""Solver and history of every flight here: one structure, compiled once."""

MU, RADIUS = 4.28283e13, 3397 * km


def flight_from(state, bank_angle=50 * degree, rotation_rate=0.0, density_scale=1.0):
    """A flight in three dimensions; its end conditions leave 300 s for a Kepler arc."""
    scenario = free_scenario(bank_angle)
    scenario = eqx.tree_at(
        lambda s: (s.initial_state, s.planet),
        scenario,
        (
            state,
            mars_planet(rotation_rate=rotation_rate, density_scale=density_scale),
        ),
    )
    return fly_compiled(scenario, *HOW)


ENTRY = EntryState(126.1 * km, 0.3, -0.4, 6750.0, -14.4 * degree, 60 * degree)
ARC = EntryState(126.1 * km, 0.3, -0.4, 3300.0, -1.0 * degree, 60 * degree)
VACUUM = 1e-60
"""Factor on the density that leaves nothing of lift and drag"""


def kept(flight):
    """History of a flight while it flew: times, and named arrays of the state."""
    there = np.isfinite(flight.history.time)
    states = {
        name: np.asarray(value)[there]
        for name, value in vars(flight.history.states).items()
    }
    return np.asarray(flight.history.time)[there], EntryState(**states)


def vectors(states):
    """Positions and velocities, (n, 3) each, of the states of a history."""
    pairs = [
        cartesian.from_entry_state(RADIUS, EntryState(*numbers))
        for numbers in zip(*vars(states).values(), strict=True)
    ]
    position, velocity = zip(*pairs, strict=True)
    return np.array(position), np.array(velocity)


def test_energy_is_lost_to_drag_only():
    flight = flight_from(ENTRY)
    time, states = kept(flight)
    drag = np.asarray(flight.history.constraints.drag)[: len(time)]
    energy = states.velocity**2 / 2 - MU / (RADIUS + states.altitude)
    lost = CubicSpline(time, drag * states.velocity).antiderivative()(time)
    # A spline through points 1 s apart, of a drag that changes within 10 s: 1e-6 of all.
    scale = energy[0] - energy[-1]
    np.testing.assert_allclose(energy[0] - energy, lost, rtol=0, atol=1e-6 * scale)


def test_jacobi_integral_of_a_coasting_flight_over_a_turning_planet():
    flight = flight_from(ARC, rotation_rate=MARS_ROTATION, density_scale=VACUUM)
    assert flight.outcome == Outcome.TIMED_OUT
    _, states = kept(flight)
    distance = RADIUS + states.altitude
    spin = MARS_ROTATION * distance * np.cos(states.latitude)
    jacobi = states.velocity**2 / 2 - MU / distance - spin**2 / 2
    # Rounding of 3000 steps: a random walk of 1e-16, and RK4 with a step of 1e-4 orbits.
    np.testing.assert_allclose(jacobi, jacobi[0], rtol=1e-12)


def test_coasting_flight_is_a_kepler_arc():
    """Distance, speed and place at the end, from Kepler's equation."""
    flight = flight_from(ARC, density_scale=VACUUM)
    start, velocity = cartesian.from_entry_state(RADIUS, ARC)
    start, velocity = np.asarray(start), np.asarray(velocity)
    distance = np.linalg.norm(start)
    axis = 1.0 / (2.0 / distance - velocity @ velocity / MU)
    mean_motion = np.sqrt(MU / axis**3)
    sine, cosine = start @ velocity / np.sqrt(MU * axis), 1.0 - distance / axis
    turned = brentq(
        lambda E: (
            E
            - cosine * np.sin(E)
            + sine * (1.0 - np.cos(E))
            - mean_motion * float(flight.time)
        ),
        0.0,
        np.pi,
        xtol=1e-15,
        rtol=1e-14,
    )
    # Lagrange's coefficients over the change of the eccentric anomaly.
    f = 1.0 - axis / distance * (1.0 - np.cos(turned))
    g = float(flight.time) - (turned - np.sin(turned)) / mean_motion
    end, _ = cartesian.from_entry_state(RADIUS, flight.state)
    # 1e-11 of the distance is 0.03 mm: rounding of 3000 steps.
    np.testing.assert_allclose(
        end, f * start + g * velocity, rtol=0, atol=1e-11 * RADIUS
    )
    speed2 = MU * (2.0 / np.linalg.norm(end) - 1.0 / axis)
    np.testing.assert_allclose(flight.state.velocity, np.sqrt(speed2), rtol=1e-11)


@pytest.mark.parametrize("density_scale", [VACUUM, 1.0], ids=["coasting", "in air"])
def test_flight_without_bank_follows_a_great_circle(density_scale):
    flight = flight_from(ENTRY, bank_angle=0.0, density_scale=density_scale)
    position, velocity = vectors(kept(flight)[1])
    normal = np.cross(position, velocity)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    # Rounding of some thousand steps.
    np.testing.assert_allclose(normal, normal[:1].repeat(len(normal), 0), atol=1e-12)


def test_flight_is_the_same_wherever_it_starts():
    """A turned start gives the turned flight, on a planet that does not rotate."""
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    position, velocity = cartesian.from_entry_state(RADIUS, ENTRY)
    turned_start = cartesian.to_angles(RADIUS, turn @ position, turn @ velocity)
    flight, turned = flight_from(ENTRY), flight_from(EntryState(*turned_start))
    # The start is turned to rounding (altitude: of the distance, 1e-9 m), which drag and
    # lift enlarge some tenfold.
    np.testing.assert_allclose(turned.time, flight.time, rtol=1e-12)
    (_, one), (_, other) = kept(flight), kept(turned)
    np.testing.assert_allclose(other.altitude, one.altitude, atol=1e-6)
    np.testing.assert_allclose(other.velocity, one.velocity, rtol=1e-11)
    np.testing.assert_allclose(
        vectors(other)[0], vectors(one)[0] @ turn.T, atol=1e-12 * RADIUS * 10
    )


@pytest.mark.parametrize(
    "rotation_rate", [0.0, MARS_ROTATION], ids=["still", "turning"]
)
def test_mirrored_bank_flies_the_mirrored_flight(rotation_rate):
    start = EntryState(126.1 * km, 0.2, 0.0, 6750.0, -14.4 * degree, 90 * degree)
    right = flight_from(start, 50 * degree, rotation_rate)
    left = flight_from(start, -50 * degree, rotation_rate)
    assert right.state.latitude < -0.001  # to the right of east is south
    # Heading is 90 deg in floating point, of which the cosine is 6e-17: rounding.
    np.testing.assert_allclose(left.time, right.time, rtol=1e-13)
    for name in ("altitude", "longitude", "velocity", "flight_path_angle"):
        one, other = getattr(right.state, name), getattr(left.state, name)
        np.testing.assert_allclose(other, one, rtol=1e-12)
    np.testing.assert_allclose(left.state.latitude, -right.state.latitude, rtol=1e-11)
    np.testing.assert_allclose(
        left.state.heading - np.pi / 2, np.pi / 2 - right.state.heading, rtol=1e-11
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [bank_profile(), Sampled(bank_profile(), 4.0)],
    ids=["continuous", "zero-order hold"],
)
def test_fourth_order_up_to_the_event(law):
    """Halving the step divides the error by 16, where the velocity ends the flight.

    With the command held through cycles of 4 s the same holds: the steps fit into the
    cycles, and the last ones go to the end with the same method.
    """
    scenario = mars_scenario(law, time_limit=300.0)
    # Only the velocity ends it.
    scenario = with_leaf(
        scenario, lambda s: s.termination.conditions["altitude"].altitude, -1e6
    )

    def end(step):
        flight = fly_compiled(scenario, FixedStep(step))
        assert flight.outcome == Outcome.REACHED
        state = flight.state
        return np.array([flight.time, state.flight_path_angle, state.longitude])

    coarse, middle, fine = (end(step) for step in (1.0, 0.5, 0.25))
    ratio = (coarse - middle) / (middle - fine)
    # 10 %: the next order at this step. The changes are 1e4 times rounding. (Altitude is
    # left out: its leading error nearly vanishes here.)
    np.testing.assert_allclose(ratio, 16.0, rtol=0.1)
