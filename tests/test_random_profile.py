"""Random profiles have the variance and the correlation of a Gauss-Markov process."""

import dataclasses

import cheap
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import along_each, fly_compiled, over
from scipy import stats

from jentry.addresses import leaves_by_address
from jentry.campaign import Dispersion, Uniform, monte_carlo
from jentry.campaign.batch import LANES
from jentry.flight import fly, misses
from jentry.world import (
    ConstantAerodynamics,
    ConstantWind,
    ExponentialAtmosphere,
    RandomAerodynamics,
    RandomAltitudeProfile,
    RandomAtmosphere,
    RandomMachProfile,
    RandomWind,
    StillAir,
)
from jentry.world.random_profile import settled


SEEDS = 20_000

LENGTH, SPACING = 12e3, 2e3

ALTITUDES = jnp.asarray([-5e3, 0.0, 1e3, 10e3, 10.3e3, 22e3, 22.9e3, 30e3, 80e3])
"""m; below, at nodes of every 2 km, between them and beyond the last"""


def profile(seed, length=LENGTH) -> RandomAltitudeProfile:
    return RandomAltitudeProfile(length, 0.0, 40e3, seed, nodes=21)


def over_seeds(places, length=LENGTH):
    """Values of as many profiles, shape (seeds, places)."""
    seeds = (jnp.arange(SEEDS) + 0.5) / SEEDS

    def one(seed):
        drawn = settled(profile(seed, length))
        return jax.vmap(drawn)(places)

    return np.asarray(over(one)(seeds))


@pytest.fixture(scope="module")
def values():
    return over_seeds(ALTITUDES)


def test_everywhere_of_mean_0_and_variance_1_and_normal(values):
    # Five standard errors of a mean and of a variance.
    assert np.all(np.abs(values.mean(axis=0)) < 5.0 / np.sqrt(SEEDS))
    assert np.all(np.abs(values.var(axis=0) - 1.0) < 5.0 * np.sqrt(2.0 / SEEDS))
    for column in values.T:
        assert stats.kstest(column, stats.norm.cdf).pvalue > 1e-4


def test_the_correlation_of_nodes_is_exponential_in_their_distance(values):
    at = np.array([1, 3, 5, 7])  # 0, 10, 22 and 30 km
    altitudes = np.asarray(ALTITUDES)[at]
    expected = np.exp(-np.abs(altitudes[:, None] - altitudes) / LENGTH)
    found = np.corrcoef(values[:, at].T)
    # Five standard deviations of a correlation r, (1 - r^2) / n^0.5.
    error = 5.0 * (1.0 - expected**2) / np.sqrt(SEEDS)
    assert np.all(np.abs(found - expected) <= error + 1e-12)


