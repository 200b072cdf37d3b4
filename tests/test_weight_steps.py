"""Steps that train weights: on residuals that are linear in them, by numpy."""

import jax.numpy as jnp
import numpy as np
import pytest

from jentry.learning import AdamSteps, GaussNewtonSteps, robust_mean, tail_mean
from jentry.learning.flight_residuals import Flown, curved, distances
from jentry.tuning.losses import power_mean


def root_mean_square(distances):
    return jnp.mean(distances**2)


RNG = np.random.default_rng(1)
COUNT, FLIGHTS = 6, 40
DERIVATIVES = RNG.normal(0.0, 1.0, (FLIGHTS, 2, COUNT))
TRUTH = RNG.normal(0.0, 1.0, COUNT)
OFFSET = 0.1 * RNG.normal(0.0, 1.0, (FLIGHTS, 2))


def residuals_at(weights):
    return DERIVATIVES @ (weights - TRUTH) + OFFSET


def flown_at(weights):
    return Flown(residuals_at(weights), DERIVATIVES, np.ones(FLIGHTS, bool))


def loss_at(weights, statistic=root_mean_square):
    return float(statistic(jnp.asarray(distances(residuals_at(weights)))))


def tried(weights):
    return 0, loss_at(weights)


def best_weights():
    """Least squares by numpy."""
    rows = DERIVATIVES.reshape(-1, COUNT)
    return np.linalg.lstsq(rows, rows @ TRUTH - OFFSET.reshape(-1))[0]


def lightened(flights, large=4.0):
    """The factors on flights with large derivatives, by their definition."""
    ratio = flights.sizes / np.median(flights.sizes)
    return 1.0 / (1.0 + (ratio / large) ** 2)


def test_the_gradient_is_that_of_the_loss_with_large_derivatives_scaled_down():
    weights = np.zeros(COUNT)
    kept = lightened(flown_at(weights))
    for statistic in (root_mean_square, power_mean):
        expected = np.zeros(COUNT)
        for flight in range(FLIGHTS):
            one = np.arange(FLIGHTS) == flight

            def alone(w, one=one, statistic=statistic):
                r = np.where(one[:, None], residuals_at(w), residuals_at(weights))
                return float(statistic(jnp.asarray(distances(r))))

            for place in range(COUNT):
                step = 1e-5 * (np.arange(COUNT) == place)
                slope = (alone(weights + step) - alone(weights - step)) / 2e-5
                expected[place] += kept[flight] * slope
        found = curved(flown_at(weights), statistic)
        np.testing.assert_allclose(found.gradient, expected, rtol=1e-6, atol=1e-8)
        assert found.loss == loss_at(weights, statistic)


def test_the_matrix_of_a_mean_square_is_its_hessian_but_for_the_factors():
    for large in (1.5, 4.0, 1e9):
        kept = lightened(flown_at(TRUTH), large)
        expected = (
            2.0 / FLIGHTS * np.einsum("i,ija,ijb->ab", kept, DERIVATIVES, DERIVATIVES)
        )
        found = curved(flown_at(TRUTH), root_mean_square, large=large)
        np.testing.assert_allclose(found.matrix, expected, rtol=1e-12)
    usual = curved(flown_at(TRUTH), root_mean_square)
    same = curved(flown_at(TRUTH), root_mean_square, large=4.0)
    np.testing.assert_array_equal(usual.matrix, same.matrix)
    assert curved(flown_at(TRUTH), root_mean_square, with_matrix=False).matrix is None


def test_a_flight_that_the_loss_forgets_still_counts_in_the_matrix():
    """Of the worst flight alone, the others have a tenth of the mean weight."""

    def worst(distances):
        return jnp.max(distances)

    weights = np.zeros(COUNT)
    flights = flown_at(weights)
    off = distances(flights.residuals)
    w = np.where(off == off.max(), 1.0 / off, 0.0)
    w = np.maximum(w, 0.1 * w.mean()) * lightened(flights)
    expected = np.einsum("i,ija,ijb->ab", w, DERIVATIVES, DERIVATIVES)
    np.testing.assert_allclose(curved(flights, worst).matrix, expected, rtol=1e-12)


def test_flights_that_are_not_finite_are_left_out():
    flights = flown_at(np.zeros(COUNT))
    some = np.arange(FLIGHTS) != 3
    bad = flights.residuals.copy()
    bad[3] = np.nan
    found = curved(Flown(bad, DERIVATIVES, some), root_mean_square)
    kept = Flown(*(x[some] for x in flights))
    expected = curved(kept, root_mean_square)
    np.testing.assert_array_equal(found.gradient, expected.gradient)
    with pytest.raises(ValueError, match="no flight has an end"):
        curved(Flown(bad, DERIVATIVES, np.zeros(FLIGHTS, bool)), root_mean_square)


