"""Each distribution has the quantiles, moments and draws of scipy's, or of its formula."""

import math

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from beside_scipy import DISTRIBUTIONS
from scipy import stats

from jentry.campaign import (
    AbstractDistribution,
    Constant,
    CorrelatedNormal,
    Discrete,
    Dispersion,
    LogNormal,
    Normal,
    OneOfSeveral,
)
from jentry.campaign.description import describe
from jentry.campaign.dispersions import check_dispersions


DRAWS = 40_000

CONTINUOUS = DISTRIBUTIONS | {
    "lognormal": (LogNormal(2.0, 0.4), stats.lognorm(0.4, scale=2.0)),
    "wide lognormal": (LogNormal(1e-3, 1.5), stats.lognorm(1.5, scale=1e-3)),
}
"""Each beside scipy's"""

DISCRETE = {
    "three": (Discrete([-1.0, 2.0, 2.5], [0.2, 0.5, 0.3]), [-1.0, 2.0, 2.5]),
    "equal": (Discrete([0.0, 1.0, 2.0, 3.0, 4.0, 5.0]), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]),
    "one": (Discrete([7.0]), [7.0]),
}
SHARES = {"three": [0.2, 0.5, 0.3], "equal": [1.0 / 6.0] * 6, "one": [1.0]}

mass = lambda s: s.vehicle.mass


def sampled(distribution, key, count=DRAWS):
    keys = jax.random.split(key, count)
    return np.asarray(jax.jit(jax.vmap(distribution.sample))(keys))


def quantiles(distribution, shares):
    return np.asarray(jax.jit(jax.vmap(distribution.quantile))(jnp.asarray(shares)))


