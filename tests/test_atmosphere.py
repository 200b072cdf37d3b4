"""Atmospheres against printed tables, their own equations and each other."""

import csv
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import over
from worlds import all_atmospheres

from jentry.units import foot, slug
from jentry.world import (
    ExponentialAtmosphere,
    GeodeticAtmosphere,
    TabulatedAtmosphere,
    USStandardAtmosphere1976,
    us_standard_atmosphere as standard,
)


QUANTITIES = ("density", "temperature", "pressure", "speed_of_sound")
TRUTHS = Path(__file__).parent / "truths" / "us_standard_atmosphere_1976.csv"


def _printed():
    with TRUTHS.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def _unit_of_last_digit(text):
    mantissa, _, exponent = text.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(exponent or 0) - decimals)


@pytest.fixture(params=all_atmospheres)
def atmosphere(request):
    return all_atmospheres[request.param]()


# --- the standard ------------------------------------------------------------------


@pytest.mark.parametrize("row", _printed(), ids=lambda row: row["altitude_m"])
def test_standard_is_what_is_printed(row):
    atmosphere = USStandardAtmosphere1976()
    altitude = jnp.asarray(float(row["altitude_m"]))
    columns = {
        "temperature": row["temperature_K"],
        "pressure": row["pressure_Pa"],
        "density": row["density_kg_m3"],
        "speed_of_sound": row["speed_of_sound_m_s"],
    }
    for quantity, text in columns.items():
        if not text:
            continue
        value = float(getattr(atmosphere, quantity)(altitude))
        # To 80 km formulas: half a unit of the last printed digit. Above, the standard
        # was integrated in 1976 with larger steps and rounds or truncates: one unit.
        digits = 0.5 if altitude < 86e3 else 1.0
        tolerance = digits * _unit_of_last_digit(text)
        if altitude > 86e3 and quantity == "pressure":
            # Five digits are printed of a sum of species that agree in four.
            tolerance = 1e-4 * float(text)
        if text == "101325" or text == "1.225":
            tolerance = 1e-6 * float(text)  # exact by definition, 1.225 rounded
        assert value == pytest.approx(float(text), rel=0.0, abs=tolerance), quantity


def test_standard_agrees_with_the_check_case_of_nasa():
    """NASA/TM-2015-218675, round Earth, 30000 ft: density, temperature, sound."""
    atmosphere = USStandardAtmosphere1976()
    altitude = jnp.asarray(30_000.0 * foot)
    # The temperature, which needs the gradient and the geopotential only: all digits.
    rankine = 1.8 * float(atmosphere.temperature(altitude))
    assert rankine == pytest.approx(411.838873, abs=5e-7)
    # The simulations carry gas constant and sea-level values in English units with few
    # digits: 1e-6 in sound, 2.1e-5 in density, where the packages `ambiance` and
    # `ussa1976` side with the formulas, 8.9069e-4.
    sound = float(atmosphere.speed_of_sound(altitude)) / foot
    assert sound == pytest.approx(994.849029, rel=2e-6)
    density = float(atmosphere.density(altitude)) / (slug / foot**3)
    assert density == pytest.approx(8.907042526e-4, rel=2.5e-5)


def test_standard_at_1000_km_agrees_with_an_unrelated_implementation():
    """Values of a unit test of the astrodynamics toolbox Tudat."""
    atmosphere = USStandardAtmosphere1976()
    altitude = jnp.asarray(1e6)
    # Its nodes carry five digits from yet another integration: a part in two thousand.
    assert float(atmosphere.density(altitude)) == pytest.approx(3.5618e-15, rel=5e-4)
    assert float(atmosphere.pressure(altitude)) == pytest.approx(7.5158e-9, rel=5e-4)
    assert float(atmosphere.temperature(altitude)) == pytest.approx(1000.0, abs=1e-3)