def test_a_flight_with_huge_derivatives_is_counted_and_scaled_down():
    huge = DERIVATIVES.copy()
    huge[0] *= 1e6
    flights = Flown(residuals_at(np.zeros(COUNT)), huge, np.ones(FLIGHTS, bool))
    found = curved(flights, root_mean_square)
    assert found.clipped == 1
    usual = curved(flown_at(np.zeros(COUNT)), root_mean_square)
    size = np.linalg.norm(usual.gradient)
    assert np.linalg.norm(found.gradient - usual.gradient) < size


def test_a_flight_without_a_miss_has_no_gradient():
    exact = Flown(np.zeros((3, 2)), DERIVATIVES[:3], np.ones(3, bool))
    assert not np.any(curved(exact, robust_mean).gradient)
    assert np.all(np.isfinite(curved(exact, robust_mean).matrix))


def test_the_robust_mean_is_that_of_its_formula():
    d = np.array([0.5, 1.0, 3.0, 50.0, 2.0])
    c = 2.0 * np.median(d)
    expected = np.mean(np.sqrt(c**2 + d**2) - c)
    assert float(robust_mean(jnp.asarray(d))) == pytest.approx(expected, rel=1e-14)


def test_the_tail_mean_is_that_of_its_formula():
    d = np.array([0.5, 1.0, 3.0, 50.0, 2.0])
    expected = np.mean(d**8) ** 0.125
    assert float(tail_mean(jnp.asarray(d))) == pytest.approx(expected, rel=1e-14)


def test_whole_steps_of_gauss_and_newton_find_the_least_squares():
    method = GaussNewtonSteps(
        root_mean_square, steps=30, flights=FLIGHTS, share=1.0, least_share=1.0
    )
    weights, state = np.zeros(COUNT), method.start(np.zeros(COUNT))
    for number in range(method.steps):
        found = curved(flown_at(weights), root_mean_square)
        weights, state = method.step(number, weights, state, found, tried)
    # Factors on large derivatives move the least squares slightly.
    factor = np.sqrt(lightened(flown_at(weights)))[:, None]
    rows = (DERIVATIVES * factor[..., None]).reshape(-1, COUNT)
    right = (rows @ TRUTH) - (OFFSET * factor).reshape(-1)
    expected = np.linalg.lstsq(rows, right)[0]
    assert loss_at(expected) <= 1.001 * loss_at(best_weights())
    np.testing.assert_allclose(weights, expected, rtol=2e-3, atol=2e-3)


def test_a_first_step_is_a_share_of_the_damped_solution():
    method = GaussNewtonSteps(root_mean_square, steps=10, flights=FLIGHTS, share=0.4)
    weights = np.zeros(COUNT)
    found = curved(flown_at(weights), root_mean_square)
    points = []

    def remember(there):
        points.append(there)
        return 0, -float(len(points))  # each is better than the one before

    moved, state = method.step(0, weights, method.start(weights), found, remember)
    diagonal = np.diag(found.matrix)
    for there, factor in zip(points[1:], (1 / 3, 1.0, 3.0), strict=True):
        damped = found.matrix + factor * 1e-2 * np.diag(diagonal.mean() + diagonal)
        expected = -0.4 * np.linalg.solve(damped, found.gradient)
        np.testing.assert_allclose(there, expected, rtol=1e-10)
    np.testing.assert_array_equal(points[0], weights)
    np.testing.assert_array_equal(moved, points[3])
    assert float(state["damping"]) == pytest.approx(3e-2)


def test_the_matrix_is_an_average_over_the_steps():
    method = GaussNewtonSteps(root_mean_square, steps=10, flights=2, memory=0.8)
    weights = np.zeros(COUNT)
    found = curved(flown_at(weights), root_mean_square)
    state = method.start(weights)
    for factor in (1.0, 2.0, 4.0):
        given = found._replace(matrix=factor * found.matrix)
        _, state = method.step(0, weights, state, given, lambda there: (0, 0.0))
    weighed = np.array([0.64, 0.8, 1.0]) @ np.array([1.0, 2.0, 4.0]) / 2.44
    average = state["matrix"] / state["weight"]
    np.testing.assert_allclose(average, weighed * found.matrix, rtol=1e-12)


