"""Accelerometers with errors, and the factors that the vehicle infers from them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import fly_compiled, mars_scenario

from jentry.flight import FixedStep, fly
from jentry.guidance import AbstractContinuousLaw, Sampled, SmoothReversals
from jentry.motion import AirData, Controls
from jentry.onboard import Accelerometers, FactorEstimator, PerfectAccelerometers


def air(lift, drag):
    numbers = (1e-3, 5e3, 1.2e4, 15.0, lift, drag, 0.0)
    return AirData(*(jnp.asarray(x) for x in numbers))


def read(accelerometers, time=None):
    sampled_at = None if time is None else jnp.asarray(time)
    force = accelerometers.read(air(4.0, 2.0), sampled_at)
    assert force.side == 0.0
    return [float(force.lift), float(force.drag)]


def test_perfect_accelerometers_read_the_forces():
    assert read(PerfectAccelerometers(), 1.0) == [4.0, 2.0]
    assert read(Accelerometers(), 1.0) == [4.0, 2.0]


def test_bias_and_scale_are_of_each_axis():
    accelerometers = Accelerometers(1e-3, -2e-3, 3e-4, 5e-4)
    assert read(accelerometers) == pytest.approx(
        [4.0 * 1.0003 + 1e-3, 2.0 * 1.0005 - 2e-3], rel=1e-15
    )


def test_noise_is_of_samples_and_belongs_to_the_seed():
    times = jnp.arange(4000) * 0.1

    @jax.jit
    def noise(seed):
        accelerometers = Accelerometers(noise=5e-4, noise_seed=seed)
        values = jax.vmap(
            lambda t: jnp.stack(accelerometers.read(air(4.0, 2.0), t)[:2])
        )
        return values(times) - jnp.array([[4.0, 2.0]])

    first, again, other = (
        np.asarray(noise(jnp.asarray(s))) for s in (0.25, 0.25, 0.7312)
    )
    np.testing.assert_array_equal(first, again)
    for sample in (first[:, 0], first[:, 1], other[:, 0]):
        # Four standard errors of 4000 samples.
        assert np.std(sample) == pytest.approx(5e-4, rel=4.0 / np.sqrt(8000))
        assert abs(np.mean(sample)) < 4.0 * 5e-4 / np.sqrt(4000)
    for a, b in ((first[:, 0], first[:, 1]), (first[:, 0], other[:, 0])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4.0 / np.sqrt(4000)
    assert abs(np.corrcoef(first[1:, 0], first[:-1, 0])[0, 1]) < 4.0 / np.sqrt(4000)
    # Read between samples there is none.
    assert read(Accelerometers(noise=5e-4, noise_seed=0.25)) == [4.0, 2.0]


def test_noise_is_refused_where_it_would_not_be_sampled():
    scenario = dataclasses.replace(
        mars_scenario(), accelerometers=Accelerometers(noise=5e-4)
    )
    with pytest.raises(ValueError, match="accelerometers.noise is 0.0005"):
        fly(scenario, FixedStep(0.1))


class SaysWhatItSenses(AbstractContinuousLaw[None]):
    """Commands the sensed drag and lift as the cosine and the sine of the bank.

    A surrogate may command less than a whole bank.
    """

    surrogate: SmoothReversals = SmoothReversals()

    def init(self, measurement):
        return None

    def __call__(self, time, measurement, memory):
        cosine, sine = 1e-3 * measurement.drag, 1e-3 * measurement.lift
        return Controls(jnp.zeros(()), cosine, sine), None


@pytest.mark.parametrize("cycle", [None, 4.0], ids=["continuous", "sampled"])
def test_a_law_senses_the_errors_of_its_accelerometers(cycle):
    law = SaysWhatItSenses()
    scenario = dataclasses.replace(
        mars_scenario(law if cycle is None else Sampled(law, cycle), time_limit=80.0),
        accelerometers=Accelerometers(0.3, -0.2, 0.05, -0.02),
    )
    history = fly_compiled(scenario, FixedStep(1.0), 4.0).history
    drag = np.asarray(history.constraints.drag)
    sensed = 1e3 * np.asarray(history.controls.cos_bank)
    np.testing.assert_allclose(sensed, 0.98 * drag - 0.2, rtol=1e-12)
    # The lift-to-drag ratio of this vehicle is 0.18.
    sensed = 1e3 * np.asarray(history.controls.sin_bank)
    np.testing.assert_allclose(sensed, 1.05 * 0.18 * drag + 0.3, rtol=1e-12)
    assert np.max(drag) > 10.0


@pytest.mark.slow
def test_an_error_of_the_accelerometers_reaches_the_law():
    """A law that tracks the drag brings the sensed drag, not the actual one, on track."""
    from jentry.missions import find_mission

    scenario = find_mission("mars-drag-tracking").scenario()
    ends = [
        float(
            fly_compiled(
                dataclasses.replace(
                    scenario, accelerometers=Accelerometers(drag_scale_error=error)
                )
            ).state.longitude
        )
        for error in (0.0, 0.05)
    ]
    # Sensing 5 % too much the vehicle flies with less drag, and farther.
    assert ends[1] > ends[0] + 1e-4


def estimates(time_constant, sensed, expected, elapsed=1.0):
    estimator = FactorEstimator(time_constant)
    estimate = estimator.start(jnp.asarray(0.0))
    found = []
    for (lift, drag), (model_lift, model_drag) in zip(sensed, expected, strict=True):
        numbers = (jnp.asarray(x) for x in (lift, drag, model_lift, model_drag))
        lift, drag, model_lift, model_drag = numbers
        estimate = estimator.update(
            estimate,
            model_lift,
            (lift, drag),
            (model_lift, model_drag),
            jnp.asarray(elapsed),
        )
        found.append([float(estimate.factors.lift), float(estimate.factors.drag)])
    return np.array(found)


def test_without_memory_it_is_the_last_ratio():
    found = estimates(0.0, [(4.0, 2.0), (3.0, 2.2)], [(4.0, 2.5), (2.0, 2.0)])
    np.testing.assert_allclose(found, [[1.0, 0.8], [1.5, 1.1]], rtol=1e-15)


def test_with_memory_it_is_the_weighted_least_squares_fit():
    rng = np.random.default_rng(0)
    expected = rng.uniform(1.0, 5.0, (30, 2))
    sensed = expected * [1.1, 0.9] + rng.normal(0.0, 0.1, (30, 2))
    found = estimates(7.0, sensed, expected)[-1]
    kept = np.exp(-(29.0 - np.arange(30.0)) / 7.0)[:, None]
    fit = np.sum(kept * sensed * expected, 0) / np.sum(kept * expected**2, 0)
    np.testing.assert_allclose(found, fit, rtol=1e-13)


def test_a_sample_without_force_changes_nothing():
    found = estimates(5.0, [(0.1, 2.0), (4.0, 2.0)], [(0.0, 2.0), (2.0, 2.0)])
    np.testing.assert_allclose(found, [[1.0, 1.0], [2.0, 1.0]], rtol=1e-14)


def test_estimate_is_differentiable_in_the_time_constant():
    @eqx.filter_jit
    def factor(time_constant):
        estimator = FactorEstimator(time_constant)
        estimate = estimator.start(jnp.asarray(0.0))
        for lift in (2.0, 2.4, 2.1):
            sensed = jnp.asarray(lift), jnp.asarray(1.0)
            expected = jnp.asarray(2.0), jnp.asarray(1.0)
            estimate = estimator.update(
                estimate, jnp.asarray(0.0), sensed, expected, jnp.asarray(1.0)
            )
        return estimate.factors.lift

    slope = float(jax.grad(factor)(jnp.asarray(3.0)))
    step = 1e-5
    difference = (factor(jnp.asarray(3.0 + step)) - factor(jnp.asarray(3.0 - step))) / (
        2 * step
    )
    assert slope == pytest.approx(float(difference), rel=1e-7)
