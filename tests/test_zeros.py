"""Transmission zeros against polynomials, and against the pencil of Rosenbrock."""

import numpy as np
import pytest
from scipy import linalg

from jentry.analysis.zeros import transmission_zeros


def companion(numerator, denominator):
    """State space of a quotient of polynomials in controllable form."""
    n = len(denominator) - 1
    a, b = np.eye(n, k=1), np.zeros((n, 1))
    a[-1], b[-1] = -np.array(denominator[:0:-1]), 1.0
    c = np.zeros((1, n))
    c[0, : len(numerator)] = numerator[::-1]
    return a, b, c, np.zeros((1, 1))


def of_the_pencil(a, b, c, d):
    """Finite eigenvalues of the pencil by scipy, which has the infinite ones as well."""
    n = len(a)
    system, mass = np.block([[a, b], [c, d]]), np.zeros(2 * [n + len(c)])
    mass[:n, :n] = np.eye(n)
    found = linalg.eigvals(system, mass, homogeneous_eigvals=True)
    return np.array([x / y for x, y in found.T if abs(y) > 1e-7 * abs(x)])


@pytest.mark.parametrize(
    "zeros", [[], [3.0], [3.0, -2.0], [1.0 + 2.0j, 1.0 - 2.0j], [0.0, 50.0]]
)
def test_zeros_of_a_quotient_of_polynomials(zeros):
    numerator = np.atleast_1d(np.real(np.poly(zeros)))
    system = companion(numerator, np.poly([-1.0, -4.0, -5.0]))
    found = transmission_zeros(*system)
    np.testing.assert_allclose(
        np.sort_complex(found), np.sort_complex(np.array(zeros, complex)), atol=1e-12
    )


def test_units_of_states_inputs_and_outputs_do_not_matter():
    a, b, c, d = companion([1.0, -1.0, -6.0], np.poly([-1.0, -4.0, -5.0]))
    unit = np.array([1e-7, 1e3, 1e9])
    a, b, c = a * unit / unit[:, None], 1e-5 * b / unit[:, None], 1e8 * c * unit
    found = np.sort_complex(transmission_zeros(a, b, c, d))
    np.testing.assert_allclose(found, [-2.0, 3.0], rtol=1e-9)


@pytest.mark.parametrize("n, m, direct", [(5, 2, 0.0), (6, 1, 0.0), (6, 3, 1.0)])
def test_zeros_of_random_systems_are_those_of_the_pencil(n, m, direct):
    draw = np.random.default_rng(1).normal
    a, b, c, d = (
        draw(size=(n, n)),
        draw(size=(n, m)),
        draw(size=(m, n)),
        draw(size=(m, m)),
    )
    system = a, b, c, direct * d
    found = transmission_zeros(*system)
    expected = of_the_pencil(*system)
    assert len(found) == (n if direct else n - m)
    np.testing.assert_allclose(
        np.sort_complex(found), np.sort_complex(expected), rtol=1e-8
    )


def test_zeros_where_the_inputs_appear_late_and_at_different_orders():
    """y1 after one differentiation, y2 after two: of five states two zeros are left."""
    draw = np.random.default_rng(2).normal
    a, b = draw(size=(5, 5)), draw(size=(5, 2))
    c = draw(size=(2, 5))
    c[1] -= b.T[0] * (c[1] @ b[:, 0]) / (b[:, 0] @ b[:, 0])
    rest = b[:, 1] - b[:, 0] * (b[:, 0] @ b[:, 1]) / (b[:, 0] @ b[:, 0])
    c[1] -= rest * (c[1] @ rest) / (rest @ rest)
    np.testing.assert_allclose(c[1] @ b, 0.0, atol=1e-14)
    found = transmission_zeros(a, b, c, np.zeros((2, 2)))
    assert len(found) == 2
    system = np.block([[a, b], [c, np.zeros((2, 2))]])
    for zero in found:  # where the matrix of Rosenbrock is singular
        shifted = system - zero * np.diag([1.0] * 5 + [0.0] * 2)
        strength = np.linalg.svd(shifted, compute_uv=False)
        assert strength[-1] < 1e-13 * strength[0]


def test_inputs_that_do_the_same_have_no_zeros():
    a, b, c, d = companion([1.0, -3.0], np.poly([-1.0, -4.0, -5.0]))
    twice = np.hstack([b, 2.0 * b]), np.vstack([c, np.eye(1, 3)]), np.zeros((2, 2))
    assert transmission_zeros(a, *twice) is None
    assert transmission_zeros(a, 0.0 * b, c, d) is None


def test_matrices_that_do_not_fit_are_refused():
    a, b, c, d = companion([1.0, -3.0], np.poly([-1.0, -4.0, -5.0]))
    with pytest.raises(ValueError, match=r"must be \(n, n\), \(n, m\)"):
        transmission_zeros(a, b, np.vstack([c, c]), d)
    with pytest.raises(ValueError, match="must be finite"):
        transmission_zeros(np.nan * a, b, c, d)