def test_without_a_better_point_the_weights_stay_and_the_damping_grows():
    method = GaussNewtonSteps(root_mean_square, steps=10, flights=2)
    weights = np.zeros(COUNT)
    found = curved(flown_at(weights), root_mean_square)
    state = method.start(weights)
    for worse in (
        lambda there: (0, float(np.any(there))),
        lambda there: (int(np.any(there)), 1.0 - float(np.any(there))),
        lambda there: (512, np.inf),
    ):
        moved, after = method.step(0, weights, state, found, worse)
        np.testing.assert_array_equal(moved, weights)
        assert float(after["damping"]) == 2.0 * float(state["damping"])


def test_flights_without_an_end_before_and_after_do_not_stop_a_step():
    """Fewer of them are better than a smaller loss."""
    method = GaussNewtonSteps(root_mean_square, steps=10, flights=2)
    weights = np.zeros(COUNT)
    found = curved(flown_at(weights), root_mean_square)
    state = method.start(weights)
    for better in (
        lambda there: (3, -float(np.any(there))),
        lambda there: (3 - int(np.any(there)), float(np.any(there))),
    ):
        moved, after = method.step(0, weights, state, found, better)
        assert np.any(moved)
        assert float(after["damping"]) < float(state["damping"])


def test_the_share_falls_to_the_least_one():
    method = GaussNewtonSteps(root_mean_square, steps=8, flights=2)
    shares = [method.falling(n) for n in range(9)]
    expected = [0.5 * (1.0 + np.cos(np.pi * n / 8)) for n in range(9)]
    np.testing.assert_allclose(shares, expected, atol=1e-15)


def test_adam_is_that_of_its_paper():
    """Kingma and Ba, algorithm 1, with a gradient of bounded norm and a falling rate."""
    method = AdamSteps(root_mean_square, steps=20, flights=2, rate=0.1)
    weights = np.zeros(COUNT)
    state, expected = method.start(weights), weights
    mean, square = np.zeros(COUNT), np.zeros(COUNT)
    for number in range(4):
        found = curved(flown_at(weights), root_mean_square, with_matrix=False)
        weights, state = method.step(
            number, weights, state, found, lambda there: (0, 0.0)
        )
        g = found.gradient / max(1.0, np.linalg.norm(found.gradient))
        mean, square = 0.9 * mean + 0.1 * g, 0.999 * square + 0.001 * g * g
        m = mean / (1.0 - 0.9 ** (number + 1))
        v = square / (1.0 - 0.999 ** (number + 1))
        rate = 0.1 * 0.5 * (1.0 + np.cos(np.pi * number / 20))
        expected = expected - rate * m / (np.sqrt(v) + 1e-8)
        np.testing.assert_allclose(weights, expected, rtol=1e-9)


def test_a_loss_that_is_no_loss_is_refused():
    flights = flown_at(np.zeros(COUNT))
    with pytest.raises(ValueError, match="it must grow with each"):
        curved(flights, lambda d: -jnp.mean(d))
    with pytest.raises(ValueError, match="the loss of 40 flights is nan"):
        curved(flights, lambda d: jnp.nan * jnp.mean(d))
    still = Flown(flights.residuals, 0.0 * DERIVATIVES, flights.finite)
    with pytest.raises(ValueError, match="0 flights depend on the weights"):
        curved(still, root_mean_square)


def test_the_median_of_sizes_is_of_flights_that_depend_on_the_weights():
    """Most flights do not: those that do still count fully."""
    some = np.arange(FLIGHTS) < 5
    flights = flown_at(np.zeros(COUNT))
    few = Flown(
        flights.residuals,
        np.where(some[:, None, None], DERIVATIVES, 0.0),
        flights.finite,
    )
    alone = Flown(*(x[some] for x in flights))
    found = curved(few, root_mean_square).gradient
    expected = curved(alone, root_mean_square).gradient * 5 / FLIGHTS
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(
    "method, given",
    [(GaussNewtonSteps, {"memory": 1.0}), (GaussNewtonSteps, {"share": 1.1})]
    + [(AdamSteps, {"rate": -1.0}), (GaussNewtonSteps, {"least_share": np.nan})],
)
def test_numbers_out_of_their_range_are_refused(method, given):
    (name,) = given
    with pytest.raises(ValueError, match=f"{name} is .*: it must be from 0 to"):
        method(root_mean_square, steps=3, flights=3, **given)


@pytest.mark.parametrize("given", [{"steps": 0}, {"flights": 0}, {"large": 0.0}])
def test_numbers_must_be_positive(given):
    (name,) = given
    with pytest.raises(ValueError, match=f"{name} is 0"):
        AdamSteps(root_mean_square, **({"steps": 3, "flights": 3} | given))