def _species_of_the_standard(step=5.0):
    """Altitude (m), density (kg/m3), weight (kg/kmol) by integrating its equations.

    NOAA-S/T 76-1562, section 1.3, by trapezoids with steps of 5 m:
    molecular nitrogen in hydrostatic balance, atomic and molecular oxygen, argon and
    helium with molecular and eddy diffusion and a vertical flux, hydrogen diffusing.
    """
    z = np.arange(86e3, 1e6 + 0.5 * step, step)
    km = z / 1e3
    temperature = np.asarray(
        over(USStandardAtmosphere1976().temperature)(jnp.asarray(z))
    )
    gradient = np.gradient(temperature, z)
    gravity = 9.80665 * (6356766.0 / (6356766.0 + z)) ** 2
    fall = gravity / (8314.32 * temperature)  # over molecular weight: 1/m
    weight = {
        "N2": 28.0134,
        "O": 15.9994,
        "O2": 31.9988,
        "Ar": 39.948,
        "He": 4.0026,
        "H": 1.00797,
    }
    at_base = {"N2": 1.129794e20, "O": 8.6e16, "O2": 3.030898e19}
    at_base |= {"Ar": 1.3514e18, "He": 7.5817e14}
    diffusion = {"O": (6.986e20, 0.75), "O2": (4.863e20, 0.75), "Ar": (4.487e20, 0.87)}
    diffusion |= {"He": (1.7e21, 0.691), "H": (3.305e21, 0.5)}
    thermal = {"O": 0.0, "O2": 0.0, "Ar": 0.0, "He": -0.4, "H": -0.25}
    flux = {  # per km^3, km, per km^3
        "O": (-5.809644e-4, 56.90311, 2.70624e-5),
        "O2": (1.366212e-4, 86.0, 8.333333e-5),
        "Ar": (9.434079e-5, 86.0, 8.333333e-5),
        "He": (-2.457369e-4, 86.0, 6.666667e-4),
    }
    eddy = np.where(km < 95.0, 120.0, 0.0)
    decays = (km >= 95.0) & (km < 115.0)
    eddy[decays] = 120.0 * np.exp(1.0 - 400.0 / (400.0 - (km[decays] - 95.0) ** 2))

    def integral(rate):
        pieces = 0.5 * step * (rate[1:] + rate[:-1])
        return np.concatenate([[0.0], np.cumsum(pieces)])

    def coefficient(gas, background):
        a, b = diffusion[gas]
        return a / background * (temperature / 273.15) ** b

    def diffusing(gas, background, mixture):
        d = coefficient(gas, background)
        own = weight[gas] + thermal[gas] * 8314.32 / gravity * gradient
        height, centre, width = flux[gas]
        drift = height * (km - centre) ** 2 * np.exp(-width * (km - centre) ** 3)
        if gas == "O":
            below = np.maximum(97.0 - km, 0.0)
            drift -= 3.416248e-3 * below**2 * np.exp(-5.008765e-4 * below**3)
        exponent = integral(
            fall * (own * d + mixture * eddy) / (d + eddy) + drift / 1e3
        )
        return at_base[gas] * temperature[0] / temperature * np.exp(-exponent)

    nitrogen_weight = np.where(km <= 100.0, 28.9644, weight["N2"])
    nitrogen = np.exp(-integral(nitrogen_weight * fall))
    n = {"N2": at_base["N2"] * temperature[0] / temperature * nitrogen}
    for gas in ("O", "O2"):
        n[gas] = diffusing(gas, n["N2"], nitrogen_weight)
    heavy = sum(n.values())
    mean_weight = sum(n[gas] * weight[gas] for gas in n) / heavy
    mixture = np.where(km <= 100.0, 28.9644, mean_weight)
    n |= {gas: diffusing(gas, heavy, mixture) for gas in ("Ar", "He")}

    reference = int(np.argmin(abs(km - 500.0)))
    tau = integral(weight["H"] * fall)
    tau -= tau[reference]
    power = 1.0 + thermal["H"]
    ratio = (temperature / temperature[reference]) ** power
    upward = integral(7.2e11 / coefficient("H", sum(n.values())) * ratio * np.exp(tau))
    upward = np.minimum(upward - upward[reference], 0.0)  # neglected above 500 km
    n["H"] = np.where(km < 150.0, 0.0, (8e10 - upward) / ratio * np.exp(-tau))

    total = sum(n.values())
    mass = sum(n[gas] * weight[gas] for gas in n)
    return z, mass / 6.022169e26, mass / total


