"""What is planned: parameters of a curve, maps, and the derivatives of a bank profile.

`test_drag_tracking` has the planned reference itself, `test_cav_h` the flights.
"""

import sys
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_entry, mars_scenario, with_leaf

from jentry import find_mission
from jentry.flight import FixedStep, Outcome
from jentry.missions.cav_h.scenario import stored
from jentry.motion.index import EnergyIndex
from jentry.onboard import PolynomialProfile, measure
from jentry.planning import (
    k2_polynomial,
    open_loop,
    plan_bank_profile,
    plan_parameters,
    velocity_map,
)
from jentry.planning.reference_flight import (
    ReferenceFlight,
    _profile,
    plan_drag_reference,
)


# Of the Bézier curve, with a velocity at the target that has a closed form.


@pytest.fixture
def known(monkeypatch):
    """Velocity 2600 + 400 (k1 - 0.848) - 900 (k2 - 0.717) + 500 (k2 - 0.717)^2 m/s.

    Gives the pairs of k1 and k2 that are asked for. Beyond k2 = 1 no flight reaches.
    """
    asked = []

    def velocity(k):
        x, y = k[0] - 0.848, k[1] - 0.717
        return 2600.0 + 400.0 * x - 900.0 * y + 500.0 * y * y

    def answer(scenario, solver, k):
        asked.append(np.asarray(k))
        reached = jnp.where(k[1] < 1.0, Outcome.REACHED, Outcome.CRASHED)
        return velocity(k), jax.grad(velocity)(k), reached

    module = sys.modules[plan_parameters.__module__]
    monkeypatch.setattr(module, "_velocity_and_slopes", answer)
    return velocity, asked


def test_parameters_are_planned_by_newton_in_k2_alone(known):
    velocity, asked = known
    planned = plan_parameters(stored(), 2700.0)
    assert float(planned.k1) == 0.848
    k = jnp.array([planned.k1, planned.k2])
    assert float(velocity(k)) == pytest.approx(2700.0, abs=1e-3)
    # The first step moves by 0.1 at most: 100 m/s at 900 m/s are 0.111.
    np.testing.assert_allclose(asked[:2], [[0.848, 0.717], [0.848, 0.617]], rtol=1e-13)
    assert len(asked) <= 5


def test_parameters_are_planned_by_the_shortest_step_in_both(known):
    velocity, asked = known
    planned = plan_parameters(stored(), 2610.0, vary_k1=True)
    k = jnp.array([planned.k1, planned.k2])
    assert float(velocity(k)) == pytest.approx(2610.0, abs=1e-3)
    step = asked[1] - asked[0]
    expected = 10.0 * np.array([400.0, -900.0]) / (400.0**2 + 900.0**2)
    np.testing.assert_allclose(step, expected, rtol=1e-12)


def test_a_coarser_answer_is_one_where_it_is_asked_for(known):
    velocity, asked = known
    planned = plan_parameters(stored(), 2601.0, tolerance=2.0)
    assert len(asked) == 1 and float(planned.k2) == 0.717


@pytest.mark.parametrize("wanted", [1000.0, 9000.0])
def test_no_parameters_are_found_for_what_is_out_of_reach(known, wanted):
    with pytest.raises(ValueError, match=f"ends at {wanted:g} m/s: the last one, with"):
        plan_parameters(stored(), wanted)


def test_a_map_has_k1_along_its_rows_and_nothing_where_no_flight_arrives(monkeypatch):
    given = []

    def flown(scenario, *, inputs, solver):
        given.append(solver)
        k1, k2 = (inputs[f"guidance.parameters.{name}"] for name in ("k1", "k2"))
        state = SimpleNamespace(velocity=1000.0 * k1 + k2)
        outcome = np.where(k2 > 0.85, Outcome.CRASHED, Outcome.REACHED)
        return SimpleNamespace(flights=SimpleNamespace(state=state, outcome=outcome))

    monkeypatch.setattr(sys.modules[velocity_map.__module__], "monte_carlo", flown)
    k1, k2 = np.array([0.6, 0.8]), np.array([0.5, 0.7, 0.9])
    found = velocity_map(stored(), k1, k2, FixedStep(0.5))
    assert given == [FixedStep(0.5)]
    expected = [[600.5, 600.7, np.nan], [800.5, 800.7, np.nan]]
    np.testing.assert_allclose(found.velocity, expected)
    np.testing.assert_array_equal(found.k1, k1)
    np.testing.assert_array_equal(found.k2, k2)


def test_the_polynomial_has_the_square_first_and_leaves_out_what_is_not_there():
    velocity = np.array([2400.0, 2500.0, np.nan, 2650.0, 2800.0])
    k2 = 2e-7 * velocity**2 - 2e-3 * velocity + 4.3
    k2[2] = 0.9
    # Least squares of numbers of 1e7: their rounding, times the square of that.
    np.testing.assert_allclose(
        k2_polynomial(velocity, k2), [2e-7, -2e-3, 4.3], rtol=1e-6
    )


