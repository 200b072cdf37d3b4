"""Linearized closed loops against closed forms, and along the flights of the missions."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sx_2_by_hand as by_hand
from eigenvalues import assert_same_set
from helpers import mars_scenario
from laws import error_gains, state_feedback
from level_hold import (
    ALTITUDE,
    GAINS,
    PERIOD,
    RADIUS,
    VELOCITY,
    deadbeat_gains,
    held_map,
    hold,
    level,
    motion,
    with_integral,
)
from scipy import linalg

from jentry import find_mission
from jentry.analysis import linearize
from jentry.analysis.coordinates import without
from jentry.fields import Scalar, scalar
from jentry.flight import FixedStep
from jentry.guidance import AbstractContinuousLaw, Sampled
from jentry.motion import Controls, EntryState
from jentry.motion.index import (
    AltitudeIndex,
    DownrangeIndex,
    EnergyIndex,
    TimeIndex,
    VelocityIndex,
)
from jentry.units import degree, km


class Kinked(AbstractContinuousLaw[None]):
    """Its derivative is not finite on the flight."""

    steady: Scalar = scalar()

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        away = jnp.sqrt(jnp.abs(measurement.state.velocity - VELOCITY))
        cosine = self.steady + 1e-9 * away
        return Controls(0.0 * cosine, cosine, jnp.sqrt(1.0 - cosine**2)), None


@pytest.fixture(scope="module")
def over_time():
    return linearize(level(hold()), TimeIndex(), 3, solver=FixedStep(1.0))


def test_the_eigenvalues_of_steady_flight_are_those_of_its_closed_form(over_time):
    a, b, k = with_integral()
    assert over_time.coordinates == (
        "altitude",
        "velocity",
        "flight_path_angle",
        "memory",
    )
    assert over_time.eliminated == "time"
    assert set(over_time.ignorable) == {"longitude", "latitude", "heading"}
    assert over_time.forgotten == () and over_time.multipliers is None
    closed = a - np.outer(b, k)
    for point, matrix in enumerate(over_time.matrices):
        np.testing.assert_allclose(matrix, closed, rtol=1e-9, atol=1e-15)
        expected = np.linalg.eigvals(closed)
        assert_same_set(over_time.eigenvalues[point], expected, rtol=1e-7)
    np.testing.assert_allclose(over_time.index, [0.0, 10.0, 19.0], atol=1.01)
    np.testing.assert_array_equal(over_time.index, over_time.time)
    assert over_time.span == pytest.approx(20.0)


def test_the_worst_of_all_points(over_time):
    a, b, k = with_integral()
    expected = np.linalg.eigvals(a - np.outer(b, k))
    grows, swings = over_time.largest_real_part, over_time.least_damping
    assert grows.value == pytest.approx(np.max(expected.real), abs=1e-9)
    moving = expected[np.abs(expected) > 1e-9]
    damping = -moving.real / np.abs(moving)
    assert swings.value == pytest.approx(np.min(damping), abs=1e-6)
    assert swings.eigenvalue.real == pytest.approx(
        moving[np.argmin(damping)].real, abs=1e-9
    )
    assert grows.time in over_time.time
    said = str(over_time)
    assert "span 20 s" in said and "nothing depends on  longitude" in said
    assert "no zeros  LevelHold does not say what it tracks" in said


def test_over_the_ground_the_rates_are_per_metre(over_time):
    """In steady flight the velocity over ground is one number."""
    scenario = level(hold())
    index = DownrangeIndex(scenario.initial_state)
    over_ground = linearize(scenario, index, 3, solver=FixedStep(1.0))
    speed = VELOCITY * RADIUS / (RADIUS + ALTITUDE)
    assert over_ground.eliminated == "longitude"
    assert "time" in over_ground.ignorable
    assert over_ground.span == pytest.approx(20.0 * speed, rel=1e-6)
    # The sine of a heading of 90 degrees is not quite one: the latitude is still there.
    names = over_ground.coordinates
    same = [names.index(name) for name in over_time.coordinates]
    matrices = over_ground.matrices[:, same][..., same]
    np.testing.assert_allclose(matrices, over_time.matrices / speed, 1e-7, 1e-18)


@pytest.fixture(scope="module")
def held():
    return linearize(level(Sampled(hold(), PERIOD)), points=2, solver=FixedStep(0.1))


def test_the_multipliers_of_a_held_command_are_those_of_the_discrete_closed_form(held):
    expected = held_map(GAINS)
    assert held.coordinates == ("altitude", "velocity", "flight_path_angle", "memory")
    assert {"held.command.cos_bank", "held.command.sin_bank"} <= {
        *held.forgotten,
        *held.ignorable,
    }
    for point, matrix in enumerate(held.matrices):
        # The steps of the solver leave less.
        np.testing.assert_allclose(matrix, expected, rtol=1e-7, atol=1e-12)
        multipliers = np.linalg.eigvals(expected)
        assert_same_set(held.multipliers[point], multipliers, rtol=1e-6)
        rates = np.log(multipliers.astype(complex)) / PERIOD
        assert_same_set(held.eigenvalues[point], rates, rtol=1e-6)
    np.testing.assert_allclose(held.time, [0.0, 16.0])


def test_a_deadbeat_loop_says_so(capsys):
    from jentry.cli.linearization_report import print_loop

    gains = deadbeat_gains()
    law = Sampled(hold(gains), PERIOD)
    loop = linearize(level(law), points=2, solver=FixedStep(0.1))
    assert "memory" in loop.ignorable
    assert np.sum(np.isneginf(loop.eigenvalues.real), axis=1).tolist() == [1, 1]
    assert_same_set(loop.multipliers[0], [1.0, 0.5, 0.0], rtol=1e-6)
    assert_same_set(loop.eigenvalues[0], [0.0, -0.5 * np.log(2.0), -np.inf], rtol=1e-6)
    assert not np.isnan(loop.eigenvalues).any() and not np.isnan(loop.per_span).any()
    assert np.all(np.abs(loop.multipliers[np.isinf(loop.eigenvalues)]) < 1e-7)
    assert np.all(loop.damping[np.isinf(loop.eigenvalues)] == 1.0)
    print_loop(find_mission("sx-2"), loop)
    printed = capsys.readouterr().out
    assert "deadbeat: an error vanishes within one guidance cycle" in printed
    assert "inf" not in printed and "nan" not in printed


def test_what_only_idle_coordinates_depend_on_is_idle_too():
    """The last depends on the second, on which only the first depends, on nothing."""
    a = np.zeros((1, 4, 4))
    a[0, 0, 1], a[0, 3, 0], a[0, 2, 2] = 2.0, 3.0, -1.0
    kept, gone = without(a, np.zeros((4, 4)), np.arange(4))
    assert kept.tolist() == [2] and sorted(gone) == [0, 1, 3]
    kept, gone = without(a + np.eye(4), np.eye(4), np.arange(4))
    assert kept.tolist() == [2] and sorted(gone) == [0, 1, 3]


def test_what_cannot_be_linearized_is_refused():
    scenario, solver = level(hold()), FixedStep(1.0)
    with pytest.raises(ValueError, match="points is 0: it must be 1 or more"):
        linearize(scenario, points=0)
    with pytest.raises(ValueError, match="points is 50: the 20 steps"):
        linearize(scenario, points=50, solver=solver)
    with pytest.raises(
        ValueError, match="AltitudeIndex stands still or turns 0 s after"
    ):
        linearize(scenario, AltitudeIndex(), 3, solver=solver)
    below = eqx.tree_at(lambda s: s.initial_state.altitude, scenario, 0.0)
    with pytest.raises(
        ValueError, match="began where an end condition was met already"
    ):
        linearize(below, points=3, solver=solver)
    kinked = level(Kinked(motion()[2]))
    message = "derivative of the closed loop 0 s after the start is not finite"
    with pytest.raises(ValueError, match=message):
        linearize(kinked, points=3, solver=solver)


SLOW = pytest.mark.slow


def entry_of(history, place):
    return jax.tree.map(lambda x: float(x[place]), history)


@pytest.mark.slow
def test_at_equal_energy_the_rates_are_those_of_differences():
    """Of a fall without steady state: the neighbours have the velocity of equal energy."""
    from helpers import free_scenario

    scenario = free_scenario(50 * degree)
    loop = linearize(scenario, EnergyIndex(), 3, solver=FixedStep(1.0))
    names = ("altitude", "latitude", "flight_path_angle", "heading")
    assert loop.coordinates == names and loop.eliminated == "velocity"
    assert set(loop.ignorable) == {"time", "longitude"}
    planet, r0, mu = scenario.planet, 3397 * km, 4.28283e13
    bank = Controls.from_bank(jnp.asarray(50 * degree), jnp.asarray(0.0))
    rates = jax.jit(
        lambda s: scenario.dynamics.rates(planet, scenario.vehicle, s, bank)
    )
    from helpers import fly_compiled

    flight = fly_compiled(scenario, FixedStep(1.0), 1.0)
    times = np.asarray(flight.history.time)
    for time, energy, matrix in zip(loop.time, loop.index, loop.matrices, strict=True):
        place = int(np.nanargmin(np.abs(times - time)))
        state = entry_of(flight.history.states, place)

        def at(values, energy=energy, state=state):
            moved = {**vars(state), **dict(zip(names, values, strict=True))}
            potential = -mu / (r0 + moved["altitude"])
            moved["velocity"] = np.sqrt(2.0 * (energy - potential))
            rate = rates(EntryState(**moved))
            g = mu / (r0 + moved["altitude"]) ** 2
            power = moved["velocity"] * float(rate.velocity)
            power += g * float(rate.altitude)
            return np.array([float(getattr(rate, n)) for n in names]) / abs(power)

        centre = np.array([getattr(state, name) for name in names])
        for column, step in enumerate((1.0, 1e-5, 1e-5, 1e-5)):
            direction = step * np.eye(4)[column]
            slope = by_hand.differences(at, centre, direction, 1.0) / step
            size = np.max(np.abs(matrix), axis=1)
            np.testing.assert_allclose(
                matrix[:, column], slope, rtol=1e-6, atol=1e-7 * np.max(size)
            )


@SLOW
def test_a_cycle_at_equal_energy_is_the_flow_of_the_rates():
    """A held command that never changes: a map of one second, and rates on its way."""
    from helpers import free_scenario

    scenario = free_scenario(50 * degree, time_limit=10.0)
    start = EntryState(45 * km, 0.1, 0.05, 4500.0, -8 * degree, 80 * degree)
    scenario = dataclasses.replace(scenario, initial_state=start)
    held = dataclasses.replace(scenario, guidance=Sampled(scenario.guidance, 1.0))
    solver = FixedStep(1.0)
    rates = linearize(scenario, EnergyIndex(), 8, solver=solver)
    cycles = linearize(held, EnergyIndex(), 9, solver=solver)
    assert cycles.coordinates == rates.coordinates and len(rates.coordinates) == 4
    np.testing.assert_array_equal(cycles.time, np.arange(9.0))
    of_a_cycle = np.flatnonzero(np.diff(rates.time) == 1.0)
    assert len(of_a_cycle) > 3
    for place in of_a_cycle:
        k = int(rates.time[place])
        middle = 0.5 * (rates.matrices[place] + rates.matrices[place + 1])
        way = rates.index[place] - rates.index[place + 1]
        expected = linalg.expm(middle * way)
        unit = np.array([1e3, 1e-2, 1e-2, 1e-2])
        moved = (cycles.matrices[k] - expected) * unit / unit[:, None]
        whole = (expected - np.eye(4)) * unit / unit[:, None]
        assert np.linalg.norm(moved) < 3e-3 * np.linalg.norm(whole)


@SLOW
def test_drag_tracking_over_the_energy_has_the_error_dynamics_of_its_gains(reference):
    """x'' = -(a / e^2) x - (b / e) x' over the time, whose rate of energy is D V."""
    loop = linearize(
        mars_scenario(state_feedback(reference)),
        EnergyIndex(),
        5,
        solver=FixedStep(0.1),
    )
    assert loop.coordinates == ("e1", "e1'")
    gains = error_gains()
    epsilon, a, b = (float(x) for x in (gains.epsilon0, gains.a, gains.b))
    expected = np.sort(np.roots([1.0, b / epsilon, a / epsilon**2]))
    for found in loop.eigenvalues[1:4]:
        # In proportion: the drag itself is not told.
        ratio = np.sort(found.real) / expected
        assert np.ptp(ratio) < 1e-2 * ratio[0] and ratio[0] > 0.0
    assert loop.zeros is not None and loop.zeros.shape[1] == 0


@SLOW
@pytest.mark.parametrize(
    "mission, variant, index",
    [
        ("mars-drag-tracking", None, EnergyIndex()),
        ("mars-drag-tracking", "time-index", VelocityIndex()),
        ("mars-range-tracking", None, TimeIndex()),
        ("cav-h", "stored", EnergyIndex()),
    ],
)
def test_every_law_is_linearized_along_its_flight(mission, variant, index):
    scenario = find_mission(mission).scenario(variant)
    if isinstance(index, VelocityIndex):
        with pytest.raises(ValueError, match="VelocityIndex stands still or turns"):
            linearize(scenario, index, 3)
        return
    loop = linearize(scenario, index, 4)
    assert not np.isnan(loop.eigenvalues).any()
    assert np.isfinite(loop.matrices).all()
    if loop.multipliers is not None:
        # To what a cycle does to all deviations: determinants, and not an order of them.
        product = np.prod(loop.multipliers, axis=1)
        scale = np.linalg.norm(loop.matrices, axis=(1, 2)) ** loop.matrices.shape[1]
        determinant = np.linalg.det(loop.matrices)
        assert np.all(np.abs(product - determinant) <= 1e-9 * scale)
