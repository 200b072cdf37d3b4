"""The planned glide of the RLV: angle-of-attack schedule, coefficients and equilibrium."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry import find_mission
from jentry.missions.rlv.airframe import ScheduledAngleOfAttack, vehicle
from jentry.missions.rlv.scenario import earth, plan
from jentry.planning import Glide, plan_glide
from jentry.units import degree, standard_gravity


MISSION = find_mission("rlv")


def test_the_schedule_is_45_but_for_its_corner():
    schedule = ScheduledAngleOfAttack()
    for mach in (2.0, 3.0, 5.0, 11.0, 11.79):
        known = max(mach, 3.0)
        expected = -4.3333 + 7.3611 * known - 0.3056 * known**2
        assert float(schedule(jnp.asarray(mach))) / degree == pytest.approx(expected)
    for mach in (12.21, 20.0):
        assert float(schedule(jnp.asarray(mach))) / degree == pytest.approx(40.0)
    here = jnp.asarray(12.05)
    _, first, second = schedule.with_derivatives(here)
    slope = (schedule(here + 1e-5) - schedule(here - 1e-5)) / 2e-5
    bend = schedule.with_derivatives(here + 1e-5)[1]
    bend = (bend - schedule.with_derivatives(here - 1e-5)[1]) / 2e-5
    assert float(first) == pytest.approx(float(slope), rel=1e-6)
    assert float(second) == pytest.approx(float(bend), rel=1e-5)


def test_coefficients_are_43_and_44():
    for angle in (10.0, 25.0, 40.0):
        lift = 0.12457 - 0.02437 * angle + 0.00309 * angle**2 - 3.66023e-5 * angle**3
        drag = 0.32083 - 0.02850 * angle + 0.00155 * angle**2 - 9.42499e-7 * angle**3
        one = jnp.asarray(1.0)
        found = vehicle().coefficients(jnp.asarray(angle * degree), one, one)
        np.testing.assert_allclose(found, [lift, drag], rtol=1e-12)


@pytest.fixture(scope="module")
def glide():
    """The plan at some velocities, in SI and rad."""
    velocity = np.arange(1050.0, 7750.0, 25.0)
    found = jax.vmap(plan().over_index)(jnp.asarray(velocity))
    return velocity, {name: np.asarray(values[0]) for name, values in found.items()}


def test_the_plan_heats_evenly_and_glides_near_equilibrium(glide):
    velocity, found = glide
    scenario = MISSION.scenario_of("modulation")
    density = jax.vmap(scenario.planet.atmosphere.undisturbed.density)
    rho = np.asarray(density(jnp.asarray(found["altitude"])))
    hot = velocity > 5100.0
    heating = np.sqrt(rho[hot]) * velocity[hot] ** 3.15
    np.testing.assert_allclose(heating, heating[0], rtol=1e-9)
    cool = velocity < 4900.0
    carried = standard_gravity - velocity**2 / 6371e3
    held = found["lift"][cool] * np.cos(60.0 * degree)
    np.testing.assert_allclose(held, carried[cool], rtol=1e-9)
    # The notes: a level so that the cosine is not above 0.78 where it heats evenly.
    assert 0.76 < np.max(np.cos(found["bank"][hot])) < 0.78


def test_the_plan_obeys_the_motion(glide):
    """Altitude and path angle over the velocity, by differences of the plan itself."""
    velocity, found = glide
    inside = (velocity > 1100.0) & (np.abs(velocity - 5000.0) > 130.0)
    step = jnp.asarray(0.5)
    over = jax.vmap(plan().over_index)
    ahead, behind = over(velocity + step), over(velocity - step)
    gravity = standard_gravity * (6371e3 / (6371e3 + found["altitude"])) ** 2
    path = found["flight_path_angle"]
    slows = -found["drag"] - gravity * np.sin(path)
    climb = np.asarray(ahead["altitude"][0] - behind["altitude"][0])
    np.testing.assert_allclose(
        (climb * slows)[inside], (velocity * np.sin(path))[inside], rtol=1e-4
    )
    np.testing.assert_allclose(
        found["altitude_rate"], velocity * np.sin(path), rtol=1e-6
    )
    turn = np.asarray(ahead["flight_path_angle"][0] - behind["flight_path_angle"][0])
    up = found["lift"] * np.cos(found["bank"])
    centrifugal = velocity**2 / (6371e3 + found["altitude"]) - gravity
    expected = up + centrifugal * np.cos(path)
    np.testing.assert_allclose(
        (velocity * turn * slows)[inside], expected[inside], atol=2e-3
    )
    np.testing.assert_allclose(found["lift_to_drag_up"], up / found["drag"], rtol=1e-6)


def test_flight_conditions_along_the_plan():
    """On the back side of the lift-to-drag ratio above 1255 m/s, as the notes have it."""
    scenario = MISSION.scenario_of("modulation")
    domain = scenario.guidance.angle_of_attack.domain

    @jax.jit
    @jax.vmap
    def conditions(velocity):
        wanted = plan().over_index(velocity)
        altitude = wanted["altitude"][0]
        state = dataclasses.replace(
            scenario.initial_state, velocity=velocity, altitude=altitude
        )
        point = domain.point(state, wanted)
        gamma1, gamma2 = domain.zero_dynamics(point)
        return domain.flight_condition(point), gamma1, gamma2

    velocity = np.concatenate([np.arange(1100.0, 1250.0, 10.0), [1254.0, 1256.0]])
    velocity = np.concatenate([velocity, np.arange(1260.0, 7300.0, 20.0)])
    found, gamma1, gamma2 = conditions(jnp.asarray(velocity))
    assert np.all(found[velocity < 1255.0] == 2)
    assert np.all(gamma1[velocity < 1255.0] > 0.0)
    above = velocity > 1255.0
    assert np.all(gamma1[above] < 0.0)
    # Where the two parts of the plan are blended the lift carries more than the weight.
    blended = np.abs(velocity - 5000.0) < 110.0
    assert np.all(found[above & ~blended] == 1)
    np.testing.assert_array_equal(found[blended], np.where(gamma2[blended] < 0.0, 1, 0))
    assert np.any(found[blended] == 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("glide", "intervals", "message"),
    [
        # So much lift to carry that no air is dense enough.
        (dict(bank=89.9999 * degree), 8, "no glide is found at 1000 m/s"),
        ({}, 3, "intervals is 3: .* take 4"),
    ],
)
def test_a_glide_that_cannot_be_is_refused(glide, intervals, message):
    with pytest.raises(ValueError, match=message):
        plan_glide(
            earth(), vehicle(), ScheduledAngleOfAttack(), Glide(**glide), intervals
        )
