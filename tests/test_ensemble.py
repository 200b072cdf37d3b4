"""Profiles of the air from files: which is met, and what is refused, by file."""

import contextlib
import dataclasses

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from helpers import over

from jentry.campaign import Discrete, Dispersion, monte_carlo
from jentry.campaign.batch import LANES
from jentry.world import (
    EnsembleAtmosphere,
    EnsembleWind,
    TabulatedAtmosphere,
    TabulatedWind,
    read_ensemble,
)


ALTITUDES = np.array([0.0, 8e3, 20e3, 31e3, 50e3, 80e3, 126e3])

RNG = np.random.default_rng(5)

DENSITIES = np.exp(-ALTITUDES / 9e3) * RNG.uniform(0.01, 0.02, (3, 7))
TEMPERATURES = RNG.uniform(150.0, 250.0, (3, 7))
PRESSURES = DENSITIES * 190.0 * TEMPERATURES
EAST, NORTH = RNG.uniform(-50.0, 50.0, (2, 3, 7))

PLACES = jnp.asarray([-4e3, 0.0, 3e3, 8e3, 19e3, 25e3, 49e3, 79e3, 100e3, 126e3, 150e3])


@pytest.mark.slow
@pytest.mark.parametrize("profile", [0, 2])
def test_a_profile_is_the_table_that_it_is(profile):
    """Though of it four points are looked at."""
    ours = EnsembleAtmosphere(
        ALTITUDES, DENSITIES, TEMPERATURES, profile=profile, gas_constant=190.0
    )
    table = TabulatedAtmosphere(
        ALTITUDES, DENSITIES[profile], TEMPERATURES[profile], gas_constant=190.0
    )
    for name in ("density", "temperature", "pressure", "speed_of_sound"):
        found, expected = (over(getattr(air, name))(PLACES) for air in (ours, table))
        # The same operations in another order of fusion.
        np.testing.assert_allclose(found, expected, rtol=1e-13)
    wind = EnsembleWind(ALTITUDES, EAST, NORTH, profile)
    other = TabulatedWind(ALTITUDES, EAST[profile], NORTH[profile])
    found, expected = (np.stack(over(w.velocity)(PLACES)) for w in (wind, other))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("points", [2, 3, 4])
def test_few_altitudes_are_enough(points):
    cut = ALTITUDES[:points], DENSITIES[:, :points]
    ours, table = EnsembleAtmosphere(*cut), TabulatedAtmosphere(cut[0], cut[1][0])
    found, expected = (over(air.density)(PLACES) for air in (ours, table))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_pressures_of_a_file_are_taken_as_they_are():
    air = EnsembleAtmosphere(ALTITUDES, DENSITIES, None, PRESSURES, profile=1.0)
    found = over(air.pressure)(jnp.asarray(ALTITUDES))
    np.testing.assert_allclose(found, PRESSURES[1], rtol=1e-13)
    assert float(air.temperature(jnp.asarray(3e3))) == 246.0


@pytest.mark.parametrize("profile", [-1.0, 0.5, 3.0])
def test_what_is_no_profile_is_refused_or_not_finite(profile):
    with pytest.raises(ValueError, match=f"profile is {profile:g}: .* from 0 to 2"):
        EnsembleWind(ALTITUDES, EAST, NORTH, profile)

    def density(number):
        air = EnsembleAtmosphere(ALTITUDES, DENSITIES, profile=number)
        return air.density(jnp.asarray(9e3))

    assert np.isnan(jax.jit(density)(jnp.asarray(profile)))
    assert np.isfinite(jax.jit(density)(jnp.asarray(2.0)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: EnsembleAtmosphere(ALTITUDES, DENSITIES[0]),
            r"densities has shape \(7,\): expected a row .* \(profiles, 7\)",
        ),
        (
            lambda: EnsembleAtmosphere(ALTITUDES, DENSITIES[:, :6]),
            r"densities has shape \(3, 6\)",
        ),
        (
            lambda: EnsembleAtmosphere(ALTITUDES, -DENSITIES),
            "densities must be positive",
        ),
        (
            lambda: EnsembleAtmosphere(ALTITUDES[::-1], DENSITIES),
            "altitudes must increase",
        ),
        (
            lambda: EnsembleWind(ALTITUDES, EAST, NORTH[:2]),
            r"east has shape \(3, 7\) and north \(2, 7\)",
        ),
    ],
)
def test_what_is_no_ensemble_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# From files.

COLUMNS = {
    "altitude": "Height",
    "density": "Dens",
    "temperature": "Temp",
    "east": "EW",
    "north": "NS",
}


