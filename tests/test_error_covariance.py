"""Corrections of a covariance by measured values, against the formulas in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.onboard.error_covariance import ErrorCovariance, MeasuredValue
from jentry.onboard.filter_checks import check_correlations


SIZE = 20


def covariance():
    factor = np.random.default_rng(4).normal(size=(SIZE, SIZE))
    return factor @ factor.T


def values(residuals, rows, *, gate=3.0, made=True):
    """Measured values with a standard deviation of 2."""
    count = len(residuals)
    return MeasuredValue(
        jnp.asarray(residuals),
        jnp.asarray(rows),
        jnp.full(count, 2.0),
        jnp.full(count, gate),
        jnp.broadcast_to(jnp.asarray(made), (count,)),
    )


def corrected(given):
    correct = jax.jit(lambda matrix, v: ErrorCovariance.now(matrix).corrected(v))
    after, shift, rejected = correct(jnp.asarray(covariance()), given)
    return np.asarray(after.matrix), np.asarray(shift), np.asarray(rejected)


def test_values_one_after_the_other_are_all_at_once():
    """K = P H' (H P H' + R)^-1, the shift K y and (I - K H) P."""
    generator = np.random.default_rng(5)
    rows, residuals = generator.normal(size=(3, SIZE)), np.array([0.3, -0.8, 0.5])
    before = covariance()
    gain = before @ rows.T @ np.linalg.inv(rows @ before @ rows.T + 4.0 * np.eye(3))
    matrix, shift, rejected = corrected(values(residuals, rows))
    np.testing.assert_allclose(shift, gain @ residuals, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(matrix, before - gain @ rows @ before, atol=1e-9)
    # Symmetric to rounding: both factors are of the same vector.
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-13)
    assert not rejected.any()


@pytest.mark.parametrize(("share", "refused"), [(0.999, 0.0), (1.001, 1.0)])
def test_a_gate_is_in_standard_deviations_of_the_residual(share, refused):
    row = np.eye(SIZE)[2]
    deviation = np.sqrt(covariance()[2, 2] + 4.0)
    residual = share * 3.0 * deviation
    matrix, shift, rejected = corrected(values([residual], row[None]))
    assert rejected == [refused]
    assert np.any(shift != 0.0) == (refused == 0.0)
    assert np.any(matrix != covariance()) == (refused == 0.0)


def test_what_is_not_measured_changes_nothing_and_is_not_rejected():
    row = np.eye(SIZE)[2]
    matrix, shift, rejected = corrected(values([1e6, 0.1], [row, row], made=False))
    np.testing.assert_array_equal(matrix, covariance())
    assert not shift.any() and not rejected.any()


def test_correlations_that_are_not_symmetric_are_refused():
    table = np.eye(9)
    table[0, 1] = 0.1
    with pytest.raises(
        ValueError, match="correlations of the filter must be symmetric"
    ):
        check_correlations(table)
    table[1, 0] = 0.1
    check_correlations(table)
