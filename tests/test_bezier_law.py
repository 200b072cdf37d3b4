"""Single decisions of the Bézier law: estimates, commands, cycles and adjustments."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bezier_laws import (
    LAW,
    NOMINAL,
    PLANET,
    POLYNOMIAL,
    POLYNOMIALS,
    TO_GO,
    Linear,
    Unknown,
    at,
    cycle,
    decided,
    expected_forces,
    number,
)
from helpers import ahead

from jentry._batching import where_due
from jentry.guidance import (
    BezierPath,
    Epochs,
    NetworkPredictor,
    NewtonAdjustment,
    PathPoint,
    StoredParameters,
    Subdivision,
)
from jentry.guidance.bezier.anchoring import Shape
from jentry.guidance.bezier.inverse_dynamics import required_acceleration
from jentry.guidance.bezier.prediction import Inputs, Situation, features
from jentry.missions import find_mission
from jentry.missions.cav_h.scenario import constraints
from jentry.onboard import FactorEstimate, Factors, Measurement, Network
from jentry.units import degree
from jentry.world import USStandardAtmosphere1976


# What it infers.


def test_factors_are_of_the_angle_of_attack_that_is_flown():
    """The last ratio; at trim, 0.17 rad, the expected forces would be other ones."""
    _, after = cycle(lift=1.07, drag=0.94)
    assert float(after.estimate.factors.lift) == pytest.approx(1.07, rel=1e-13)
    assert float(after.estimate.factors.drag) == pytest.approx(0.94, rel=1e-13)


def test_a_memory_forgets_by_the_duration_of_the_cycle():
    law = eqx.tree_at(lambda s: s.estimator.time_constant, LAW, number(2.0))
    state = at()
    lift, drag = (float(x) for x in expected_forces(state, number(0.23)))
    before, _ = cycle(law, state, duration=0.1)
    known = FactorEstimate(Factors(1.2, 0.9), number(40.0), number(7.0))
    held = eqx.tree_at(lambda d: d.estimate, before, known)
    after = decided(
        law, Measurement(state, number(lift), number(drag), *2 * [number(0.0)]), held
    )
    kept = np.exp(-0.1 / 2.0)
    for name, force, factor, weight in (
        ("lift", lift, 1.2, 40.0),
        ("drag", drag, 0.9, 7.0),
    ):
        fit = (kept * weight * factor + force**2) / (kept * weight + force**2)
        found = getattr(after.estimate.factors, name)
        assert float(found) == pytest.approx(fit, rel=1e-13), name


# What it commands.


def wanted_by(after, state):
    start, target = LAW._point(state), LAW.target()
    inner = LAW.anchoring.inner(after.shape, start, target)
    slopes = BezierPath.between(start, target, inner).second_slopes(number(0.0))
    return required_acceleration(PLANET, start, slopes, state.velocity)


@pytest.mark.parametrize("loop", [True, False], ids=["achieved", "as printed"])
def test_the_lift_is_that_of_the_curve_by_the_factor(loop):
    """Without the acceleration loop the factor is left out: equation (34)."""
    law = dataclasses.replace(LAW, acceleration_loop=loop)
    state = at()
    _, after = cycle(law, state, lift=1.07)
    wanted = wanted_by(after, state)
    lift, _ = expected_forces(state, after.controls.angle_of_attack)
    actual = float(lift) * (1.07 if loop else 1.0)
    found = actual * np.array([after.controls.cos_bank, after.controls.sin_bank])
    np.testing.assert_allclose(found, [wanted.vertical, wanted.lateral], rtol=1e-11)
    assert abs(wanted.lateral) > 1e-3 * wanted.vertical


def test_a_decision_is_the_same_anywhere_on_the_globe():
    """The scene turned, the track over the pole: the same command, to rounding."""
    state = at()
    begin, heading = (-100.0, 60.0), 10.0
    *target, arrival = ahead(begin, heading, float(LAW.track.target_latitude) / degree)
    track = dataclasses.replace(
        LAW.track, **dict(zip(PLACES, np.radians([*begin, *target]), strict=True))
    )
    law = eqx.tree_at(
        lambda s: (s.track, s.arrival.heading),
        LAW,
        (track, number(np.radians(arrival))),
    )
    *foot, along = ahead(begin, heading, 20.0)
    # 0.02 deg of longitude at 20 deg of latitude, as an arc to the right, ends there.
    turn, aside = beside(20.0, 0.02)
    *foot, along = ahead(begin, heading, turn)
    *place, across = ahead(foot, along + 90.0, aside)
    _, _, meridian = ahead(*((0.0, turn), 90.0), aside)
    turned = eqx.tree_at(
        lambda s: (s.longitude, s.latitude, s.heading),
        state,
        tuple(number(np.radians(x)) for x in (*place, across + 0.1 - meridian)),
    )
    ours, theirs = cycle(state=state)[1], cycle(law, turned)[1]
    for one, other in zip(*map(jax.tree.leaves, (ours, theirs)), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-8, atol=1e-11)


PLACES = ("start_longitude", "start_latitude", "target_longitude", "target_latitude")


def beside(latitude, longitude):
    """How far north, and then to the right, a place near the meridian lies, deg."""
    latitude, longitude = np.radians((latitude, longitude))
    north = np.arctan2(np.tan(latitude), np.cos(longitude))
    east = np.arcsin(np.cos(latitude) * np.sin(longitude))
    return np.degrees((north, east))


# What it holds, and how long.


@pytest.mark.parametrize(
    ("seconds", "before", "duration"),
    [(500.0, 1.0, 1.0), (121.0, 1.0, 1.0), (119.0, 1.0, 0.1), (14.0, 0.1, 0.02)]
    + [(119.0, 0.02, 0.02), (14.0, 1.0, 0.02)],
)
def test_a_cycle_is_as_long_as_the_way_to_go_has_it(seconds, before, duration):
    held, after = cycle(state=to_go(seconds), duration=before)
    assert float(after.duration) == duration
    assert float(after.count) == float(held.count) + 1.0
    along = LAW.track.position(to_go(seconds)).along
    assert float(after.along) == pytest.approx(float(along), rel=1e-15)


def to_go(seconds, velocity=2700.0):
    """So many seconds before the target, at the angle to go times the radius."""
    angle = seconds * velocity / (6371e3 + 41e3)
    return at(float(LAW.track.target_latitude) / degree - angle / degree, velocity)


@pytest.mark.parametrize(("seconds", "frozen"), [(0.09, True), (0.11, False)])
def test_the_command_is_frozen_just_before_the_target(seconds, frozen):
    before, after = cycle(state=to_go(seconds), duration=0.02)
    same = float(after.controls.angle_of_attack) == 0.23
    assert same == frozen
    assert (float(after.controls.cos_bank) == 1.0) == frozen
    assert float(before.controls.cos_bank) == 1.0


def test_before_the_first_cycle_it_flies_level_at_trim():
    _, held = LAW.init(Measurement(at(), number(3.0), number(2.0), *2 * [number(0.0)]))
    assert float(held.controls.angle_of_attack) == pytest.approx(10 * degree)
    assert float(held.controls.cos_bank) == 1.0 and float(held.controls.sin_bank) == 0.0
    assert float(held.duration) == 1.0 and float(held.count) == 0.0
    assert float(held.shape.first) == 0.848 and float(held.shape.second) == 0.717


# When and how the curve is adjusted.


def test_epochs_fall_on_every_25th_cycle_and_not_near_the_target():
    counts = jnp.arange(101.0)
    due = jax.vmap(lambda c: Epochs(every=25).due(c, number(800.0)))(counts)
    np.testing.assert_array_equal(np.flatnonzero(due), [0, 25, 50, 75, 100])
    once = jax.vmap(lambda c: Epochs(every=None).due(c, number(800.0)))(counts)
    np.testing.assert_array_equal(np.flatnonzero(once), [0])
    for seconds, expected in ((60.0, False), (60.1, True)):
        assert bool(Epochs(every=25).due(number(50.0), number(seconds))) == expected
    assert bool(Epochs(every=25, last=10.0).due(number(50.0), number(11.0)))


@pytest.mark.parametrize("count", [0.0, 1.0, 24.0, 25.0, 26.0, 50.0])
def test_the_law_adjusts_at_its_epochs_alone(count):
    before, after = cycle(drag=1.2, count=count)
    assert (float(after.shape.second) != 0.75) == (count % 25.0 == 0.0)
    assert float(after.shape.first) == float(before.shape.first) == 0.848


def by_polynomial(to_go, predicted):
    """Equation (38), the nominal velocity and the polynomial being those of the place."""
    nominal, p0, p1, p2 = (
        np.interp(to_go, TO_GO, column) for column in (NOMINAL, *POLYNOMIALS.T)
    )
    x = (nominal - predicted) / 100.0
    return p0 + p1 * x + p2 * x * x


@pytest.mark.parametrize("drag", [0.9, 1.0, 1.2])
def test_k2_is_that_of_the_polynomial_at_the_place(drag):
    """Predicted with the nominal k2, not with the one that is held (here 0.75)."""
    _, after = cycle(drag=drag, count=25.0)
    to_go = float(LAW.track.target_latitude - LAW.track.position(at()).along)
    expected = by_polynomial(to_go, 2600.0 + 300.0 * (drag - 1.0))
    assert float(after.shape.second) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("drag", "bound"), [(9.0, 1.05), (-0.9, 0.3)])
def test_k2_stays_within_its_bounds(drag, bound):
    steep = dataclasses.replace(POLYNOMIAL, polynomials=[[0.7, -0.1, 0.0]] * 2)
    law = dataclasses.replace(LAW, velocity_control=steep)
    assert float(cycle(law, drag=drag, count=25.0)[1].shape.second) == bound


def situation(second=0.717, lift=1.0, drag=1.0):
    start = PathPoint(*map(number, (0.2, 42e3, 3e-4, -9e3, 2e-3)))
    shape = Shape(number(0.848), number(second))
    factors = Factors(number(lift), number(drag))
    return Situation(start, number(5600.0), shape, LAW.target(), factors)


def adjusted(control, here, cycle=0.0):
    found = control.adjusted(
        LAW.glide(constraints()), here, number(cycle), number(800.0)
    )
    return float(found[0].second)


def test_a_step_of_newton_is_exact_for_a_line_and_limited():
    control = NewtonAdjustment(2650.0, Linear())
    assert adjusted(control, situation()) == pytest.approx(0.767, rel=1e-13)
    # Towards less: the prediction is too fast by 250 m/s, a third of the room is 0.225.
    slower = dataclasses.replace(control, target_velocity=2350.0)
    assert adjusted(slower, situation()) == pytest.approx(0.717 - 0.225, rel=1e-13)
    twice = dataclasses.replace(slower, iterations=2)
    assert adjusted(twice, situation()) == pytest.approx(0.717 - 0.25, rel=1e-13)
    assert adjusted(control, situation(), cycle=7.0) == 0.717


def test_newton_leaves_the_curve_where_nothing_is_predicted():
    control = NewtonAdjustment(2650.0, Unknown())
    assert adjusted(control, situation(0.6)) == 0.6


def test_bounds_and_features_of_each_rule():
    here = situation()
    to_go = float(here.target.along) - 0.2
    assert [float(x) for x in StoredParameters().bounds(here.point, here.target)] == [
        0.3,
        1.05,
    ]
    found = Subdivision().bounds(here.point, here.target)
    np.testing.assert_allclose(found, [0.01 * to_go, 0.9 * to_go], rtol=1e-14)
    shape = Shape(number(0.1), number(0.3))
    found = StoredParameters().features(shape, here.point, here.target)
    assert [float(x) for x in found] == [0.1, 0.3]
    found = Subdivision().features(shape, here.point, here.target)
    np.testing.assert_allclose(found, [0.1 / to_go, 0.3 / to_go], rtol=1e-14)


# What a network is told, and what its output means.


def test_features_by_hand():
    here = situation(0.7, 1.03, 0.98)
    to_go = float(here.target.along) - 0.2
    expected = [to_go, 4.2, -100.0 * 9e3 / (6371e3 + 42e3), 3.0, 2.0, 5.6]
    expected += [0.848, 0.7, 1.03, 0.98]
    found = features(LAW.glide(constraints()), here, Inputs.ALL)
    np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_output_of_a_network_is_the_logarithm_of_the_velocity_per_radian():
    here = situation()
    to_go = float(here.target.along) - 0.2
    output = np.log(5600.0 / 2650.0) / to_go
    # A network that always says so predicts that velocity.
    says = Network(
        (jnp.zeros((1, 8)),),
        (jnp.zeros(1),),
        Inputs.STATE.names,
        jnp.zeros(8),
        jnp.ones(8),
        jnp.tile(jnp.array([-1e9, 1e9]), (8, 1)),
        output,
        1.0,
    )
    velocities = jnp.array([1e3, 4e3])
    predictor = NetworkPredictor(says, velocities, Inputs.STATE)
    predicted = predictor.predict(LAW.glide(constraints()), here)
    assert float(predicted) == pytest.approx(2650.0, rel=1e-13)


def test_the_standard_atmosphere_flies_and_is_on_board():
    scenario = find_mission("cav-h").scenario_of("newton world us-1976")
    flown = scenario.planet.atmosphere.undisturbed
    known = scenario.guidance.model.planet.atmosphere
    assert isinstance(flown, USStandardAtmosphere1976)
    assert isinstance(known, USStandardAtmosphere1976)


# Deciding together, each for itself.


def test_a_batch_that_is_due_for_some_leaves_the_others():
    due = jnp.array([False, True, False])
    values = jnp.array([1.0, 2.0, 3.0])
    batch = jax.vmap(lambda d, x: where_due(d, lambda x: 10.0 * x, x))
    np.testing.assert_array_equal(batch(due, values), [1.0, 20.0, 3.0])
    np.testing.assert_array_equal(batch(due & False, values), values)
    np.testing.assert_array_equal(jax.jit(batch)(due | True, values), 10.0 * values)
