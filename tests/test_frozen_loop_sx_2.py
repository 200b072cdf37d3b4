"""The frozen loop of SX-2: assigned eigenvalues and transmission zeros."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sx_2_by_hand as by_hand
from eigenvalues import assert_same_set
from scipy import linalg

from jentry import find_mission
from jentry.analysis import linearize
from jentry.analysis.local_derivatives import fly_points
from jentry.flight import FixedStep, Scenario
from jentry.flight.sensing import command
from jentry.missions.sx_2 import scenario as sx_2
from jentry.motion.index import EnergyIndex
from jentry.units import degree
from jentry.world import PolynomialAerodynamics


SLOW = pytest.mark.slow


def constant_drag_scenario() -> Scenario:
    """SX-2 with a drag that does not depend on the angle of attack, on board and off it.

    Polynomials as long as those of the mission, for which the programs are the same.
    """
    aerodynamics = PolynomialAerodynamics(
        jnp.array([-0.0448, 2.5457]), jnp.array([0.5, 0.0, 0.0])
    )
    vehicle = dataclasses.replace(sx_2.vehicle(), aerodynamics=aerodynamics)
    model = eqx.tree_at(lambda m: m.onboard.vehicle, sx_2.track_model(), vehicle)
    entry = dataclasses.replace(sx_2.entry(), vehicle=vehicle)
    first, last = sx_2.energies()
    beyond = last + sx_2.FIRST_SHARE * (first - last)
    table = sx_2._plan(entry, model, last, beyond).table
    law = sx_2.GroundTrackTracking(model, table, sx_2.gains(), sx_2.band())
    full = find_mission("sx-2").scenario("full")
    return dataclasses.replace(full, vehicle=vehicle, guidance=law)


@SLOW
def test_sx_2_has_its_assigned_eigenvalues_where_the_drag_is_that_of_the_law():
    loop = linearize(constant_drag_scenario(), EnergyIndex(), 12)
    assert set(loop.coordinates) == {
        *("e1", "e1'", "e1''", "e2", "e2'"),
        *("memory.downrange", "memory.crossrange"),
    }
    per_span = loop.per_span
    # Level, and along the equator: no lift appears too early. A triple pair is sensitive.
    first = np.poly([-18.0, -8.0, -8.0, -0.1, -30.0, -1.2, -1.2])
    np.testing.assert_allclose(np.poly(per_span[0]).real, first, rtol=1e-6)
    for found in per_span:
        for value, count in ((-30.0, 1), (-1.2, 2)):
            assert np.sum(np.abs(found - value) < 1e-3) == count


@pytest.fixture(scope="module")
def full_loop():
    return linearize(find_mission("sx-2").scenario("full"), EnergyIndex(), 12)


@SLOW
def test_zeros_of_sx_2_are_those_of_differences_of_the_motion_by_hand(full_loop):
    """At equal energy: altitude, track, path and heading, under two inputs."""
    scenario = find_mission("sx-2").scenario("full")
    # As it was flown for its loop.
    flown = fly_points(scenario, EnergyIndex(), 12, FixedStep())
    np.testing.assert_array_equal(flown.time, full_loop.time)
    for point in (3, 8, 10):
        lane = jax.tree.map(lambda x, point=point: x[point], flown.lanes)
        s = jax.tree.map(float, lane.state)
        u, _ = command(scenario, lane.flown, lane.moving, lane.held)
        u = jax.tree.map(float, u)
        here = by_hand.energy(by_hand.R0 + s.altitude, s.velocity)
        angle, bank = u.angle_of_attack, np.arctan2(u.sin_bank, u.cos_bank)

        def rates(x, here=here):
            r = by_hand.R0 + 1e4 * x[0]
            v = np.sqrt(2.0 * (here + by_hand.MU / r))
            lift, drag = by_hand.lift(r, v, x[5]), by_hand.drag(r, v, x[5])
            state = np.array([r, x[1], x[2], v, x[3], x[4]])
            over = by_hand.flow(state, lift * np.cos(x[6]), -lift * np.sin(x[6]), drag)
            # With the share of the energy, which falls.
            return -np.array([over[0] / 1e4, over[1], over[2], over[4], over[5]])

        centre = np.array(
            [
                *(s.altitude / 1e4, s.longitude, s.latitude, s.flight_path_angle),
                *(0.5 * np.pi - s.heading, angle, bank),
            ]
        )
        jacobian = np.stack(
            [by_hand.differences(rates, centre, e, 1e-4) for e in np.eye(7)], axis=1
        )
        a, b, c = jacobian[:, :5], jacobian[:, 5:], np.eye(2, 5, k=1)
        system = np.block([[a, b], [c, np.zeros((2, 2))]])
        mass = np.diag([1.0] * 5 + [0.0] * 2)
        top, bottom = linalg.eigvals(system, mass, homogeneous_eigvals=True)
        found = np.array(
            [x / y for x, y in zip(top, bottom, strict=True) if abs(y) > 1e-4 * abs(x)]
        )
        expected = full_loop.zeros[point] * full_loop.span
        assert_same_set(found, expected, rtol=1e-3)


@SLOW
def test_the_zero_pair_of_sx_2_is_real_before_the_peak_of_lift_over_drag(full_loop):
    """At small angles of attack, late: there more of it is more lift and more drag."""
    zeros = full_loop.zeros * full_loop.span
    assert zeros.shape == (12, 2)
    np.testing.assert_allclose(np.sum(zeros, axis=1), 0.0, atol=0.3)
    share = 1.0 - (full_loop.index[0] - full_loop.index) / full_loop.span
    angles = np.array([by_hand.reference_angle(e) for e in share])
    before = angles < 14.07 * degree
    assert np.all(np.abs(zeros[before].imag) == 0.0)
    assert np.all(np.abs(zeros[~before].imag) > 1.0)
    # The notes: 16 to 18.
    sizes = np.max(zeros[before].real, axis=1)
    assert np.min(sizes) < 16.0 and np.max(sizes) > 18.0
    # As the README has it.
    assert np.argmax(sizes) == len(sizes) - 1
    assert sizes[-1] == pytest.approx(50.0, abs=1.0)


@SLOW
def test_the_last_eigenvalues_of_sx_2_are_unstable(full_loop):
    """With its own drag, as the README has it: all were assigned in the left half plane."""
    assert np.max(full_loop.per_span[-1].real) > 1.0
    worst = full_loop.largest_real_part
    assert worst.value > 0.0
    # Close to the end.
    passed = (full_loop.index[0] - worst.index) / full_loop.span
    assert passed > 0.9
