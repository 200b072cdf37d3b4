"""Lift and bank within their limits that come nearest to two components: equation (54)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.guidance import EqualTradeoff, LiftBounds, WeightedTradeoff
from jentry.units import degree


COUNT = 10_000


def cases():
    """Of every kind: in the bounds, beyond them, on an axis, with narrow and wide banks."""
    random = np.random.default_rng(11)
    above, right = random.normal(0.0, 2.0, (2, COUNT))
    eta = random.uniform(0.02, 0.98, COUNT)
    least = random.uniform(0.05, 1.0, COUNT)
    largest = least + random.uniform(0.0, 2.0, COUNT)
    bank = random.uniform(0.2, 3.1, COUNT)
    eta[:2000] = 0.5
    eta[6000:6500], eta[6500:7000] = 0.001, 0.999
    above[2000:2200], right[2200:2400] = 0.0, 0.0
    bank[2400:4000] = 80.0 * degree
    return above, right, eta, least, largest, bank


def cost(above, right, eta, lift, cosine, sine):
    return eta * (lift * cosine - above) ** 2 + (1.0 - eta) * (lift * sine - right) ** 2


def smallest_on_a_grid(above, right, eta, least, largest, bank):
    best = np.full(COUNT, np.inf)
    for share in np.linspace(0.0, 1.0, 41):
        lift = least + share * (largest - least)
        for side in np.linspace(-1.0, 1.0, 361):
            cosine, sine = np.cos(side * bank), np.sin(side * bank)
            best = np.minimum(best, cost(above, right, eta, lift, cosine, sine))
    return best


@jax.jit
@jax.vmap
def weighted(above, right, eta, *bounds):
    return WeightedTradeoff(eta).nearest(above, right, LiftBounds(*bounds))


@jax.jit
@jax.vmap
def equal(above, right, eta, *bounds):
    return EqualTradeoff().nearest(above, right, LiftBounds(*bounds))


@pytest.mark.slow
@pytest.mark.parametrize("nearest", [weighted, equal])
def test_it_is_never_above_a_grid_of_all_that_can_be_flown(nearest):
    above, right, eta, least, largest, bank = cases()
    if nearest is equal:
        eta = np.full(COUNT, 0.5)
    found = nearest(above, right, eta, least, largest, bank)
    lift, cosine, sine = (
        np.asarray(x) for x in (found.lift, found.cos_bank, found.sin_bank)
    )
    size = eta * above**2 + (1.0 - eta) * right**2 + largest**2
    ours = cost(above, right, eta, lift, cosine, sine)
    grid = smallest_on_a_grid(above, right, eta, least, largest, bank)
    # Rounding of the cost.
    assert np.max((ours - grid) / size) < 1e-14
    # The grid is as fine as this: one interval is 1/40 of the lift, 1/180 of the bank.
    assert np.max((grid - ours) / size) < 1e-3
    # All of it can be flown.
    assert np.all((lift >= least) & (lift <= largest))
    assert np.all(cosine >= np.cos(bank) - 1e-15)
    np.testing.assert_allclose(cosine**2 + sine**2, 1.0, atol=1e-15)


def test_both_agree_where_the_weights_are_equal():
    above, right, _, *bounds = (x[:2000] for x in cases())
    half = np.full(2000, 0.5)
    one, other = (f(above, right, half, *bounds) for f in (weighted, equal))
    costs = [
        cost(above, right, half, *(np.asarray(x) for x in vars(f).values()))
        for f in (one, other)
    ]
    np.testing.assert_allclose(*costs, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("above", "right", "lift", "bank"),
    [
        (0.3, 0.4, 0.5, np.arctan2(0.4, 0.3)),  # can be flown as it is
        (3.0, 4.0, 1.0, np.arctan2(4.0, 3.0)),  # too much lift
        (0.03, -0.04, 0.2, -np.arctan2(4.0, 3.0)),  # too little
        (-1.0, 0.5, 0.5 * np.sin(1.4) - np.cos(1.4), 1.4),  # across the edge
        (-1.0, -5.0, 1.0, -1.4),  # a corner
        (0.0, 0.0, 0.2, 0.0),  # nothing at all
    ],
)
def test_by_hand(above, right, lift, bank):
    bounds = jnp.array([0.2]), jnp.array([1.0]), jnp.array([1.4])
    given = jnp.array([above]), jnp.array([right]), jnp.array([0.5])
    for nearest in (equal, weighted):
        found = nearest(*given, *bounds)
        assert float(found.lift[0]) == pytest.approx(lift, abs=1e-12)
        if above or right:
            flown = np.arctan2(float(found.sin_bank[0]), float(found.cos_bank[0]))
            assert flown == pytest.approx(bank, abs=1e-12)


def test_derivatives_are_those_of_differences():
    """Where nothing changes its kind within the difference."""
    above, right, eta, least, largest, bank = (
        jnp.asarray(x[4000:4300]) for x in cases()
    )

    def said(above, right, eta, *bounds):
        found = WeightedTradeoff(eta).nearest(above, right, LiftBounds(*bounds))
        return jnp.stack([found.lift, found.cos_bank, found.sin_bank])

    one = jnp.ones_like(above)
    along = (one, -0.7 * one, 0.1 * one, 0.2 * one, 0.3 * one, 0.1 * one)

    @jax.jit
    @jax.vmap
    def both(at, along):
        _, exact = jax.jvp(said, at, along)
        step = 1e-6
        values = [
            said(*(x + side * step * d for x, d in zip(at, along, strict=True)))
            for side in (1.0, -1.0)
        ]
        return exact, (values[0] - values[1]) / (2.0 * step)

    exact, numeric = both((above, right, eta, least, largest, bank), along)
    assert np.all(np.isfinite(exact))
    off = np.max(np.abs(exact - numeric) / (1.0 + np.abs(exact)), axis=1)
    # Of 300 cases a handful have a corner within the step.
    assert np.count_nonzero(off > 1e-5) <= 3
