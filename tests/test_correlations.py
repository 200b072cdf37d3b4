"""Correlated dispersions have the correlation that was given, and refuse what is none."""

import dataclasses

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.campaign import (
    CorrelatedNormal,
    Dispersion,
    Normal,
    Uniform,
    add,
    correlated_normals,
    draw,
    multiply,
)
from jentry.campaign.dispersions import check_dispersions, numbers_of_streams


MATRIX = [[1.0, 0.8, -0.3], [0.8, 1.0, 0.1], [-0.3, 0.1, 1.0]]

MEANS, DEVIATIONS = [1.0, 0.0, 950.0], [0.1, 0.02, 10.0]


def three() -> dict[str, Dispersion]:
    wheres = {
        "lift": lambda s: s.vehicle.lift_scale,
        "path": lambda s: s.initial_state.flight_path_angle,
        "mass": lambda s: s.vehicle.mass,
    }
    applies = multiply, add, multiply
    return {
        name: Dispersion(where, Normal(*numbers), apply)
        for (name, where), *numbers, apply in zip(
            wheres.items(), MEANS, DEVIATIONS, applies, strict=True
        )
    }


def drawn(table, key, runs):
    """Shape (dispersions, runs)."""
    draws = jax.jit(jax.vmap(lambda run: draw(table, key, run)))(jnp.arange(runs))
    # JAX has sorted the names.
    return np.stack([np.asarray(draws[name]) for name in table])


def test_draws_have_the_means_deviations_and_correlation(key):
    runs = 40_000
    table = correlated_normals(three(), MATRIX)
    draws = drawn(table, key, runs)
    # Five standard errors: of a mean, a deviation, and a correlation r, (1 - r^2) / n^0.5.
    error = 5.0 / np.sqrt(runs)
    assert np.all(np.abs(draws.mean(axis=1) - MEANS) < error * np.array(DEVIATIONS))
    assert np.all(np.abs(draws.std(axis=1) / DEVIATIONS - 1.0) < error)
    off = np.abs(np.corrcoef(draws) - MATRIX)
    assert np.all(off <= error * (1.0 - np.square(MATRIX)) + 1e-12)


def test_rows_are_of_the_lower_root():
    table = correlated_normals(three(), MATRIX)
    rows = np.stack([table[name].distribution.weights for name in table])
    np.testing.assert_allclose(rows @ rows.T, MATRIX, atol=1e-15)
    assert np.all(rows[np.triu_indices(3, 1)] == 0.0)
    for name, before in three().items():
        after = table[name]
        assert (after.apply, after.stream) == (before.apply, "lift and path and mass")
        assert after.distribution.moments() == before.distribution.moments()


def test_by_shares_as_by_keys():
    """A vector of shares gives what their normal quantiles give through the root."""
    table = correlated_normals(three(), MATRIX)
    normals = np.array([0.3, -1.2, 0.7])
    shares = jax.scipy.special.ndtr(jnp.asarray(normals))
    expected = MEANS + np.array(DEVIATIONS) * (np.linalg.cholesky(MATRIX) @ normals)
    for each, value in zip(table.values(), expected, strict=True):
        # Probabilities and back again.
        assert float(each.distribution.quantile(shares)) == pytest.approx(
            value, rel=1e-13, abs=1e-15
        )


def test_other_dispersions_are_left_alone(key):
    alone = {"other": Dispersion(lambda s: s.planet.density_scale, Uniform(0.8, 1.2))}
    table = correlated_normals(three(), MATRIX)
    run = jnp.asarray(4)
    both = draw(alone | table, key, run)
    assert both["other"] == draw(alone, key, run)["other"]
    assert both["mass"] == draw(table, key, run)["mass"]
    check_dispersions(cheap.scenario(), alone | table)
    assert numbers_of_streams(alone | table) == {
        "other": 1,
        "lift and path and mass": 3,
    }


def test_scaled_stays_correlated(key):
    table = {
        name: dataclasses.replace(each, distribution=each.distribution.scaled(0.1))
        for name, each in correlated_normals(three(), MATRIX).items()
    }
    draws = drawn(table, key, 4000)
    np.testing.assert_allclose(np.corrcoef(draws), MATRIX, atol=5.0 / np.sqrt(4000))
    assert draws.std(axis=1) == pytest.approx(0.1 * np.array(DEVIATIONS), rel=0.06)


def changed(i, j, value, mirrored=True):
    matrix = np.array(MATRIX)
    matrix[i, j] = value
    if mirrored:
        matrix[j, i] = value
    return matrix


REFUSED = {
    "shape": (np.eye(2), r"has shape \(2, 2\): expected a row .* \(3, 3\)"),
    "not symmetric": (
        changed(1, 0, 0.5, False),
        "not symmetric: 0.5 for path with lift",
    ),
    "diagonal": (changed(1, 1, 2.0), "has 2 for path itself: write 1 on the diagonal"),
    "not definite": (changed(1, 0, -1.5), "not positive definite"),
    "three that cannot be": (
        [[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]],
        "not positive definite, its least eigenvalue is -0.8",
    ),
    "always together": (np.ones((3, 3)), "give both dispersions one stream"),
    "not finite": (changed(2, 0, np.nan), "a number that is not finite"),
}


@pytest.mark.parametrize(("matrix", "message"), REFUSED.values(), ids=REFUSED)
def test_a_matrix_that_is_no_correlation_is_refused(matrix, message):
    with pytest.raises(
        ValueError, match=f"the correlation of lift, path, mass.*{message}"
    ):
        correlated_normals(three(), matrix)


def test_dispersions_that_cannot_be_correlated_are_refused():
    table = three()
    with pytest.raises(ValueError, match="1 dispersions are to be correlated: give 2"):
        correlated_normals({"mass": table["mass"]}, [[1.0]])
    other = dataclasses.replace(table["mass"], distribution=Uniform(0.0, 1.0))
    with pytest.raises(ValueError, match="'mass' is Uniform: .* must be Normal"):
        correlated_normals(table | {"mass": other}, MATRIX)
    other = dataclasses.replace(table["mass"], stream="s")
    with pytest.raises(ValueError, match="'mass' has the stream 's': leave it out"):
        correlated_normals(table | {"mass": other}, MATRIX)


def test_a_stream_of_unequal_lengths_is_refused():
    table = correlated_normals(three(), MATRIX)
    short = CorrelatedNormal(1.0, 0.1, [0.6, 0.8])
    table["mass"] = dataclasses.replace(table["mass"], distribution=short)
    with pytest.raises(ValueError, match="'mass' takes 2 random numbers of .* takes 3"):
        check_dispersions(cheap.scenario(), table)