def in_columns(profile, unit=1e3):
    values = (
        ALTITUDES / unit,
        *(x[profile] for x in (DENSITIES, TEMPERATURES, EAST, NORTH)),
        ALTITUDES,
    )
    lines = [",".join(f"{x:.17g}" for x in row) for row in np.transpose(values)]
    return "\n".join(["Height,Dens,Temp,EW,NS,Other", *lines]) + "\n"


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "gram"
    path.mkdir()
    for profile in (2, 0, 1):
        (path / f"profile-{profile}.csv").write_text(in_columns(profile))
    (path / "readme.txt").write_text("not a profile")
    return path


@pytest.fixture
def file(tmp_path):
    def variable(values):
        return ("run", "height"), np.array(values)

    data = xarray.Dataset(
        {
            "Dens": variable(DENSITIES),
            "Temp": variable(TEMPERATURES),
            "EW": variable(EAST),
            "NS": (("height", "run"), NORTH.T.copy()),
            "Height": ("height", ALTITUDES / 1e3),
        }
    )

    def write(change=lambda data: data):
        path = tmp_path / "gram.nc"
        change(data).to_netcdf(path, engine="h5netcdf")
        return path

    return write


def assert_read(ensemble):
    assert ensemble.count == 3
    np.testing.assert_allclose(ensemble.altitudes, ALTITUDES, rtol=1e-15)
    air, wind = ensemble.atmosphere(gas_constant=190.0), ensemble.wind(2.0)
    np.testing.assert_array_equal(air.densities, DENSITIES)
    np.testing.assert_array_equal(air.temperatures, TEMPERATURES)
    np.testing.assert_array_equal(wind.east, EAST)
    np.testing.assert_array_equal(wind.north, NORTH)
    assert (float(air.gas_constant), float(wind.profile)) == (190.0, 2.0)
    assert air.pressures is None


def test_a_folder_of_csv_files_is_read(folder):
    ensemble = read_ensemble(folder, COLUMNS, altitude_unit="km")
    assert ensemble.names == ("profile-0", "profile-1", "profile-2")
    assert_read(ensemble)
    for profile in range(3):
        (folder / f"profile-{profile}.csv").write_text(in_columns(profile, 1.0))
    assert_read(read_ensemble(folder, COLUMNS, altitude_unit="m"))


def test_a_netcdf_file_is_read(file):
    ensemble = read_ensemble(file(), COLUMNS, altitude_unit="km")
    assert ensemble.names == ("0", "1", "2")
    assert_read(ensemble)


UNITS = {
    "the same": ("Dens", "kg m-3", ""),
    "none": ("Dens", "", ""),
    "not known": ("Temp", "kelvins of old", ""),
    "another": ("Dens", "g/m3", "Dens is in g/m3; expected kg/m3"),
    "another kind": ("Temp", "Pa", "Temp is in Pa; expected K"),
    "altitude": ("Height", "m", "Height is in m; expected km"),
}


@pytest.mark.parametrize(("name", "unit", "message"), UNITS.values(), ids=UNITS)
def test_units_of_a_netcdf_file_are_read(file, name, unit, message):
    def stated(data):
        data[name].attrs["units"] = unit
        return data

    expected = contextlib.nullcontext()
    if message:
        expected = pytest.raises(ValueError, match=f"gram.nc: {message}")
    with expected:
        assert_read(read_ensemble(file(stated), COLUMNS, altitude_unit="km"))


def test_what_is_not_named_is_not_there(folder):
    ensemble = read_ensemble(
        folder, {"altitude": "Height", "east": "EW"}, altitude_unit="km"
    )
    with pytest.raises(ValueError, match="the profiles have no density: name its col"):
        ensemble.atmosphere()
    with pytest.raises(ValueError, match="the profiles have no north"):
        ensemble.wind()


WRONG_FILES = {
    "column": ("Dens", "Density", "line 1: no column 'Dens'"),
    "nan": (
        f"{TEMPERATURES[1, 2]:.17g}",
        "nan",
        "line 4: Temp is 'nan'; expected a fin",
    ),
    "density": (
        f"{DENSITIES[1, 0]:.17g}",
        "-1e-3",
        "line 2: Dens is -0.001; expected a number above zero",
    ),
    "order": ("\n8,", "\n21,", "line 4: Height is 20 after 21; expected increasing"),
    "grid": ("\n8,", "\n9,", "its altitudes are not those of .*profile-0.csv"),
}


@pytest.mark.parametrize(
    ("old", "new", "message"), WRONG_FILES.values(), ids=WRONG_FILES
)
def test_a_wrong_file_of_a_folder_is_named(folder, old, new, message):
    path = folder / "profile-1.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ValueError, match=f"profile-1.csv.*{message}"):
        read_ensemble(folder, COLUMNS, altitude_unit="km")


