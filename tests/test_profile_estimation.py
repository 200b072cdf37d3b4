"""Factors of lift and drag over the altitude, as they are learnt on the way down."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import bank_profile, mars_scenario

from jentry.guidance.open_loop import vertical_lift_command
from jentry.motion import EquatorialDynamics
from jentry.onboard import FactorEstimator, OnboardModel, propagate
from jentry.onboard.profile_estimation import (
    FactorPrior,
    FactorProfile,
    Learnt,
    ProfileEstimator,
)
from jentry.units import km
from jentry.world import DensityWave, PerturbedAtmosphere


WAVELENGTHS, AMPLITUDES = np.array([25 * km, 8 * km]), np.array([0.05, 0.02])
CONSTANT, SLOPE, PIVOT = 0.1, 2e-6, 40 * km
DEPARTURE = FactorPrior(WAVELENGTHS, AMPLITUDES, CONSTANT, SLOPE, PIVOT)

SCENARIO = mars_scenario()
MODEL = OnboardModel(SCENARIO.planet, SCENARIO.vehicle)

COUNT = 40
"""Samples in each test, which so share what is compiled"""


def one(x):
    return jnp.asarray(x, dtype=float)


def basis(altitudes):
    """Of `DEPARTURE`, by hand: a row for each altitude."""
    h = np.asarray(altitudes)[:, None]
    turns = 2.0 * np.pi * h / WAVELENGTHS
    line = [np.full_like(h, CONSTANT), SLOPE * (h - PIVOT)]
    waves = [AMPLITUDES * np.sin(turns), AMPLITUDES * np.cos(turns)]
    return np.hstack(line + waves)


@eqx.filter_jit
def after(estimator, altitudes, sensed, expected):
    """The estimate after samples; forces as (lift, drag) in each row."""

    def update(estimate, sample):
        altitude, sensed, expected = sample
        forces = (sensed[0], sensed[1]), (expected[0], expected[1])
        return estimator.update(estimate, altitude, *forces, one(1.0)), None

    start = estimator.start(one(0.0))
    samples = tuple(jnp.asarray(x) for x in (altitudes, sensed, expected))
    return jax.lax.scan(update, start, samples)[0]


@eqx.filter_jit
def over(found, altitudes):
    """Factors (lift, drag) and their standard deviations at altitudes."""
    heights = jnp.asarray(altitudes)
    return jax.vmap(lambda h: (found.at(h), found.deviations(h)))(heights)


def pairs(factors):
    return np.stack([factors.lift, factors.drag], axis=-1)


def some_samples():
    """Altitudes, sensed and expected forces: random, from a few km to 60 km."""
    rng = np.random.default_rng(3)
    altitudes = rng.uniform(5 * km, 60 * km, COUNT)
    expected = rng.uniform(0.5, 8.0, (COUNT, 2))
    sensed = expected * rng.normal(1.05, 0.1, (COUNT, 2))
    return altitudes, sensed, expected


def test_weights_are_those_of_bayesian_least_squares():
    """Of all samples at once, along each axis; and so in any order."""
    noise, misfit = 0.03, 0.02
    estimator = ProfileEstimator(DEPARTURE, noise, misfit)
    altitudes, sensed, expected = some_samples()
    estimate = after(estimator, altitudes, sensed, expected)
    backwards = after(estimator, altitudes[::-1], sensed[::-1], expected[::-1])
    assert float(estimate.samples) == COUNT
    heights = np.linspace(5 * km, 60 * km, 12)
    factors, deviations = over(estimate.ahead, heights)
    for axis, name in enumerate(("lift", "drag")):
        rows = expected[:, axis, None] * basis(altitudes)
        variances = noise**2 + (misfit * expected[:, axis]) ** 2
        weighted = rows / variances[:, None]
        covariance = np.linalg.inv(np.eye(6) + weighted.T @ rows)
        departed = sensed[:, axis] - expected[:, axis]
        weights = covariance @ (weighted.T @ departed)
        for found in (estimate, backwards):
            learnt = getattr(found.profile, name)
            # The least eigenvalue of the covariance is 1e-3: rounding may be 1e3 times.
            np.testing.assert_allclose(learnt.weights, weights, rtol=1e-11)
            off = learnt.covariance - covariance
            np.testing.assert_array_less(np.abs(off), 1e-14)
        there = basis(heights)
        likely = 1.0 + there @ weights
        spread = np.sqrt(np.sum((there @ covariance) * there, axis=1))
        np.testing.assert_allclose(getattr(factors, name), likely, rtol=1e-11)
        np.testing.assert_allclose(getattr(deviations, name), spread, rtol=1e-11)


def test_a_sample_without_force_tells_nothing():
    altitudes, sensed, _ = some_samples()
    estimate = after(ProfileEstimator(DEPARTURE), altitudes, sensed, 0.0 * sensed)
    for learnt in (estimate.profile.lift, estimate.profile.drag):
        np.testing.assert_array_equal(learnt.weights, np.zeros(6))
        np.testing.assert_array_equal(learnt.covariance, np.eye(6))


def test_before_a_sample_it_is_the_prior():
    heights = np.linspace(-5 * km, 90 * km, 20)
    profile = ProfileEstimator(DEPARTURE).start(one(0.0)).ahead
    factors, deviations = over(profile, heights)
    np.testing.assert_array_equal(pairs(factors), np.ones((20, 2)))
    # A sine and a cosine of one deviation have it in all phases.
    variance = CONSTANT**2 + (SLOPE * (heights - PIVOT)) ** 2 + np.sum(AMPLITUDES**2)
    expected = np.sqrt(np.stack([variance, variance], axis=1))
    np.testing.assert_allclose(pairs(deviations), expected, rtol=1e-13)


def test_waves_that_are_known_are_predicted_below_the_samples():
    """From 50 km down to 38 km without noise, and on to 25 km.

    With weights w the error is phi P w, which by Cauchy and Schwarz is no more than the
    deviation times the norm of w, as P is no more than one.
    """
    sizes, phases, constant = np.array([0.05, 0.02]), np.array([0.7, -1.9]), 0.06
    departure = FactorPrior(WAVELENGTHS, sizes / np.sqrt(2), CONSTANT, SLOPE, PIVOT)
    # Each wave has a sine and a cosine, whose squares add up to those of two deviations.
    norm = np.sqrt((constant / CONSTANT) ** 2 + 2.0 * len(sizes))

    def factor(h):
        waves = np.sin(2.0 * np.pi * h[:, None] / WAVELENGTHS + phases)
        return 1.0 + constant + waves @ sizes

    altitudes = np.linspace(50 * km, 38 * km, COUNT)
    expected = np.stack([np.linspace(1.0, 4.0, COUNT), np.linspace(2.0, 9.0, COUNT)], 1)
    sensed = expected * factor(altitudes)[:, None]
    estimator = ProfileEstimator(departure, 1e-4, 1e-4)
    estimate = after(estimator, altitudes, sensed, expected)
    below = np.linspace(38 * km, 25 * km, 27)
    found, deviations = over(estimate.ahead, below)
    actual, last = factor(below), pairs(estimate.factors)
    np.testing.assert_allclose(last, actual[[0, 0]], rtol=1e-12)
    bounds = norm * pairs(deviations)
    assert np.max(bounds) < 0.1 * np.max(np.abs(actual - actual[0]))
    assert np.all(np.abs(pairs(found) - actual[:, None]) < bounds)


def test_deviations_grow_from_the_samples_to_those_of_the_prior():
    departure = FactorPrior.correlated(5 * km, 0.04, 0.0, 80 * km, constant=0.0)
    altitudes = np.linspace(60 * km, 40 * km, COUNT)
    expected = np.full((COUNT, 2), [2.0, 4.0])
    noise = 1e-3
    estimator = ProfileEstimator(departure, noise, 1e-9)
    estimate = after(estimator, altitudes, expected, expected)
    below = np.linspace(40 * km, 20 * km, 41)
    _, deviations = over(estimate.ahead, below)
    for found, force in ((deviations.lift, 2.0), (deviations.drag, 4.0)):
        # Where there is a sample it is known at least as well as by this one.
        assert found[0] <= noise / force
        assert np.all(np.diff(found) > 0.0)
        # Four lengths away, exp(-8) of it is correlated with what was sampled.
        assert found[-1] == pytest.approx(0.04, rel=1e-3)


def test_caution_takes_standard_deviations_off():
    altitudes, sensed, expected = some_samples()
    how = altitudes, sensed, expected
    heights = np.linspace(5 * km, 60 * km, 12)
    likely, deviations = over(after(ProfileEstimator(DEPARTURE), *how).ahead, heights)
    cautious = ProfileEstimator(DEPARTURE, caution=1.5)
    found, same = over(after(cautious, *how).ahead, heights)
    taken = pairs(likely) - 1.5 * pairs(deviations)
    np.testing.assert_allclose(pairs(found), taken, rtol=1e-14)
    np.testing.assert_allclose(pairs(same), pairs(deviations), rtol=1e-11)
    assert np.min(pairs(deviations)) > 1e-4
    # Before a sample as well.
    found = over(cautious.start(one(0.0)).ahead, [PIVOT])[0]
    expected = 1.0 - 1.5 * math.sqrt(CONSTANT**2 + np.sum(AMPLITUDES**2))
    np.testing.assert_allclose(pairs(found), [[expected, expected]], rtol=1e-14)


def test_factors_do_not_fall_below_a_fifth():
    """And what is not a number remains none."""
    for weight, factor in ((-7.9, 0.21), (-8.1, 0.2), (-40.0, 0.2), (math.nan,) * 2):
        known = Learnt(one([weight, 0, 0, 0, 0, 0]), jnp.zeros((6, 6)))
        found = FactorProfile(DEPARTURE, known, known, None)
        there = pairs(over(found, [30 * km])[0])
        np.testing.assert_allclose(there, [[factor, factor]], rtol=1e-14)
    careful = ProfileEstimator(DEPARTURE, caution=100.0).start(one(0.0)).ahead
    np.testing.assert_array_equal(pairs(over(careful, [0.0])[0]), [[0.2, 0.2]])


def share(estimate):
    return float(estimate.caveats()["surprising_samples"])


@pytest.mark.parametrize(
    ("lift", "drag", "expected"),
    [(3.9, -3.9, 0.0), (4.1, 0.0, 0.5), (0.0, -4.1, 0.5), (-4.1, 4.1, 0.5)],
)
def test_samples_that_the_prior_makes_unlikely_are_counted(lift, drag, expected):
    """The first as expected, the second so many deviations off: 4 are the limit."""
    estimator = ProfileEstimator(DEPARTURE, 0.03, 0.02)
    altitudes, forces = np.array([50 * km, 45 * km]), np.array([[4.0, 2.0], [5.0, 3.0]])
    before, second = basis(altitudes)
    deviations = []
    for first, force in forces.T:
        row = first * before
        variance = 0.03**2 + (0.02 * first) ** 2
        covariance = np.eye(6) - np.outer(row, row) / (row @ row + variance)
        there = force * second
        variance = 0.03**2 + (0.02 * force) ** 2
        deviations.append(np.sqrt(there @ covariance @ there + variance))
    sensed = forces.copy()
    sensed[1] += np.array([lift, drag]) * deviations
    assert share(after(estimator, altitudes, sensed, forces)) == expected


def test_consistent_samples_surprise_nobody():
    """Of what the prior draws none of 40 is beyond 4 deviations; before a sample none."""
    rng = np.random.default_rng(7)
    altitudes, _, expected = some_samples()
    factor = 1.0 + basis(altitudes) @ rng.normal(size=(6, 2))
    variances = 0.03**2 + (0.02 * expected) ** 2
    sensed = expected * factor + np.sqrt(variances) * rng.normal(size=(COUNT, 2))
    estimator = ProfileEstimator(DEPARTURE, 0.03, 0.02)
    estimate = after(estimator, altitudes, sensed, expected)
    assert share(estimate) == 0.0 and share(estimator.start(one(0.0))) == 0.0


@pytest.mark.parametrize("time_constant", [0.0, 7.0])
def test_where_the_vehicle_is_it_goes_by_the_estimator_without_a_profile(time_constant):
    """Without memory, as it is if none is given, that is the last ratio."""
    here = FactorEstimator(time_constant)
    given = {"here": here} if time_constant else {}
    altitudes, sensed, expected = some_samples()
    found, plain = (
        pairs(after(estimator, altitudes, sensed, expected).factors)
        for estimator in (ProfileEstimator(DEPARTURE, **given), here)
    )
    np.testing.assert_allclose(found, plain, rtol=1e-14)
    is_last = np.allclose(found, sensed[-1] / expected[-1], rtol=1e-13, atol=0.0)
    assert is_last == (time_constant == 0.0)


def test_a_sample_that_is_not_a_number_leaves_none():
    """Nothing that looks right: along its axis all factors ahead are NaN from then on.

    The covariance knows nothing of what was sensed. Such samples are surprises.
    """
    altitudes, sensed, expected = some_samples()
    sensed[COUNT // 2, 1] = math.nan
    estimate = after(ProfileEstimator(DEPARTURE), altitudes, sensed, expected)
    assert np.all(np.isfinite(estimate.profile.lift.weights))
    assert np.all(np.isnan(estimate.profile.drag.weights))
    factors, deviations = over(estimate.ahead, [10 * km, 30 * km])
    assert np.all(np.isfinite(factors.lift)) and np.all(np.isnan(factors.drag))
    assert np.all(np.isfinite(pairs(deviations)))
    # From the first one on, what is believed is not a number either.
    assert share(estimate) >= 0.5


WAVE_PHASES = np.array([0.4, 2.6])
SIZES = np.array([0.06, 0.03])
_SHARES = SIZES / AMPLITUDES
WEIGHTS = np.hstack(
    [0.5, 1.5, _SHARES * np.cos(WAVE_PHASES), _SHARES * np.sin(WAVE_PHASES)]
)
"""Of the density that `disturbed` has"""


@eqx.filter_jit
def predicted(model, lift, drag):
    """Under weights; none for the model as it is."""
    known = (Learnt(weights, jnp.eye(6)) for weights in (lift, drag))
    factors = None if lift is None else FactorProfile(DEPARTURE, *known, None)

    def command(time, state):
        return vertical_lift_command(bank_profile().cos_bank(state.velocity), one(0.0))

    return propagate(
        model,
        SCENARIO.initial_state,
        command,
        (lambda state: state.velocity - 503.0, lambda state: state.altitude - 10e3),
        step=3.0,
        steps=128,
        factors=factors,
        dynamics=EquatorialDynamics(),
    )


def downrange(end):
    return end.state.longitude * MODEL.planet.radius


def disturbed():
    """The model in air with these waves, and with a constant and a slope as a trend."""
    waves = tuple(
        DensityWave(*wave) for wave in zip(SIZES, WAVELENGTHS, WAVE_PHASES, strict=True)
    )
    constant, slope = WEIGHTS[0] * CONSTANT, WEIGHTS[1] * SLOPE
    low, high = 0.0, 200 * km
    ends = [constant + slope * (h - PIVOT) for h in (low, high)]
    still = SCENARIO.planet.atmosphere
    air = PerturbedAtmosphere(still, waves, 1.0, low, high, *ends)
    return eqx.tree_at(lambda m: m.planet.atmosphere, MODEL, air)


def test_a_profile_of_waves_is_air_with_these_waves():
    weights = jnp.asarray(WEIGHTS)
    found = predicted(MODEL, weights, weights)
    expected = predicted(disturbed(), None, None)
    assert bool(found.has_end) and int(found.ended_by) == int(expected.ended_by)
    ends = jax.tree.leaves(found), jax.tree.leaves(expected)
    np.testing.assert_allclose(*ends, rtol=1e-9, atol=1e-9)
    plain = predicted(MODEL, 0.0 * weights, 0.0 * weights)
    assert abs(float(downrange(found) - downrange(plain))) > 1e3


@pytest.mark.slow
def test_a_prediction_has_derivatives_in_the_weights():
    """Of the end, where the phase of a wave and the constant go."""

    def reached(weight, place):
        weights = jnp.asarray(WEIGHTS)
        return downrange(predicted(MODEL, weights, weights.at[place].set(weight)))

    slope = jax.jit(jax.jacfwd(reached))
    for place in (0, 5):
        at, h = WEIGHTS[place], 1e-4
        ends = [float(reached(one(at + d), place)) for d in (h, -h)]
        difference = (ends[0] - ends[1]) / (2.0 * h)
        assert abs(difference) > 100.0  # m for one deviation
        found = float(slope(one(at), place))
        assert found == pytest.approx(difference, rel=1e-6)
