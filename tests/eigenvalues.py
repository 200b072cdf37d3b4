"""Comparison of sets of eigenvalues."""

import numpy as np


def assert_same_set(found, expected, rtol):
    """Each of one set has one of the other."""
    found, expected = list(found), list(expected)
    assert len(found) == len(expected)
    for value in expected:
        if np.isinf(value):
            found.remove(value)
            continue
        away = np.abs(np.array(found) - value)
        near = int(np.argmin(away))
        np.testing.assert_allclose(found.pop(near), value, rtol=rtol, atol=1e-8)
