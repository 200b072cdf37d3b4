"""Tabulated atmospheres: interpolation, derivatives and CSV files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import over
from worlds import tabulated_atmosphere

from jentry.world import (
    ExponentialAtmosphere,
    TabulatedAtmosphere,
    USStandardAtmosphere1976,
)


def test_table_passes_through_its_values():
    table = tabulated_atmosphere()
    # Logarithm and back: rounding.
    np.testing.assert_allclose(
        over(table.density)(table.altitudes), table.densities, rtol=1e-13
    )
    np.testing.assert_allclose(
        over(table.temperature)(table.altitudes), table.temperatures, rtol=1e-14
    )


def test_table_between_its_values():
    z = jnp.linspace(0.0, 120e3, 977)
    expected = over(USStandardAtmosphere1976().density)(z)
    # Where the scale height has a kink between two nodes 2 km apart, as at 11 km, where
    # it changes by a fifth: a hundredth of the density.
    np.testing.assert_allclose(
        over(tabulated_atmosphere().density)(z), expected, rtol=1.5e-2
    )


def test_table_of_an_exponential_is_the_exponential_also_outside():
    source = ExponentialAtmosphere(0.02, 11.1e3)
    z = jnp.asarray([0.0, 3e3, 20e3, 21e3, 80e3])
    table = TabulatedAtmosphere(z, over(source.density)(z))
    z = jnp.linspace(-20e3, 200e3, 101)
    # Straight lines are exact: rounding, times a logarithm of twenty.
    np.testing.assert_allclose(
        over(table.density)(z), over(source.density)(z), rtol=1e-12
    )


def test_table_falls_between_values_that_fall():
    densities = jnp.asarray([1.0, 0.99, 0.2, 0.19, 1e-3])
    table = TabulatedAtmosphere(jnp.asarray([0.0, 1e3, 2e3, 9e3, 10e3]), densities)
    values = over(table.density)(jnp.linspace(0.0, 10e3, 1001))
    assert np.all(np.diff(values) < 0.0)


def test_table_is_differentiable_in_its_values():
    table = tabulated_atmosphere()
    z = jnp.asarray(33.3e3)

    def density(densities):
        return TabulatedAtmosphere(table.altitudes, densities).density(z)

    direction = table.densities * jnp.cos(jnp.arange(61.0))
    _, slope = jax.jvp(density, (table.densities,), (direction,))
    ahead, behind = (density(table.densities + s * 1e-6 * direction) for s in (1, -1))
    # Central differences with a relative step of 1e-6: eight digits.
    assert float(slope) == pytest.approx(float(ahead - behind) / 2e-6, rel=1e-7)


def test_table_without_temperature_is_isothermal():
    table = TabulatedAtmosphere([0.0, 1e4], [1.0, 0.3], isothermal_temperature=210.0)
    assert float(table.temperature(jnp.asarray(5e3))) == 210.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 1.0, 2.0], [1.0, 0.5]), r"densities has shape \(2,\)"),
        (([0.0, 1.0], [1.0, 0.5], [200.0]), r"temperatures has shape \(1,\)"),
        (([0.0, 2.0, 1.0], [1.0, 0.5, 0.2]), "altitudes must increase: value 2 is 2.0"),
        (([0.0], [1.0]), r"altitudes has shape \(1,\)"),
        (([0.0, 1.0], [1.0, 0.0]), "densities must be positive"),
    ],
)
def test_table_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        TabulatedAtmosphere(*arguments)


def test_csv_is_read(tmp_path):
    path = tmp_path / "mars.csv"
    path.write_text(
        "# measured\n\ndensity_kg_m3, altitude_m, temperature_K\n"
        "1.5e-2, 0, 210\n1e-3, 30e3, 180\n"
    )
    table = TabulatedAtmosphere.from_csv(path, gas_constant=191.8)
    np.testing.assert_array_equal(table.altitudes, [0.0, 30e3])
    np.testing.assert_array_equal(table.densities, [1.5e-2, 1e-3])
    np.testing.assert_array_equal(table.temperatures, [210.0, 180.0])
    assert float(table.gas_constant) == 191.8
    path.write_text("altitude_m,density_kg_m3\n0,1.5e-2\n30e3,1e-3\n")
    assert TabulatedAtmosphere.from_csv(path).temperatures is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "mars.csv: empty; expected a line with the names altitude_m,density"),
        ("altitude_m\n0\n1\n", "mars.csv, line 1: no column 'density_kg_m3'"),
        ("altitude_m,density_kg_m3,t\n", "mars.csv, line 1: unknown column 't'"),
        (
            "altitude_m,altitude_m,density_kg_m3\n",
            "line 1: column 'altitude_m' appears more than once",
        ),
        (
            "altitude_m,density_kg_m3\n0,1\n",
            "line 1: 1 rows of numbers below the names",
        ),
        ("altitude_m,density_kg_m3\n0,1\n5,.5,3\n", "line 3: 3 values; expected 2"),
        (
            "altitude_m,density_kg_m3\n0,1\n\n5,thin\n",
            "line 4: density_kg_m3 is 'thin'; expected a finite number",
        ),
        (
            "altitude_m,density_kg_m3\n0,nan\n5,1\n",
            "line 2: density_kg_m3 is 'nan'; expected a finite number",
        ),
        (
            "altitude_m,density_kg_m3\n0,1\n5,0\n",
            "line 3: density_kg_m3 is 0; expected a number above zero",
        ),
        (
            "# top\naltitude_m,density_kg_m3\n0,1\n5,.5\n5,.4\n",
            "line 5: altitude_m is 5 after 5; expected increasing values",
        ),
        (
            "altitude_m,density_kg_m3\n0,1\n150,1e-9\n",
            "the highest altitude is 150 m, .* are its altitudes in km?",
        ),
    ],
)
def test_csv_errors_name_file_line_and_expectation(tmp_path, text, message):
    path = tmp_path / "mars.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        TabulatedAtmosphere.from_csv(path)
    assert str(path) in str(caught.value)