def test_standard_above_86_km_follows_from_its_equations():
    z, density, weight = _species_of_the_standard()
    atmosphere = USStandardAtmosphere1976()
    altitudes = jnp.asarray(z[::20])
    error = np.abs(over(atmosphere.density)(altitudes) / density[::20] - 1.0)
    # Cubics between nodes 1, 5 and 25 km apart. At 100 km the weight of the falling
    # gas steps in the standard, and with it the scale height by 3 %: a cubic rounds it.
    near_step = np.abs(z[::20] - 100e3) < 2e3
    assert np.max(error[~near_step]) < 1e-4
    assert np.max(error[near_step]) < 6e-4
    pressure = density * 8314.32 / weight
    pressure *= over(atmosphere.temperature)(jnp.asarray(z))
    error = np.abs(over(atmosphere.pressure)(altitudes) / pressure[::20] - 1.0)
    assert np.max(error[~near_step]) < 3e-4  # both cubics, density and weight
    assert np.max(error[near_step]) < 6e-4
    nodes = np.array(standard._UPPER)[1:]
    index = np.round((nodes[:, 0] * 1e3 - z[0]) / 5.0).astype(int)
    # Seven and six digits are written down.
    np.testing.assert_allclose(nodes[:, 1], density[index], rtol=1e-6)
    np.testing.assert_allclose(nodes[:, 3], weight[index], rtol=5e-6)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize(
    "geometric", [86e3, 91e3, 110e3, 120e3, 200e3, 1000e3], ids=lambda z: f"{z:g}"
)
def test_standard_has_no_steps_above(quantity, geometric):
    f = getattr(USStandardAtmosphere1976(), quantity)
    below, above = f(jnp.asarray(geometric - 1e-3)), f(jnp.asarray(geometric + 1e-3))
    # 2 mm of altitude are 4e-7 of a density scale height. Temperature: Table 8 rounds
    # the molecular weight at 86 km to six digits.
    tolerance = 2e-6 if quantity == "temperature" else 5e-7
    assert float(below) == pytest.approx(float(above), rel=tolerance)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("base", [11e3, 20e3, 32e3, 47e3, 51e3, 71e3])
def test_standard_has_no_steps_between_layers(quantity, base):
    f = getattr(USStandardAtmosphere1976(), quantity)
    geometric = 6356766.0 * base / (6356766.0 - base)
    below, above = f(jnp.asarray(geometric - 1e-3)), f(jnp.asarray(geometric + 1e-3))
    # 2 mm of altitude are 4e-7 of a density scale height.
    assert float(below) == pytest.approx(float(above), rel=5e-7)


def test_standard_is_hydrostatic():
    """dp/dz = -rho g to 80 km, with the gravity of the standard."""
    atmosphere = USStandardAtmosphere1976()
    z = jnp.linspace(-5e3, 80e3, 173)
    gravity = 9.80665 * (6356766.0 / (6356766.0 + z)) ** 2
    slope = over(jax.grad(atmosphere.pressure))(z)
    # An identity of the formulas: rounding only.
    np.testing.assert_allclose(
        slope, -gravity * over(atmosphere.density)(z), rtol=1e-11
    )


# --- every atmosphere --------------------------------------------------------------