# Of the bank profile.

COARSE = FixedStep(1.0)


@eqx.filter_jit
def planned_for(scenario, curvature):
    return plan_bank_profile(scenario, 503.0, curvature, solver=COARSE).coefficients


@eqx.filter_jit
def moved(scenario, curvature, directions):
    """Coefficients, and how they move with mass, target and curvature."""

    def plan(numbers):
        mass, downrange, curvature = numbers
        places = lambda s: (s.vehicle.mass, s.target.downrange)
        given = eqx.tree_at(places, scenario, (mass, downrange))
        profile = plan_bank_profile(given, 503.0, curvature, solver=COARSE)
        return profile.coefficients

    at = (scenario.vehicle.mass, scenario.target.downrange, curvature)
    return jax.vmap(lambda d: jax.jvp(plan, (at,), (tuple(d),))[1])(directions)


def test_a_profile_is_over_the_way_from_its_end_to_the_entry():
    given = mars_scenario(), jnp.asarray(503.0), jnp.asarray(-0.3)
    profile = _profile(given, jnp.array([0.6, 0.05]))
    for velocity, z in ((503.0, 0.0), (6750.0, 1.0), (1752.4, 0.2)):
        expected = 0.6 + 0.05 * z - 0.3 * z * z
        assert float(profile(jnp.asarray(velocity))) == pytest.approx(expected)


def test_an_open_loop_flies_its_profile_at_trim_to_its_velocity():
    scenario = with_leaf(
        mars_scenario(), lambda s: s.vehicle.trim_angle_of_attack, 0.125
    )
    profile = PolynomialProfile([0.3])
    flown = open_loop(scenario, profile, 700.0)
    assert flown.guidance.angle_of_attack is None
    start = measure(
        flown.planet, flown.vehicle, flown.initial_state, jnp.asarray(0.125)
    )
    controls, _ = flown.guidance(jnp.asarray(0.0), start, None)
    assert float(controls.angle_of_attack) == 0.125
    assert eqx.tree_equal(flown.guidance.cos_bank, profile)
    assert flown.termination.names == ("velocity", "time_limit")
    assert float(flown.termination.conditions["velocity"].velocity) == 700.0
    assert flown.termination.time_limit == scenario.termination.time_limit


@pytest.mark.slow
def test_a_planned_profile_has_the_curvature_and_meets_the_target():
    scenario = mars_scenario()
    curvature = jnp.asarray(-0.05)
    coefficients = planned_for(scenario, curvature)
    assert float(coefficients[2]) == -0.05
    span = 6750.0 - 503.0
    profile = PolynomialProfile(coefficients, 503.0, span)
    flight = fly_compiled(open_loop(scenario, profile, 503.0), COARSE)
    assert float(flight.state.altitude) == pytest.approx(10e3, abs=1e-3)
    downrange = float(flight.state.longitude) * 3397e3
    assert downrange == pytest.approx(723.32e3, abs=1e-2)


@pytest.mark.slow
def test_a_planned_profile_moves_with_what_it_is_planned_for():
    """By the implicit function theorem, against differences of the plan."""
    scenario = mars_scenario()
    steps = np.array([0.5, 20.0, 1e-3])
    slopes = moved(scenario, jnp.asarray(0.0), jnp.eye(3))

    def at(offsets):
        mass, downrange, curvature = offsets
        places = lambda s: (s.vehicle.mass, s.target.downrange)
        given = tuple(
            x + d for x, d in zip(places(scenario), (mass, downrange), strict=True)
        )
        return planned_for(eqx.tree_at(places, scenario, given), jnp.asarray(curvature))

    for slope, step in zip(slopes, np.diag(steps), strict=True):
        numeric = (at(step) - at(-step)) / (2.0 * np.max(step))
        # Differences of the second order, of a plan that is good to 1e-11.
        np.testing.assert_allclose(slope, numeric, rtol=1e-4, atol=1e-9)


def test_only_a_bank_profile_is_a_reference():
    states = jax.tree.map(lambda x: jnp.stack([x, x]), mars_entry())
    times = jnp.array([0.0, 0.1])
    flight = ReferenceFlight(stored(), 0.1, times, states, mars_entry())
    with pytest.raises(ValueError, match="flies BezierGuidance, not a BankProfile"):
        plan_drag_reference(flight, EnergyIndex())


def test_a_law_with_a_memory_flies_no_reference():
    """An integral error would stay at its first value at every node."""
    scenario = find_mission("mars-drag-tracking").scenario("observer-feedback")
    with pytest.raises(ValueError, match="ObserverDragTracking has a memory"):
        ReferenceFlight.of(scenario)
