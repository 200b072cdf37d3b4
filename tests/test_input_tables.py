"""Tables of inputs are columns of numbers below the names of leaves."""

import numpy as np
import pytest

from jentry.cli.overrides import read_inputs


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "of a spreadsheet"])
def test_inputs_are_columns_of_numbers(written, mark):
    path = written(f"{mark}vehicle.mass, planet.density_scale\n900,1.1\r\n\n950, 0.9\n")
    given = read_inputs(path)
    assert list(given) == ["vehicle.mass", "planet.density_scale"]
    assert np.array_equal(given["vehicle.mass"], [900.0, 950.0])
    assert np.array_equal(given["planet.density_scale"], [1.1, 0.9])


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        ("", "empty; expected a line"),
        ("vehicle.mass\n\n", "line 1: 0 rows"),
        ("vehicle.mass\nheavy\n", "heavy"),
        ("a,b\n1,2\n3\n", "line 3: 1 values; expected 2: a,b"),
        ("a,b\n1\n2\n", "line 2: 1 values"),
        ("a,b,a\n1,2,3\n", "column 'a' appears more than once"),
        (b"\xff\xfe\x00", "decode"),
    ],
)
def test_inputs_that_are_not_understood_are_refused(written, contents, message):
    path = written(contents)
    with pytest.raises(ValueError, match=message) as raised:
        read_inputs(path)
    assert str(path) in str(raised.value)