def test_finite_everywhere_with_finite_gradient(atmosphere):
    z = np.linspace(-5e3, 2000e3, 4011)
    edges = [86e3, 91e3, 110e3, 120e3, 200e3, 1000e3, -100e3, -200e3]
    bases = 6356766.0 * np.array([0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3])
    bases /= 6356766.0 - np.array([0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3])
    z = jnp.asarray(np.concatenate([z, edges, bases]))
    for quantity in QUANTITIES:
        f = getattr(atmosphere, quantity)
        values, slopes = over(jax.value_and_grad(f))(z)
        assert np.all(np.isfinite(values)), quantity
        assert np.all(np.isfinite(slopes)), quantity
        assert np.all(np.asarray(values) >= 0.0), quantity
    assert np.all(over(jax.grad(atmosphere.density))(z[:4011]) <= 0.0)


ALTITUDES = [-4e3, 1.0, 5e3, 11018.9, 11019.3, 15e3, 31e3, 47349.0, 60e3, 79999.0]
ALTITUDES += [83.2e3, 85999.0, 86001.0, 90.5e3, 91.2e3, 100.4e3, 109.9e3, 110.1e3]
ALTITUDES += [119.9e3, 120.1e3, 150.3e3, 300.3e3, 777e3, 999.9e3, 1000.1e3, 1500e3]


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_gradient_matches_finite_differences(atmosphere, quantity):
    f = jax.jit(lambda z: getattr(atmosphere, quantity)(z))
    slope_at = jax.jit(jax.grad(f))
    for z in ALTITUDES:
        # Steps of 0.1 m stay on one side of every layer boundary above; the difference
        # keeps ten digits of sixteen, of a relative change of 1e-5 or of none at all.
        numeric = (f(jnp.asarray(z + 0.1)) - f(jnp.asarray(z - 0.1))) / 0.2
        noise = 1e-14 * float(f(jnp.asarray(z))) / 0.1
        slope = slope_at(jnp.asarray(z))
        assert float(slope) == pytest.approx(float(numeric), rel=1e-6, abs=noise), z


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_vmap_equals_loop(atmosphere, quantity):
    f = jax.jit(lambda z: getattr(atmosphere, quantity)(z))
    z = jnp.asarray(ALTITUDES)
    loop = [float(f(altitude)) for altitude in z]
    # The same operations in another order of fusion: rounding, times log density. Over an
    # ellipsoid an altitude is a difference of radii, with their rounding over 7 km.
    ellipsoid = isinstance(atmosphere, GeodeticAtmosphere)
    np.testing.assert_allclose(over(f)(z), loop, rtol=5e-13 if ellipsoid else 1e-13)


def test_gas_law_and_sound_agree(atmosphere):
    """Speed of sound squared is 1.4 p / rho, whatever the gas."""
    z = jnp.asarray(ALTITUDES)
    ratio = over(lambda z: atmosphere.pressure(z) / atmosphere.density(z))(z)
    sound = over(atmosphere.speed_of_sound)(z)
    np.testing.assert_allclose(sound**2, 1.4 * ratio, rtol=1e-13)  # rounding


def test_sound_and_pressure_are_of_the_gas_that_is_given():
    """Carbon dioxide at 183.7 K, as on Mars: by hand, 1.29 * 188.92 * 183.7."""
    gas = {"gas_constant": 188.92, "heat_capacity_ratio": 1.29}
    isothermal = gas | {"isothermal_temperature": 183.7}
    density = ExponentialAtmosphere(0.0158, 9354.5).density
    z = jnp.asarray([0.0, 20e3, 40e3])
    for air in (
        ExponentialAtmosphere(0.0158, 9354.5, **isothermal),
        TabulatedAtmosphere(z, over(density)(z), **isothermal),
        TabulatedAtmosphere(z, over(density)(z), jnp.full(3, 183.7), **gas),
    ):
        at = jnp.asarray(13e3)
        sound = float(air.speed_of_sound(at))
        assert sound == pytest.approx(np.sqrt(44768.93916), rel=1e-9)
        pressure = float(density(at)) * 188.92 * 183.7
        assert float(air.pressure(at)) == pytest.approx(pressure, rel=1e-9)
        assert float(air.temperature(at)) == pytest.approx(183.7, rel=1e-14)
