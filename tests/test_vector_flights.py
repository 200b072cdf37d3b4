"""What uses flights as vectors: solvers, missions, histories, campaigns and kernels."""

import dataclasses
import shutil

import cartesian
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import along_each, fly_compiled
from vector_cases import MU, ORDINARY, RADIUS, SINGULAR, STEP, VACUUM

from jentry import find_mission
from jentry.addresses import replace_leaves
from jentry.analysis import linearize
from jentry.campaign import monte_carlo
from jentry.flight import Adaptive, Apoapsis, FixedStep, Outcome, Termination, fly
from jentry.flight.effect import unfelt
from jentry.flight.over_index import fly_over
from jentry.kernel import kernel_of
from jentry.motion import (
    AltitudeIndex,
    Controls,
    EntryDynamics,
    EntryState,
    EquilibriumGlide,
    VectorDynamics,
)
from jentry.onboard import InertialNavigation, OnboardModel, propagate, propagate_over
from jentry.planning.reference_flight import ReferenceFlight
from jentry.units import degree


STEEP = EntryState(50e3, 5.0, -0.9, 5e3, -0.2, -3.0)


def by_vectors(case):
    return case.scenario(VectorDynamics())


def assert_close(found, expected, **close):
    for name, each in close.items():
        pair = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(*pair, rtol=0.0, atol=each, err_msg=name)


# Refusals.


def test_a_start_at_rest_needs_vectors():
    case = SINGULAR["a fall from rest"]
    with pytest.raises(
        ValueError, match=r"velocity is 0 m/s: .* take dynamics=VectorDynamics\(\)"
    ):
        fly(case.scenario(EntryDynamics()))
    backwards = dataclasses.replace(case.state, velocity=-1.0)
    with pytest.raises(ValueError, match="velocity is -1 m/s: it must be zero or more"):
        fly(dataclasses.replace(case, state=backwards).scenario(VectorDynamics()))
    moving = dataclasses.replace(case.state, velocity=1.0)
    moving = dataclasses.replace(case, state=moving).scenario(EntryDynamics())
    with pytest.raises(ValueError, match="run 1: initial_state.velocity is 0 m/s"):
        monte_carlo(moving, inputs={"initial_state.velocity": [1.0, 0.0]})


def test_what_integrates_angles_refuses_vectors():
    scenario = by_vectors(ORDINARY[0])
    with pytest.raises(ValueError, match="VectorDynamics.* linearization are altitude"):
        linearize(scenario)
    aided = dataclasses.replace(scenario, navigation=InertialNavigation())
    with pytest.raises(ValueError, match="InertialNavigation and dynamics VectorDyn"):
        fly(aided)
    model = OnboardModel(scenario.planet, scenario.vehicle)
    there = scenario.initial_state
    ends = (lambda state: state.altitude,)
    level = lambda time, state: Controls.from_bank(0.0 * time, 0.0 * time)
    with pytest.raises(ValueError, match="VectorDynamics, and a prediction integrates"):
        propagate(
            model, there, level, ends, step=1.0, steps=8, dynamics=VectorDynamics()
        )
    with pytest.raises(ValueError, match="VectorDynamics, and a prediction integrates"):
        propagate_over(
            lambda state: state.altitude,
            0.0,
            model,
            there,
            level,
            steps=8,
            dynamics=VectorDynamics(),
        )


def test_the_same_numbers_are_used():
    case = ORDINARY[0]
    assert unfelt(by_vectors(case)) == unfelt(case.scenario(EntryDynamics()))


def test_a_flight_that_is_stopped_says_which_dynamics_flies_on():
    assert "dynamics=VectorDynamics()" in Outcome.SINGULAR.message


# Solvers, histories and campaigns.