@pytest.mark.parametrize("name", CONTINUOUS)
def test_quantiles_are_those_of_scipy(name):
    distribution, reference = CONTINUOUS[name]
    shares = np.array([1e-12, 1e-4, 0.1, 0.3, 0.5, 0.77, 0.99, 1.0 - 1e-6])
    # The inverse of the normal distribution, two implementations of it, to 1e-14 or so;
    # a share near 1 has lost ten digits of what is left.
    np.testing.assert_allclose(
        quantiles(distribution, shares), reference.ppf(shares), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("name", CONTINUOUS)
def test_draws_have_the_distribution(name, key):
    distribution, reference = CONTINUOUS[name]
    draws = sampled(distribution, key)
    assert stats.kstest(draws, reference.cdf).pvalue > 1e-4
    assert draws.dtype == np.float64


@pytest.mark.parametrize("name", CONTINUOUS)
def test_moments_are_those_of_scipy(name):
    distribution, reference = CONTINUOUS[name]
    mean, deviation = distribution.moments()
    assert mean == pytest.approx(reference.mean(), rel=1e-13)
    # A variance by quadrature, or by a difference of exponentials.
    assert deviation == pytest.approx(reference.std(), rel=1e-11)


@pytest.mark.parametrize("name", DISCRETE)
def test_each_value_is_drawn_in_its_share(name, key):
    distribution, values = DISCRETE[name]
    drawn, counts = np.unique(sampled(distribution, key), return_counts=True)
    np.testing.assert_array_equal(drawn, values)
    for count, share in zip(counts, SHARES[name], strict=True):
        # Five standard deviations of a binomial.
        assert abs(count - DRAWS * share) <= 5.0 * math.sqrt(
            DRAWS * share * (1.0 - share)
        )
    reference = stats.rv_discrete(values=(range(len(values)), SHARES[name]))
    shares = np.array([1e-9, 0.15, 0.25, 0.69, 0.71, 1.0 - 1e-9])
    places = reference.ppf(shares).astype(int)
    np.testing.assert_array_equal(
        quantiles(distribution, shares), np.array(values)[places]
    )
    mean, deviation = distribution.moments()
    first = np.average(values, weights=SHARES[name])
    second = np.average((np.array(values) - first) ** 2, weights=SHARES[name])
    assert float(mean) == pytest.approx(first, abs=1e-15)
    assert float(deviation) == pytest.approx(math.sqrt(second), abs=1e-15)


def test_what_has_no_probability_is_not_drawn():
    first, last = Discrete([1.0, 2.0], [0.0, 1.0]), Discrete([1.0, 2.0], [1.0, 0.0])
    for share in (0.0, 1e-300, 0.5, 1.0 - 2.0**-53):
        assert first.quantile(jnp.asarray(share)) == 2.0
        assert last.quantile(jnp.asarray(share)) == 1.0


@pytest.mark.parametrize("factor", [0.1, 1.0, 3.0])
@pytest.mark.parametrize(
    "distribution",
    [LogNormal(2.0, 0.4), LogNormal(1.0, 1.5), DISCRETE["three"][0]]
    + [CorrelatedNormal(3.0, 0.5, [0.6, 0.8])],
    ids=["lognormal", "wide", "discrete", "correlated"],
)
def test_scaled_is_about_the_same_mean_and_so_many_times_as_wide(distribution, factor):
    scaled = distribution.scaled(factor)
    assert type(scaled) is type(distribution)
    mean, deviation = distribution.moments()
    about, width = scaled.moments()
    # Rounding; of the logarithm of a number near 1 where the deviation is small.
    np.testing.assert_allclose(about, mean, rtol=1e-13)
    np.testing.assert_allclose(width, factor * deviation, rtol=1e-11)


REFUSED = {
    "sum": (([1.0, 2.0], [0.5, 0.4]), r"\[0.5, 0.4\] have the sum 0.9: it must be 1"),
    "negative": (([1.0, 2.0], [1.5, -0.5]), "a probability is -0.5: each must be zero"),
    "not a number": (([1.0, 2.0], [np.nan, 1.0]), "a probability is nan"),
    "order": (([2.0, 1.0], [0.5, 0.5]), r"values is \[2.0, 1.0\]: list them in rising"),
    "twice": (([1.0, 1.0], [0.5, 0.5]), "list them in rising order"),
    "count": (
        ([1.0, 2.0], [1.0]),
        r"probabilities has shape \(1,\): give one for each",
    ),
    "nothing": (([],), r"values has shape \(0,\): give a list"),
    "a number": ((1.0,), r"values has shape \(\): give a list"),
}


@pytest.mark.parametrize(("given", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_discrete_distribution_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Discrete(*given)


def test_decimal_probabilities_need_no_last_digit():
    mean, _ = Discrete([1.0, 2.0, 3.0], [0.1, 0.2, 0.7]).moments()
    assert float(mean) == pytest.approx(0.1 + 2 * 0.2 + 3 * 0.7, rel=1e-12)
    # Of three thirds to ten digits the mean is theirs to as many.
    mean, _ = Discrete(np.arange(3.0), np.full(3, 0.3333333333)).moments()
    assert float(mean) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("distribution", "message"),
    [
        (LogNormal(-1.0, 0.1), "dispersions.x.median is -1: it must be greater than"),
        (LogNormal(1.0, 0.0), "dispersions.x.deviation_of_logarithm is 0"),
        (Discrete([np.inf]), "dispersions.x.values is inf"),
    ],
    ids=["median", "deviation", "infinite"],
)
def test_what_cannot_be_drawn_from_is_refused(distribution, message):
    with pytest.raises(ValueError, match=message):
        check_dispersions(cheap.scenario(), {"x": Dispersion(mass, distribution)})


def test_one_of_several_is_one_of_several_by_its_share():
    shares = jnp.asarray([0.1, 0.4, 0.6, 0.95])
    first, second = (quantiles(OneOfSeveral(place, 2, 6.0), shares) for place in (0, 1))
    np.testing.assert_allclose(first, [6.0 * (0.4 - 1.0), 6.0 * (1.6 - 1.0), 0.0, 0.0])
    np.testing.assert_allclose(second, [0.0, 0.0, 6.0 * (0.4 - 1), 6.0 * (1.8 - 1)])


def test_how_many_numbers_a_draw_takes():
    assert Normal(0.0, 1.0).numbers() == Discrete([1.0, 2.0]).numbers() == 1
    assert Constant(1.0).numbers() == 0
    assert Constant(3.0).quantile(jnp.asarray(0.4)) == 3.0
    assert CorrelatedNormal(0.0, 1.0, [0.6, 0.8]).numbers() == 2


class Own(AbstractDistribution):
    def sample(self, key):
        return jax.random.normal(key)

    def moments(self):
        return jnp.zeros(()), jnp.ones(())

    def scaled(self, factor):
        return self


def test_a_distribution_without_a_quantile_says_so():
    with pytest.raises(ValueError, match="Own has no quantile.*draw plainly"):
        Own().quantile(jnp.asarray(0.5))


def test_a_description_tells_tables():
    table = {"x": Dispersion(mass, Discrete([900.0, 950.0], [0.25, 0.75]))}
    told = describe(cheap.scenario(), table, 0, cheap.SOLVER, None)["dispersions"]["x"]
    assert told["values"] == [900.0, 950.0] and told["probabilities"] == [0.25, 0.75]
    assert told["distribution"] == "Discrete"


def test_lists_are_printed_and_long_ones_by_their_ends(command, tmp_path):
    config = tmp_path / "many.toml"
    config.write_text(
        '[dispersions.mass]\naddress = "vehicle.mass"\ndistribution = "discrete"\n'
        "values = [900, 901, 902, 903, 904, 905, 906, 907]\n"
        '[dispersions.density]\naddress = "planet.density_scale"\n'
        'distribution = "discrete"\nvalues = [0.5, 2]\nprobabilities = [0.25, 0.75]\n'
    )
    code, printed, _ = command("show", "cheap", "--config", config)
    assert code == 0
    rows = [line.split("│") for line in printed.splitlines() if "│" in line]
    drawn = " ".join(" ".join(row[2].split()) for row in rows if len(row) > 5)
    assert (
        "discrete, values 900 901 ... 907, probabilities 0.125 0.125 ... 0.125" in drawn
    )
    assert "discrete, values 0.5 2, probabilities 0.25 0.75" in drawn