@pytest.mark.parametrize("length", [4e3, 12e3, 100e3])
def test_the_correlation_of_any_two_places_is_nearly_that(length):
    """Between the nodes by the closed form of a weighted mean of two neighbours."""
    places = np.array([3.3e3, 4.0e3, 9.1e3, 15.5e3, 27.9e3])
    found = np.corrcoef(over_seeds(jnp.asarray(places), length).T)
    nodes = np.arange(21) * SPACING
    between = np.exp(-np.abs(nodes[:, None] - nodes) / length)
    weights = np.zeros((len(places), 21))
    for row, place in enumerate(places):
        before = int(place // SPACING)
        f = place / SPACING - before
        share = 6.0 * f**5 - 15.0 * f**4 + 10.0 * f**3  # the quintic smooth step
        weights[row, before : before + 2] = 1.0 - share, share
    covariance = weights @ between @ weights.T
    expected = covariance / np.sqrt(np.outer(*2 * [np.diag(covariance)]))
    error = 5.0 * (1.0 - expected**2) / np.sqrt(SEEDS)
    assert np.all(np.abs(found - expected) <= error + 1e-12)
    # Of two places that are further apart than the nodes that is the exponential, as if
    # each were shifted by a quarter of an interval at most.
    apart = np.abs(places[:, None] - places)
    ideal = np.exp(-apart / length)
    far = apart > 2.0 * SPACING
    assert np.all(np.abs(expected - ideal)[far] < 0.5 * SPACING / length)


def test_beyond_the_ends_a_profile_keeps_its_value(values):
    np.testing.assert_array_equal(values[:, 0], values[:, 1])
    last = over_seeds(jnp.asarray([40e3]))[:, 0]
    np.testing.assert_array_equal(values[:, -1], last)


def test_settled_says_the_same():
    one = profile(0.37)
    known = settled({"a": one, "b": 3.0})
    assert len(known["a"].values) == 21 and known["b"] == 3.0
    assert settled(known)["a"].values is known["a"].values
    for z in ALTITUDES:
        # The same operations, compiled together or one by one.
        assert float(known["a"](z)) == pytest.approx(float(one(z)), rel=1e-13)


def test_a_mach_profile_is_one_of_the_mach_number():
    mach = RandomMachProfile(6.0, 0.0, 20.0, 0.37, nodes=21)
    same = RandomAltitudeProfile(6e3, 0.0, 20e3, 0.37, nodes=21)
    for number in jnp.asarray([0.0, 3.3, 19.0, 25.0]):
        assert float(mach(number)) == pytest.approx(float(same(1e3 * number)), rel=1e-9)


def test_a_profile_is_smooth_across_its_nodes():
    drawn = settled(profile(0.2))
    slope, bend = jax.jit(jax.grad(drawn)), jax.jit(jax.grad(jax.grad(drawn)))
    for node in (2e3, 14e3, 38e3):
        sides = jnp.asarray([node - 1e-3, node + 1e-3])
        below, above = (float(slope(z)) for z in sides)
        assert below == pytest.approx(above, abs=1e-9)  # of some 1e-4 per m
        below, above = (float(bend(z)) for z in sides)
        # Of the third derivative over 2 mm, some 60 / (2 km)^3.
        assert below == pytest.approx(above, abs=1e-10)
        middle = float(slope(jnp.asarray(node + 1e3)))
        assert abs(middle) > 1e-6


@pytest.mark.parametrize("z", [0.0, 2e3, 12.3e3, 40e3, 90e3])
def test_gradients_are_finite_and_those_of_differences(z):
    def value(numbers, z):
        length, low, high = numbers
        return RandomAltitudeProfile(length, low, high, 0.2, nodes=21)(z)

    numbers = jnp.asarray([LENGTH, -100.0, 41e3])
    z = jnp.asarray(z)
    slopes = jax.jit(jax.grad(value))(numbers, z)
    assert np.all(np.isfinite(slopes))
    at = jax.jit(value)
    for i, step in enumerate([1.0, 0.1, 0.1]):
        moved = [at(numbers.at[i].add(s), z) for s in (step, -step)]
        numeric = (moved[0] - moved[1]) / (2.0 * step)
        # Curvature over the step, and rounding of 1 over it.
        assert slopes[i] == pytest.approx(float(numeric), rel=1e-5, abs=1e-12)


def test_the_seed_is_no_number_to_differentiate_in():
    slope = jax.jit(jax.grad(lambda seed: profile(seed)(jnp.asarray(5e3))))
    assert float(slope(jnp.asarray(0.4))) == 0.0


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"nodes": 1}, "nodes is 1: a profile has 2 or more"),
        ({"low": 50e3, "high": 50e3}, "low is 50000: it must be below high.* 50000"),
    ],
    ids=["nodes", "ends"],
)
def test_what_is_no_profile_is_refused(numbers, message):
    for kind in (RandomAltitudeProfile, RandomMachProfile):
        with pytest.raises(ValueError, match=message):
            kind(10.0, **numbers)


# In air, and on coefficients.

AIR = ExponentialAtmosphere(1.225, 7200.0)


def test_a_density_is_lognormal_about_the_undisturbed_one():
    z = jnp.asarray(11e3)

    def factors(seed):
        air = RandomAtmosphere(AIR, profile(seed), 0.4)
        return air.density(z) / AIR.density(z), air.pressure(z) / AIR.pressure(z)

    seeds = (jnp.arange(2000) + 0.5) / 2000
    density, pressure = map(np.asarray, over(factors)(seeds))
    assert density.min() > 0.0
    assert stats.kstest(density, stats.lognorm(0.4).cdf).pvalue > 1e-4
    np.testing.assert_allclose(pressure, density, rtol=1e-14)
    # However wide, it is never negative.
    wide = RandomAtmosphere(AIR, profile(0.1), 5.0)
    assert np.all(np.asarray(over(wide.density)(ALTITUDES)) > 0.0)
    air = RandomAtmosphere(AIR, profile(0.1), 0.0)
    assert float(air.density(z)) == float(AIR.density(z))
    assert float(air.temperature(z)) == float(AIR.temperature(z))
    assert float(air.speed_of_sound(z)) == float(AIR.speed_of_sound(z))