@pytest.mark.slow
@pytest.mark.parametrize("path", [90.0, 89.9])
@pytest.mark.parametrize("solver", [FixedStep(STEP), Adaptive()])
def test_the_highest_point_of_a_throw(path, solver):
    """At rest, and nearly so; by the energy of an orbit and its angular momentum."""
    start = dataclasses.replace(VACUUM.state, flight_path_angle=path * degree)
    case = dataclasses.replace(VACUUM, state=start)
    scenario = dataclasses.replace(
        by_vectors(case), termination=Termination({"top": Apoapsis()}, 200.0)
    )
    flight = fly_compiled(scenario, solver)
    assert flight.outcome == Outcome.REACHED
    radius, speed = RADIUS + 9144.0, 200.0
    energy = 0.5 * speed**2 - MU / radius
    turning = radius * speed * np.cos(path * degree)
    root = np.sqrt(1.0 + 2.0 * energy * (turning / MU) ** 2)
    highest = -MU / (2.0 * energy) * (1.0 + root)
    np.testing.assert_allclose(flight.state.altitude, highest - RADIUS, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", SINGULAR)
def test_adaptive_steps_find_the_same_end(name):
    scenario = by_vectors(SINGULAR[name])
    found = fly_compiled(scenario, Adaptive())
    expected = fly_compiled(scenario, FixedStep(STEP))
    assert found.outcome == expected.outcome
    # The fixed step errs by 2e-5 m, as against the independent integration.
    assert_close(found, expected, time=1e-6)
    assert_close(
        found.state, expected.state, altitude=2e-5, velocity=1e-6, latitude=1e-11
    )


@pytest.mark.slow
def test_the_history_passes_a_pole():
    """Great circles: latitudes rise to the pole and fall again, longitudes jump once."""
    scenario = dataclasses.replace(
        by_vectors(SINGULAR["through a pole"]),
        located_peaks=("drag",),
        constraints={
            **by_vectors(ORDINARY[0]).constraints,
            "glide": EquilibriumGlide(),
        },
    )
    flight = fly_compiled(scenario, FixedStep(STEP), 10.0)
    states = flight.history.states
    jump = np.diff(states.longitude)
    turned = np.abs(jump) > 1e-9
    assert np.sum(turned) == 1
    np.testing.assert_allclose(np.abs(jump[turned]), np.pi)
    rising = np.cumsum(turned) == 0
    assert np.all((np.diff(states.latitude) > 0.0)[rising])
    np.testing.assert_allclose(
        np.cos(states.heading), np.where(np.arange(20) < 6, 1.0, -1.0)
    )
    for leaf in jax.tree.leaves((flight.history, flight.peaks, flight.at_peaks)):
        assert np.all(np.isfinite(leaf))
    # The arc over the ground is that of the place, whichever side of the pole it is on.
    arc = np.where(turned.cumsum() == 0, 1.0, -1.0)
    assert np.all(arc * (states.latitude[1:] - states.latitude[:-1]) > -0.02)
    peak, drag = flight.at_peaks["drag"], flight.history.constraints.drag
    assert abs(peak.time - flight.history.time[np.argmax(drag)]) < 10.0
    np.testing.assert_allclose(peak.state.longitude, 0.3)


@pytest.mark.slow
def test_a_flight_over_an_index():
    case = dataclasses.replace(ORDINARY[2], state=STEEP)
    ends = [
        fly_over(case.scenario(dynamics), AltitudeIndex(), 30e3, 800)
        for dynamics in (VectorDynamics(), EntryDynamics())
    ]
    # RK4 with steps of 25 m, some 25 ms.
    assert_close(*ends, time=1e-8)
    assert_close(ends[0].state, ends[1].state, longitude=1e-12, heading=1e-10)
    assert ends[0].state.longitude > np.pi


@pytest.mark.slow
def test_a_campaign_starts_at_rest_and_in_flight():
    scenario = by_vectors(SINGULAR["a fall from rest"])
    velocities = [0.0, 10.0]
    campaign = monte_carlo(scenario, inputs={"initial_state.velocity": velocities})
    for lane, velocity in enumerate(velocities):
        alone = replace_leaves(scenario, {"initial_state.velocity": velocity})
        flight = fly_compiled(alone)
        np.testing.assert_allclose(campaign.flights.time[lane], flight.time)
    assert np.all(campaign.flights.outcome == Outcome.CRASHED)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["xla", "c"])
def test_a_kernel_flies_over_a_pole(form):
    if form == "c" and shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    scenario = by_vectors(SINGULAR["over a pole"])

    def end(velocity):
        moved = replace_leaves(scenario, {"initial_state.velocity": velocity})
        return fly(moved, FixedStep(STEP)).state

    velocities = jnp.array([6000.0, 6010.0, 5990.0])
    found = kernel_of(end, velocities[0], form=form)(velocities)
    expected = jax.jit(jax.vmap(end))(velocities)
    for one, other in zip(
        jax.tree.leaves(found), jax.tree.leaves(expected), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-11)


@pytest.mark.slow
def test_second_derivatives_of_flights_agree_with_differences():
    """Of the time of a fall from rest, over its speed and height at the start."""
    case = SINGULAR["a fall from rest"]

    def time(numbers):
        altitude, velocity = numbers
        start = dataclasses.replace(case.state, altitude=altitude, velocity=velocity)
        scenario = dataclasses.replace(by_vectors(case), initial_state=start)
        return fly(scenario, FixedStep(STEP)).time

    # A speed below zero is one backwards.
    found, slopes = along_each(jax.grad(time), [9144.0, 0.0], (1.0, 1e-2))
    np.testing.assert_allclose(found, slopes, rtol=1e-4, atol=1e-9)


@pytest.mark.slow
def test_a_reference_flight_has_the_derivatives_of_its_path():
    """As with angles, of which the reference is planned."""
    steep = dataclasses.replace(ORDINARY[2], state=STEEP, ground=10e3)
    tables = []
    for dynamics in (VectorDynamics(), EntryDynamics()):
        flight = ReferenceFlight.of(steep.scenario(dynamics), 0.5)
        quantities = lambda time, state: {"speed": state.velocity}
        tables.append(flight.tabulate(quantities, AltitudeIndex(), 40))
    altitudes = jnp.linspace(45e3, 15e3, 13)
    found, expected = (
        jax.vmap(table.with_derivatives)(altitudes)["speed"] for table in tables
    )
    # RK4 with 0.5 s, and differences of it over nodes 1 km apart.
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


# Guided missions.


def distance(scenario, one, other):
    """Of the ends of two flights, m, with the difference of their times at 1 km/s."""
    places = [
        np.stack(
            cartesian.from_entry_state(scenario.planet.radius, flight.state, np)[0]
        )
        for flight in (one, other)
    ]
    return np.linalg.norm(places[0] - places[1]) + 1e3 * abs(one.time - other.time)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mars-range-tracking", "msl", "sx-2", "shuttle"])
def test_guided_missions_end_as_with_angles(name):
    """Within the error of the step, which shorter steps measure."""
    angles = find_mission(name).scenario()
    assert type(angles.dynamics) is EntryDynamics
    vectors = dataclasses.replace(angles, dynamics=VectorDynamics())
    step = angles.step or 0.1
    flown, error = [], 0.0
    for scenario in (angles, vectors):
        flight, finer = (
            fly_compiled(scenario, FixedStep(x)) for x in (step, 0.5 * step)
        )
        assert flight.outcome == Outcome.REACHED
        flown.append(flight)
        error += distance(scenario, flight, finer)
    assert flown[0].ended_by == flown[1].ended_by
    # A sixteenth of the error is that of the finer steps; and rounding of 1e6 m.
    assert distance(angles, *flown) < 1.1 * error + 1e-6
    assert error < 10.0
