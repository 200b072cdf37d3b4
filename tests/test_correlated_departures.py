"""Density departures with a correlation length over the altitude."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.onboard.profile_estimation import FactorPrior
from jentry.units import km


@pytest.mark.parametrize("length", [2 * km, 5 * km, 10 * km])
def test_correlation_goes_with_the_distance(length):
    """As exp(-d^2 / (2 length^2)), on a circle of twice the way from low to high.

    By Poisson's sum the whole series is this summed over the turns of the circle. What is
    left out of it is 1e-4, and what the turns add at no distance.
    """
    low, high, deviation = 10 * km, 60 * km, 0.04
    departure = FactorPrior.correlated(length, deviation, low, high, constant=0.0)
    heights = np.linspace(low, high, 26)
    rows = np.asarray(jax.jit(jax.vmap(departure.basis))(jnp.asarray(heights)))
    found = rows @ rows.T / deviation**2
    distance = heights[:, None] - heights
    turns = 2.0 * (high - low) * np.array([-1.0, 1.0])[:, None, None]
    gauss = np.exp(-0.5 * (distance / length) ** 2)
    around = np.sum(np.exp(-0.5 * ((distance + turns) / length) ** 2), axis=0)
    left_out = 1e-4 + around[0, 0] + 1e-13
    assert np.max(np.abs(found - gauss - around)) < left_out
    assert np.all(np.abs(found - gauss) < left_out + around)
    # The variance is the same everywhere, and no wave more than needed.
    variance = np.diag(found)
    np.testing.assert_allclose(variance, variance[0], rtol=1e-13)
    assert 1.0 - 1e-4 <= variance[0] <= 1.0 + around[0, 0] + 1e-13
    least = float(departure.amplitudes[-1]) ** 2 / deviation**2
    assert variance[0] - least < 1.0 - 1e-4


def test_constant_and_slope_come_beside_the_correlation():
    plain, more = (
        FactorPrior.correlated(5 * km, 0.04, 10 * km, 60 * km, constant=c, slope=s)
        for c, s in ((0.0, 0.0), (0.07, 3e-6))
    )
    pair = jnp.array([22 * km, 51 * km])
    both = [np.asarray(jax.jit(jax.vmap(d.basis))(pair)) for d in (plain, more)]
    without, found = (rows[0] @ rows[1] for rows in both)
    # The slope turns about the middle.
    added = 0.07**2 + 3e-6**2 * (22 * km - 35 * km) * (51 * km - 35 * km)
    assert found - without == pytest.approx(added, rel=1e-12)


@pytest.mark.parametrize("length", [0.0, -3e3, 10.1e3, 50e3, math.inf, math.nan])
def test_a_length_that_is_none_is_refused(length):
    with pytest.raises(ValueError, match=f"length is {length} m, and the altitudes"):
        FactorPrior.correlated(length, 0.04, 10e3, 60e3)


@pytest.mark.parametrize(
    ("deviation", "high", "said"),
    [
        (-0.1, 60e3, "deviation is -0.1"),
        (math.nan, 60e3, "deviation is nan"),
        (0.04, math.inf, "altitudes are 10000.0 and inf m"),
        (0.04, math.nan, "altitudes are 10000.0 and nan m"),
    ],
)
def test_a_correlation_of_no_numbers_is_refused(deviation, high, said):
    with pytest.raises(ValueError, match=said):
        FactorPrior.correlated(3e3, deviation, 10e3, high)


def test_waves_without_one_amplitude_each_are_refused():
    with pytest.raises(ValueError, match=r"have the shapes \(2,\) and \(3,\)"):
        FactorPrior([1e4, 2e4], [0.1, 0.1, 0.1])