def test_gusts_have_their_deviation_and_are_those_of_their_seeds():
    z = jnp.asarray(7e3)

    def gusts(seed):
        wind = RandomWind(
            ConstantWind(10.0, -4.0, 0.5), profile(seed), profile(1.0 - seed), 15.0
        )
        return wind.velocity(z)

    east, north, up = map(np.asarray, over(gusts)((jnp.arange(2000) + 0.5) / 2000))
    for found, mean in ((east, 10.0), (north, -4.0)):
        assert stats.kstest(found, stats.norm(mean, 15.0).cdf).pvalue > 1e-4
    assert abs(np.corrcoef(east, north)[0, 1]) < 5.0 / np.sqrt(2000)
    np.testing.assert_array_equal(up, 0.5)


def test_coefficients_have_factors_of_their_own():
    lift, drag = (RandomMachProfile(5.0, seed=seed) for seed in (0.2, 0.8))
    air = RandomAerodynamics(ConstantAerodynamics(0.4, 1.2), lift, drag, 0.2, 0.1)
    mach = jnp.asarray(7.3)
    found = air.coefficients(jnp.asarray(0.1), mach, jnp.asarray(2e3))
    expected = 0.4 * np.exp(0.2 * lift(mach)), 1.2 * np.exp(0.1 * drag(mach))
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert found[0] / found[1] != pytest.approx(1.0 / 3.0, rel=1e-3)


def in_air(seed=0.3, deviation=0.05):
    scenario = cheap.scenario()
    planet = dataclasses.replace(
        scenario.planet,
        atmosphere=RandomAtmosphere(
            scenario.planet.atmosphere,
            RandomAltitudeProfile(10e3, 0.0, 100e3, seed),
            deviation,
        ),
    )
    return dataclasses.replace(scenario, planet=planet)


TABLE = {
    "profile": Dispersion(lambda s: s.planet.atmosphere.profile.seed, Uniform(0, 1))
}


@pytest.mark.slow
def test_a_seed_is_dispersed_and_a_run_is_the_same_in_every_lane(key):
    address = "planet.atmosphere.profile.seed"
    assert address in leaves_by_address(in_air())
    campaign = monte_carlo(in_air(), TABLE, key, 3, solver=cheap.SOLVER)
    assert len(np.unique(campaign.misses.downrange)) == 3
    count = LANES * len(jax.devices())
    inputs = {address: np.full(count, campaign.inputs[address][1])}
    same = monte_carlo(in_air(), inputs=inputs, solver=cheap.SOLVER)
    assert np.all(same.misses.downrange == campaign.misses.downrange[1])
    # One flight by itself; rounding, over some thousand steps.
    alone = in_air(float(campaign.inputs[address][1]))
    missed = misses(alone, fly_compiled(alone, cheap.SOLVER))
    assert float(missed.downrange) == pytest.approx(campaign.misses.downrange[1])
    # Without a deviation the flight is that in the undisturbed air.
    still = fly_compiled(in_air(deviation=0.0), cheap.SOLVER).state
    plain = fly_compiled(cheap.scenario(), cheap.SOLVER).state
    for a, b in zip(jax.tree.leaves(still), jax.tree.leaves(plain), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-14)


@pytest.mark.slow
def test_a_flight_is_differentiable_in_a_profile():
    """In both modes."""

    def end(numbers):
        length, deviation = numbers
        scenario = eqx.tree_at(
            lambda s: (
                s.planet.atmosphere.profile.correlation_length,
                s.planet.atmosphere.deviation_of_logarithm,
            ),
            in_air(),
            (length, deviation),
        )
        return fly(scenario, cheap.SOLVER).state.longitude

    numbers = jnp.asarray([10e3, 0.05])
    pushed, expected = along_each(end, numbers, [1.0, 1e-5])
    pulled = jax.jit(jax.grad(end))(numbers)
    for slopes in (pushed, pulled):
        # Curvature over the step, and rounding of 1e-14 over it.
        np.testing.assert_allclose(slopes, expected, rtol=1e-5)


def test_air_at_rest_may_have_gusts():
    wind = RandomWind(StillAir(), profile(0.1), profile(0.2), 15.0)
    z = jnp.asarray(5e3)
    east, north, up = wind.velocity(z)
    assert float(east) == pytest.approx(15.0 * float(profile(0.1)(z)), rel=1e-14)
    assert float(up) == 0.0 and east != north
