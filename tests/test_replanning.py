"""Re-planning of a ground track: one decision at a time, against the motion by hand."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sx_2_by_hand as hand
from scipy.integrate import solve_ivp

from jentry import find_mission
from jentry.guidance import (
    AdjustedProfile,
    Adjustment,
    MeasuredForces,
    ReplannedTracking,
    TrackErrors,
)
from jentry.motion import EntryState
from jentry.onboard import FactorEstimator, Measurement, PolynomialProfile
from jentry.units import degree


LIMITS = np.array([3.0 * degree, 0.4, 15.0 * degree])


@pytest.fixture(scope="module")
def scenario():
    return find_mission("sx-2").scenario("replanned")


@pytest.fixture(scope="module")
def law(scenario):
    return scenario.guidance


@eqx.filter_jit
def update(law, measurement, memory, held):
    return law.update(jnp.asarray(100.0), measurement, memory, held)


@eqx.filter_jit
def act(law, measurement, memory, held):
    return law(jnp.asarray(100.0), measurement, memory, held)


def sensed(state, lift=1.0, drag=1.0, angle=19.0 * degree) -> Measurement:
    """By the factors on the forces of the notes."""
    r, v = hand.R0 + float(state.altitude), float(state.velocity)
    forces = lift * hand.lift(r, v, angle), drag * hand.drag(r, v, angle)
    numbers = *forces, angle, 20.0 * degree
    return Measurement(state, *(jnp.asarray(x) for x in numbers))


def decided(law, measurement, times=1):
    memory, held = law.init(measurement)
    for _ in range(times):
        memory, held = update(law, measurement, memory, held)
    return memory, held


def coefficients(held) -> np.ndarray:
    return np.array([float(x) for x in jax.tree.leaves(held.adjustment)])


def flown_by_hand(state, factors, adjustment) -> np.ndarray:
    """Downrange and crossrange at the end, rad: another integrator, other equations."""
    shift, factor, turn = adjustment
    r = hand.R0 + float(state.altitude)
    v = float(state.velocity)
    chi = 0.5 * np.pi - float(state.heading)
    angles = [float(x) for x in (state.longitude, state.latitude)]
    x = np.array([r, *angles, v, float(state.flight_path_angle), chi])

    def slope(e, x):
        r, v = x[0], x[3]
        angle = hand.reference_angle(e) + shift
        # To the left, where the adjustment is to the right.
        bank = (1.0 + factor) * hand.reference_bank(e) - turn
        lift = factors[0] * hand.lift(r, v, angle)
        drag = factors[1] * hand.drag(r, v, angle)
        return hand.flow(x, lift * np.cos(bank), lift * np.sin(bank), drag)

    span = (hand.share(r, v), 0.0)
    end = solve_ivp(slope, span, x, rtol=1e-10, atol=1e-12, max_step=0.003)
    return end.y[1:3, -1]


def aim(law):
    read = law.law.reference.with_derivatives(law.end)
    return np.array([read[name][0] for name in ("downrange", "crossrange")])


@pytest.mark.slow
def test_the_plan_is_the_motion_by_hand(scenario, law):
    """The table that the law tracks, between its nodes: at both ends, at the reversal of
    the bank, and beyond the start."""
    nodes = np.array([0, 1, 2, 78, 1500, 2640, 2650, 2660, 3997, 3998, 3999])
    shares = 1.02 * (1.0 - (nodes + 0.3) / 4000.0)
    start = np.array(
        [hand.R0 + 200e3 * hand.FOOT, 0.0, 0.0, 17e3 * hand.FOOT, 0.0, 0.0]
    )

    def flown(last):
        accurate = dict(method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.003)
        way = lambda _, x: hand.reference_flow(x)
        return solve_ivp(way, (1.0, last), start, dense_output=True, **accurate)

    back, on = flown(1.02), flown(0.0)
    read = jax.vmap(law.law.reference.with_derivatives)(hand.LAST + shares * hand.SPAN)
    for place, share in enumerate(shares):
        x = (back if share > 1.0 else on).sol(share)
        flow = hand.reference_flow(x)
        wanted = {
            "downrange": x[1],
            "downrange_first": flow[1],
            "downrange_second": hand.downrange_curvature(x),
            "downrange_third": hand.differences(hand.downrange_curvature, x, flow),
            "crossrange": x[2],
            "crossrange_first": flow[2],
            "crossrange_second": hand.along(hand.track_slope(2), x, flow),
        }
        found = {name: float(values[0][place]) for name, values in read.items()}
        for name, value in wanted.items():
            size = np.max(np.abs(read[name][0]))
            assert found[name] == pytest.approx(value, abs=3e-8 * size), (name, share)
    # Where the table ends is the target.
    end, target = on.y[:, -1], scenario.target
    found = target.altitude, target.downrange, target.crossrange, target.velocity
    wanted = end[0] - hand.R0, hand.R0 * end[1], hand.R0 * end[2], end[3]
    assert [float(x) for x in found] == pytest.approx(wanted, abs=1e-4)
    found = target.flight_path_angle, target.heading
    wanted = end[4], 0.5 * np.pi - end[5]
    assert [float(x) for x in found] == pytest.approx(wanted, abs=1e-10)


def on_the_way(share=0.6, altitude=52.0e3) -> EntryState:
    """At a share of the energy, close to the reference."""
    v = np.sqrt(2.0 * (hand.LAST + share * hand.SPAN + hand.MU / (hand.R0 + altitude)))
    return EntryState(altitude, 0.16, 0.012, v, -0.4 * degree, 81.0 * degree)


@pytest.mark.slow
def test_on_the_reference_nothing_is_changed(scenario, law):
    """The command is that of the reference controls."""
    measurement = sensed(scenario.initial_state)
    memory, held = decided(law, measurement)
    # What a hundred steps leave of the prediction, 50 m of 2000 km, moves this much.
    assert np.all(np.abs(coefficients(held)) < 1e-3 * LIMITS)
    assert float(held.estimate.factors.lift) == pytest.approx(1.0, abs=1e-12)
    controls, _ = act(law, measurement, memory, held)
    bank = np.arctan2(controls.sin_bank, controls.cos_bank)
    shift, factor, turn = coefficients(held)
    angle = hand.reference_angle(1.0) + shift
    assert float(controls.angle_of_attack) == pytest.approx(angle, rel=1e-9)
    wanted = -(1.0 + factor) * hand.reference_bank(1.0) + turn
    assert bank == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("lift, drag", [(0.78, 0.83), (1.22, 1.17), (1.0, 1.05)])
def test_the_plan_ends_at_the_target(scenario, law, lift, drag):
    """By another integrator on other equations, from the start and from on the way."""
    for state, close in ((scenario.initial_state, 300.0), (on_the_way(), 30.0)):
        _, held = decided(law, sensed(state, lift, drag), times=9)
        factors = held.estimate.factors
        assert (factors.lift, factors.drag) == pytest.approx((lift, drag), rel=1e-12)
        found = coefficients(held)
        assert np.all(np.abs(found) < LIMITS)
        missed = hand.R0 * (flown_by_hand(state, (lift, drag), found) - aim(law))
        nothing = hand.R0 * (flown_by_hand(state, (lift, drag), np.zeros(3)) - aim(law))
        assert np.all(np.abs(missed) < close)  # m: the error of a hundred steps
        assert np.max(np.abs(nothing)) > 30e3


def test_a_decision_is_a_damped_step_of_least_norm(law):
    """By least squares on differences of the motion by hand; the largest are cut."""
    state, forces = on_the_way(), (0.95, 1.0)

    def missed(shares):
        return hand.R0 * (flown_by_hand(state, forces, shares * LIMITS) - aim(law))

    h = 1e-3
    columns = [(missed(h * u) - missed(-h * u)) / (2 * h) for u in np.eye(3)]
    miss = missed(np.zeros(3))
    for least in (20.0, 30e3):
        damped = dataclasses.replace(law, least_effect=least, largest_step=9.0)
        _, held = decided(damped, sensed(state, *forces))
        damping = np.hypot(least, float(law.least_share) * np.linalg.norm(miss))
        system = np.vstack([np.array(columns).T, damping * np.eye(3)])
        wanted = np.linalg.lstsq(system, np.concatenate([-miss, np.zeros(3)]))[0]
        assert 0.05 < np.max(np.abs(wanted)) < 1.0
        # A hundred steps leave some thousandths of the difference that a change makes.
        close = 3e-3 * np.max(np.abs(wanted))
        np.testing.assert_allclose(coefficients(held) / LIMITS, wanted, atol=close)
    shorter = dataclasses.replace(law, largest_step=1e-3)
    _, held = decided(shorter, sensed(state, *forces))
    np.testing.assert_allclose(np.abs(coefficients(held)) / LIMITS, 1e-3, rtol=1e-12)


def test_what_cannot_be_reached_is_flown_at_the_limits(law):
    """With a third of the lift; the numbers stay within bounds however often."""
    _, held = decided(law, sensed(on_the_way(), 0.33, 1.2), times=12)
    found = np.abs(coefficients(held)) / LIMITS
    assert np.all(found <= 1.0 + 1e-12) and np.max(found) == pytest.approx(1.0)
    assert float(held.without_prediction) == 0.0


def test_where_the_end_cannot_be_moved_the_controls_stay(law):
    """A quarter of a second before it, many kilometres off: no coefficient moves."""
    near = on_the_way(2e-4, 25.7e3)
    near = dataclasses.replace(near, flight_path_angle=-6.3 * degree, longitude=0.31)
    _, held = decided(law, sensed(near, 1.1, 0.9, 12.0 * degree))
    assert np.all(np.abs(coefficients(held)) < 1e-2 * LIMITS)


def test_without_a_prediction_the_controls_stay(law):
    """Below the final energy. The results tell the share of such decisions."""
    measurement = sensed(on_the_way(), 0.9, 1.0)
    memory, held = decided(law, measurement)
    before = coefficients(held)
    assert np.max(np.abs(before)) > 1e-3
    beyond = sensed(on_the_way(-0.01, 25e3), 0.8, 1.0)
    _, after = update(law, beyond, memory, held)
    np.testing.assert_array_equal(coefficients(after), before)
    assert float(after.estimate.factors.lift) == pytest.approx(0.8)
    share = law.caveats(after)["decisions_without_prediction"]
    assert float(share) == 0.5
    assert float(law.caveats(held)["decisions_without_prediction"]) == 0.0
    assert (
        float(law.caveats(law.init(measurement)[1])["decisions_without_prediction"])
        == 0.0
    )


def test_a_decision_begins_the_reference_again(law):
    measurement = sensed(on_the_way())
    memory, held = law.init(measurement)
    off = dataclasses.replace(memory.state, altitude=jnp.asarray(50e3))
    errors = TrackErrors(jnp.asarray(0.1), jnp.asarray(-0.2))
    memory = dataclasses.replace(memory, state=off, errors=errors)
    memory, _ = update(law, measurement, memory, held)
    assert float(memory.state.altitude) == float(measurement.state.altitude)
    assert float(memory.errors.downrange) == float(memory.errors.crossrange) == 0.0


def test_the_reference_moves_as_the_vehicle_does(law):
    """At its energy: it falls at the rate at which that of the vehicle falls."""
    state = on_the_way()
    measurement = sensed(state, 0.9, 1.1)
    memory, held = decided(law, measurement, times=2)
    shift, factor, turn = coefficients(held)
    angle = hand.reference_angle(0.6) + shift
    bank = (1.0 + factor) * hand.reference_bank(0.6) - turn
    r, v = hand.R0 + float(state.altitude), float(state.velocity)
    x = np.array([r, 0.16, 0.012, v, -0.4 * degree, 9.0 * degree])
    lift, drag = 0.9 * hand.lift(r, v, angle), 1.1 * hand.drag(r, v, angle)
    over = hand.flow(x, lift * np.cos(bank), lift * np.sin(bank), drag)
    # The drag that is sensed need not be that of the reference.
    measurement = dataclasses.replace(measurement, drag=1.3 * measurement.drag)
    controls, rate = act(law, measurement, memory, held)
    falls = -v * float(measurement.drag) / hand.SPAN
    names = ("altitude", "longitude", "latitude", "velocity", "flight_path_angle")
    found = [float(getattr(rate.state, name)) for name in names]
    np.testing.assert_allclose(found, over[:5] * falls, rtol=1e-9)
    assert float(rate.state.heading) == pytest.approx(-over[5] * falls, rel=1e-9)
    # The energy that falls is the vehicle's, and not that of the reference.
    faster = dataclasses.replace(state, velocity=1.01 * state.velocity)
    _, later = act(law, dataclasses.replace(measurement, state=faster), memory, held)
    assert float(later.state.altitude) == pytest.approx(1.01 * found[0], rel=1e-9)
    # Where both are in one state the command is that of the reference.
    assert float(controls.angle_of_attack) == pytest.approx(angle, rel=1e-9)
    # Off it, the errors are integrated, and the law steers back.
    behind = dataclasses.replace(
        memory, state=dataclasses.replace(state, longitude=0.16 + 2e-4)
    )
    later, rate = act(law, measurement, behind, held)
    assert float(rate.errors.downrange) == pytest.approx(-2e-4 * falls, rel=1e-9)
    assert abs(float(later.angle_of_attack - controls.angle_of_attack)) > 5e-4


def test_the_command_does_not_depend_on_the_forces_of_its_instant(law):
    measurement = sensed(on_the_way(), 0.9, 1.1)
    memory, held = decided(law, measurement)
    other = dataclasses.replace(
        measurement, lift=2.0 * measurement.lift, drag=3.0 * measurement.drag
    )
    commands = [act(law, m, memory, held)[0] for m in (measurement, other)]
    for one, two in zip(*map(jax.tree.leaves, commands), strict=True):
        assert float(one) == float(two)


def test_the_band_stays_about_the_reference_of_the_law(law):
    """Far off its own motion the law commands a bound: that of the paper."""
    measurement = sensed(on_the_way())
    memory, held = law.init(measurement)
    adjustment = Adjustment(jnp.asarray(3.0 * degree), *2 * [jnp.asarray(0.0)])
    held = dataclasses.replace(held, adjustment=adjustment)
    reference = hand.reference_angle(0.6)
    deviations = []
    for ahead in (0.02, -0.02):
        far = dataclasses.replace(
            memory.state, longitude=memory.state.longitude + ahead
        )
        memory = dataclasses.replace(memory, state=far)
        controls, _ = act(law, measurement, memory, held)
        deviations.append(float(controls.angle_of_attack) - reference)
    assert deviations[0] == pytest.approx(5.0 * degree, rel=1e-9)
    assert np.all(np.abs(deviations) <= 5.0 * degree * (1.0 + 1e-9))


def test_old_samples_fade_over_the_guidance_cycle(law):
    """Two samples of equal weight, one of them a cycle of 10 s old."""
    estimator = FactorEstimator(time_constant=20.0)
    remembering = dataclasses.replace(law, estimator=estimator)
    memory, held = decided(remembering, sensed(on_the_way(), 0.9, 1.1))
    _, held = update(remembering, sensed(on_the_way(), 0.8, 1.0), memory, held)
    faded = np.exp(-10.0 / 20.0)
    found = held.estimate.factors
    assert float(found.lift) == pytest.approx((0.8 + faded * 0.9) / (1.0 + faded))
    assert float(found.drag) == pytest.approx((1.0 + faded * 1.1) / (1.0 + faded))


@pytest.mark.slow
def test_a_decision_has_the_derivatives_of_differences(law):
    """In the state and in the forces, through the prediction and its own derivatives."""
    free = dataclasses.replace(law, largest_step=9.0)
    measurement = sensed(on_the_way(), 0.95, 1.02)
    memory, held = law.init(measurement)
    direction = jax.tree.map(lambda x: 0.01 * x, measurement)

    @eqx.filter_jit
    def pushed(h):
        def found(h):
            moved = jax.tree.map(lambda x, d: x + h * d, measurement, direction)
            after = free.update(h, moved, memory, held)[1].adjustment
            return jnp.stack(jax.tree.leaves(after)) / LIMITS

        return jax.jvp(found, (h,), (jnp.ones_like(h),))

    one = jnp.ones(())
    step = 1e-3 * one
    difference = (pushed(step)[0] - pushed(-step)[0]) / (2.0 * step)
    _, rate = pushed(0.0 * one)
    assert np.max(np.abs(rate)) > 0.1
    # Central differences with a share of 1e-5.
    np.testing.assert_allclose(rate, difference, rtol=1e-4, atol=1e-4)


def test_an_adjusted_profile():
    profile = AdjustedProfile(PolynomialProfile([1.0, 2.0, 3.0]), 1.5, -0.25)
    found = [float(x) for x in profile.with_derivatives(jnp.asarray(2.0))]
    assert found == [1.5 * 17.0 - 0.25, 1.5 * 14.0, 1.5 * 6.0]


def test_bad_input_is_refused(law):
    measuring = dataclasses.replace(law.law, force_knowledge=MeasuredForces())
    with pytest.raises(
        ValueError, match="force_knowledge of the law is MeasuredForces"
    ):
        ReplannedTracking(measuring, law.limits, law.end)
    with pytest.raises(ValueError, match="steps is 0"):
        ReplannedTracking(law.law, law.limits, law.end, steps=0)
    for end in (hand.FIRST + 0.1 * hand.SPAN, hand.LAST - 0.1 * hand.SPAN):
        with pytest.raises(ValueError, match="J/kg: the reference is known from"):
            ReplannedTracking(law.law, law.limits, end)
