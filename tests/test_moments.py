"""Draws, quantiles and moments of the distributions, against scipy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beside_scipy import ALL_DISTRIBUTIONS, DISTRIBUTIONS
from scipy import special, stats

from jentry.campaign import TruncatedNormal


DRAWS = 40_000

sample_of = jax.jit(lambda d, keys: jax.vmap(d.sample)(keys))


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_moments_and_bounds(name, key):
    distribution, reference = DISTRIBUTIONS[name]
    deviation = reference.std()
    lower, upper = reference.support()
    sample = jax.jit(jax.vmap(distribution.sample))(jax.random.split(key, DRAWS))
    # Four standard errors; that of a deviation is below that of the mean here.
    error = 4.0 * deviation / np.sqrt(DRAWS)
    assert sample.mean() == pytest.approx(reference.mean(), abs=error)
    assert sample.std() == pytest.approx(deviation, abs=error)
    assert lower <= sample.min() and sample.max() <= upper
    assert sample.dtype == jnp.float64
    # Of 53 bits all are drawn: no two of some ten thousand numbers are equal.
    assert len(np.unique(sample)) == DRAWS


TAILS = {
    "4 above": (4.0, 5.0),
    "5 to 8 above": (5.0, 8.0),
    "7 above": (7.0, 12.0),
    "8.5 above": (8.5, 9.0),
    "20 above": (20.0, 30.0),
    "36 above": (36.0, 40.0),
    "9 below": (-9.5, -9.0),
    "30 below": (-60.0, -30.0),
    "both sides": (-2.0, 30.0),
    "no bounds to speak of": (-30.0, 30.0),
}


@pytest.mark.parametrize("name", TAILS)
def test_draws_in_the_tails_are_quantiles_of_the_distribution(name, key):
    """Each draw is the quantile, by scipy, of the share that its key draws."""
    lower, upper = TAILS[name]
    keys = jax.random.split(key, 2000)
    drawn = sample_of(TruncatedNormal(0.0, 1.0, lower, upper), keys)
    shares = jax.vmap(lambda k: jax.random.uniform(k, dtype=float))(keys)
    expected = stats.truncnorm(lower, upper).ppf(np.asarray(shares))
    assert lower <= drawn.min() and drawn.max() <= upper
    # Beyond that the quantile of scipy itself is iterated for; on both sides it loses
    # what a share near 1 has lost already.
    np.testing.assert_allclose(drawn, expected, rtol=1e-11, atol=1e-9)
    assert len(np.unique(drawn)) == len(drawn)


def test_a_tail_is_filled(key):
    """Not its bound: beyond 8 deviations the distance from it is nearly exponential."""
    keys = jax.random.split(key, DRAWS)
    bound = 9.0
    drawn = sample_of(TruncatedNormal(0.0, 1.0, bound, 20.0), keys)
    reference = stats.truncnorm(bound, 20.0)
    assert stats.kstest(np.asarray(drawn), reference.cdf).pvalue > 1e-4
    # Four standard errors.
    error = 4.0 * reference.std() / np.sqrt(DRAWS)
    assert drawn.mean() == pytest.approx(reference.mean(), abs=error)


@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_moments_are_those_of_the_distribution(name):
    distribution, reference = ALL_DISTRIBUTIONS[name]
    mean, deviation = distribution.moments()
    # A variance that is small beside that of the whole normal distribution is what is
    # left of a difference: 3e-3 of it here, of which rounding is 1e-12.
    np.testing.assert_allclose(mean, reference.mean(), rtol=1e-13)
    np.testing.assert_allclose(deviation, reference.std(), rtol=1e-11)


@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_moments_are_integrals_of_the_density(name):
    """By the midpoint rule, without what scipy says of moments."""
    distribution, reference = ALL_DISTRIBUTIONS[name]
    lower, upper = reference.support()
    reach = 12.0 * reference.std()
    lower = max(lower, reference.mean() - reach)
    upper = min(upper, reference.mean() + reach)
    x = lower + (upper - lower) * (np.arange(100_000) + 0.5) / 100_000
    weights = reference.pdf(x)
    mean, deviation = distribution.moments()
    first = np.average(x, weights=weights)
    second = np.average((x - first) ** 2, weights=weights)
    # The rule is good to the square of its interval, 24e-5 deviations at most.
    np.testing.assert_allclose(mean, first, atol=1e-7 * deviation, rtol=0.0)
    np.testing.assert_allclose(deviation, np.sqrt(second), rtol=1e-7)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("bound", [6.0, 9.0, 30.0])
def test_moments_far_out_are_those_of_the_closed_form(bound, sign):
    """By the hazard of the normal distribution, which erfcx gives without a difference."""
    bounds = sorted((sign * bound, sign * (bound + 12.0)))
    mean, deviation = TruncatedNormal(0.0, 1.0, *bounds).moments()
    hazard = np.sqrt(2.0 / np.pi) / special.erfcx(bound / np.sqrt(2.0))
    np.testing.assert_allclose(mean, sign * hazard, rtol=1e-14)
    # 1 + b h - h^2 leaves 1 / b^2 of b^2, of which rounding is some 1e-16.
    expected = np.sqrt(1.0 + bound * hazard - hazard**2)
    np.testing.assert_allclose(deviation, expected, rtol=1e-15 * bound**4)


@pytest.mark.parametrize("factor", [0.1, 1.0, 3.5])
@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_scaled_is_about_the_same_mean_and_so_many_times_as_wide(name, factor):
    distribution, _ = ALL_DISTRIBUTIONS[name]
    scaled = distribution.scaled(factor)
    assert type(scaled) is type(distribution)
    mean, deviation = distribution.moments()
    about, width = scaled.moments()
    # Rounding of the bounds, which are up to fifty deviations from the mean, and what
    # that is beside a deviation a tenth of the former.
    np.testing.assert_allclose(about, mean, rtol=1e-13)
    np.testing.assert_allclose(width, factor * deviation, rtol=1e-11)


@pytest.mark.parametrize("name", ALL_DISTRIBUTIONS)
def test_each_draw_of_a_scaled_distribution_is_as_much_nearer_to_the_mean(name, key):
    """So that the same runs can be flown with all that is uncertain made small."""
    distribution, _ = ALL_DISTRIBUTIONS[name]
    keys = jax.random.split(key, 100)
    sample = jax.jit(lambda d, keys: jax.vmap(d.sample)(keys))
    wide, narrow = sample(distribution, keys), sample(distribution.scaled(0.1), keys)
    mean, deviation = distribution.moments()
    assert np.all(narrow != wide)
    np.testing.assert_allclose(
        (narrow - mean) / deviation,
        0.1 * (wide - mean) / deviation,
        # Rounding of numbers that are some hundred deviations from zero, and of bounds.
        atol=1e-12,
        rtol=0.0,
    )


def test_moments_of_a_table_are_differentiable_in_its_numbers():
    """As linear covariance takes them: the deviation of an untruncated normal."""

    def deviation(width):
        return TruncatedNormal(10.0, width, -70.0, 90.0).moments()[1]

    # Bounds at forty deviations change nothing.
    assert jax.jit(jax.grad(deviation))(jnp.asarray(2.0)) == pytest.approx(1.0)