def with_value(name, value):
    def change(data):
        values = data[name].values.copy()
        values[1, 2] = value
        return data.assign({name: (data[name].dims, values)})

    return change


WRONG_DATA = {
    "variable": (lambda d: d.drop_vars("Dens"), "no variable 'Dens'; found Temp, EW"),
    "nan": (
        with_value("Temp", np.nan),
        "Temp is nan in profile 1 at altitude 2, counted",
    ),
    "density": (
        with_value("Dens", -1.0),
        "Dens is -1 in profile 1 .* a number above 0*",
    ),
    "wind": (with_value("EW", np.inf), "EW is inf .* expected a finite number"),
    "order": (lambda d: d.isel(height=slice(None, None, -1)), "Height must increase"),
    "dimension": (lambda d: d.rename(run="member"), "no dimension 'profile' or 'run'"),
    "dimensions": (
        lambda d: d.assign(Dens=d["Dens"].isel(run=0)),
        r"Dens has the dimensions \('height',\); expected \('run', 'height'\)",
    ),
}


@pytest.mark.parametrize(("change", "message"), WRONG_DATA.values(), ids=WRONG_DATA)
def test_a_wrong_netcdf_file_says_what_is_wrong(file, change, message):
    with pytest.raises(ValueError, match=f"gram.nc: {message}"):
        read_ensemble(file(change), COLUMNS, altitude_unit="km")


@pytest.mark.parametrize(
    ("columns", "unit", "message"),
    [
        (COLUMNS, "m", "highest altitude is 126 m, .* are its altitudes in km"),
        (
            COLUMNS | {"altitude": "Other"},
            "km",
            "is 126000 km, .* are its altitudes in m",
        ),
        (COLUMNS, "ft", "altitude_unit is 'ft': it must be"),
        (COLUMNS | {"humidity": "Other"}, "km", "unknown quantity 'humidity'"),
        ({"density": "Dens", "east": "EW"}, "km", "name that of the altitude"),
        ({"altitude": "Height"}, "km", "and of one more quantity"),
    ],
    ids=["km as m", "m as km", "unit", "quantity", "no altitude", "nothing else"],
)
def test_what_cannot_be_meant_is_refused(folder, columns, unit, message):
    with pytest.raises(ValueError, match=message):
        read_ensemble(folder, columns, altitude_unit=unit)


def test_where_there_is_nothing_to_read(tmp_path):
    empty, text = tmp_path / "empty", tmp_path / "text.nc"
    empty.mkdir()
    text.write_text("no netCDF")
    for path, message in (
        (empty, "empty has no files .*.csv"),
        (text, "text.nc is no netCDF file that can be read"),
        (tmp_path / "none.nc", "none.nc is not there"),
    ):
        with pytest.raises(ValueError, match=message):
            read_ensemble(path, COLUMNS, altitude_unit="km")


TABLE = {
    "air": Dispersion(
        lambda s: (s.planet.atmosphere.profile, s.planet.wind.profile),
        Discrete(range(3)),
    )
}


@pytest.mark.slow
def test_each_run_flies_through_the_profile_that_it_draws(folder, key):
    ensemble = read_ensemble(folder, COLUMNS, altitude_unit="km")
    scenario = cheap.scenario()

    def through(atmosphere, wind):
        planet = dataclasses.replace(scenario.planet, atmosphere=atmosphere, wind=wind)
        return dataclasses.replace(scenario, planet=planet)

    ours = through(ensemble.atmosphere(), ensemble.wind())
    campaign = monte_carlo(ours, TABLE, key, 12, solver=cheap.SOLVER)
    drawn = campaign.inputs["planet.atmosphere.profile"].astype(int)
    np.testing.assert_array_equal(campaign.inputs["planet.wind.profile"], drawn)
    assert set(drawn) == {0, 1, 2}
    one = {"vehicle.mass": np.array([float(scenario.vehicle.mass)])}
    for profile in range(3):
        table = through(
            TabulatedAtmosphere(ALTITUDES, DENSITIES[profile], TEMPERATURES[profile]),
            TabulatedWind(ALTITUDES, EAST[profile], NORTH[profile]),
        )
        expected = monte_carlo(table, inputs=one, solver=cheap.SOLVER).misses.downrange
        found = campaign.misses.downrange[drawn == profile]
        assert len(set(found)) == 1
        np.testing.assert_allclose(found, expected[0], rtol=1e-9)
    every = {"planet.atmosphere.profile": np.ones(LANES * len(jax.devices()))}
    every["planet.wind.profile"] = every["planet.atmosphere.profile"]
    lanes = monte_carlo(ours, inputs=every, solver=cheap.SOLVER).misses.downrange
    assert len(set(lanes)) == 1 and lanes[0] == campaign.misses.downrange[drawn == 1][0]
