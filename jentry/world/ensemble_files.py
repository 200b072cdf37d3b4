"""Ensembles of profiles of the air from files: a folder of csv files or a netCDF file."""

import dataclasses
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._tables import read_columns
from ..units import UnknownUnit, km, parse_quantity
from .ensemble import EnsembleAtmosphere, EnsembleWind


QUANTITIES = {
    "altitude": "m",
    "density": "kg/m3",
    "temperature": "K",
    "pressure": "Pa",
    "east": "m/s",
    "north": "m/s",
}
"""Quantities that are read from a file, with their units; the altitude may be in km"""

_POSITIVE = "density", "temperature", "pressure"

_UNITS = {"m": 1.0, "km": km}

_LOW, _HIGH = 1e3, 1e7
"""Bounds of the highest altitude, m; beyond them the altitudes are in another unit"""

_PROFILES = "profile", "run"
"""Names of the dimension of the profiles in a netCDF file"""


@dataclasses.dataclass(frozen=True)
class Ensemble:
    """Profiles of the air over common altitudes, in SI units, of shape (profiles, n)."""

    names: tuple[str, ...]
    """Names of the files, or of the profiles in one file"""
    altitudes: np.ndarray
    profiles: Mapping[str, np.ndarray]

    @property
    def count(self) -> int:
        """Number of profiles."""
        return len(self.names)

    def atmosphere(self, **numbers: Any) -> EnsembleAtmosphere:
        """The atmosphere; other fields, such as `gas_constant`, are given by name.

        Raises `ValueError` if the profiles have no density.
        """
        density = self._of("density")
        others = {
            f"{name}s": jnp.asarray(self.profiles[name])
            for name in ("temperature", "pressure")
            if name in self.profiles
        }
        altitudes = jnp.asarray(self.altitudes)
        return EnsembleAtmosphere(altitudes, density, **others, **numbers)

    def wind(self, profile: float = 0.0) -> EnsembleWind:
        """The wind. Raises `ValueError` if the profiles have none."""
        east, north = self._of("east"), self._of("north")
        return EnsembleWind(jnp.asarray(self.altitudes), east, north, profile)

    def _of(self, name: str):
        if name not in self.profiles:
            raise ValueError(
                f"the profiles have no {name}: name its column in read_ensemble("
                f"columns={{{name!r}: ...}})"
            )
        return jnp.asarray(self.profiles[name])


def read_ensemble(
    path: str | os.PathLike, columns: Mapping[str, str], *, altitude_unit: str
) -> Ensemble:
    """Read profiles over the altitude from a folder of csv files or from a netCDF file.

        ensemble = read_ensemble(
            "gram",
            {"altitude": "Height_km", "density": "Density_kgm3", "east": "EWWind_ms",
             "north": "NSWind_ms"},
            altitude_unit="km",
        )
        ensemble.atmosphere(), ensemble.wind()
        Dispersion(
            lambda s: (s.planet.atmosphere.profile, s.planet.wind.profile),
            Discrete(range(ensemble.count)),
        )

    **Arguments:**

    - `path`: a folder with one file `*.csv` for each profile, which are read in the order
        of their names; or a netCDF file with a dimension `profile` or `run` and one of
        altitudes.
    - `columns`: names of the columns or variables in the file, by quantity: `altitude` and
        some of `density` (kg/m3), `temperature` (K), `pressure` (Pa), `east` and `north`
        (m/s, towards which the wind blows). Other columns of the file are not used, but
        those of csv files must contain numbers too.
    - `altitude_unit`: "m" or "km".

    **Raises:** `ValueError` that names the file. The reasons are a missing column, a
    variable with an attribute that states another unit, a number that is not finite,
    altitudes that do not increase or are not those of the other files, a density,
    temperature or pressure that is not positive, and altitudes that can only be in another
    unit.
    """
    path = Path(path)
    for name in columns:
        if name not in QUANTITIES:
            raise ValueError(
                f"unknown quantity {name!r} of the columns; expected some of "
                f"{', '.join(QUANTITIES)}"
            )
    if "altitude" not in columns or len(columns) < 2:
        raise ValueError(
            f"columns is {dict(columns)}: name that of the altitude and of one more "
            "quantity"
        )
    if altitude_unit not in _UNITS:
        raise ValueError(f'altitude_unit is {altitude_unit!r}: it must be "m" or "km"')
    if path.is_dir():
        names, found = _read_folder(path, columns)
    else:
        units = QUANTITIES | {"altitude": altitude_unit}
        names, found = _read_netcdf(path, columns, units)
    altitudes = found.pop("altitude") * _UNITS[altitude_unit]
    _refuse_other_unit(path, altitudes, altitude_unit)
    return Ensemble(names, altitudes, found)


Found = tuple[tuple[str, ...], dict[str, np.ndarray]]
"""Names of the profiles, and the quantities by name; the altitudes have shape (n,)"""


def _read_folder(folder: Path, columns: Mapping[str, str]) -> Found:
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise ValueError(f"{folder} has no files *.csv: expected one for each profile")
    rows: dict[str, list[np.ndarray]] = {name: [] for name in columns}
    for file in files:
        found, _ = read_columns(
            file,
            tuple(columns.values()),
            None,
            increasing=columns["altitude"],
            positive=[columns[name] for name in _POSITIVE if name in columns],
        )
        for name, column in columns.items():
            rows[name].append(found[column])
        first, ours = rows["altitude"][0], rows["altitude"][-1]
        if not np.array_equal(first, ours):
            raise ValueError(
                f"{file}: its altitudes are not those of {files[0]}; expected the same in "
                "all profiles"
            )
    altitudes = rows.pop("altitude")[0]
    stacked = {name: np.stack(each) for name, each in rows.items()}
    return tuple(file.stem for file in files), {"altitude": altitudes, **stacked}


def _read_netcdf(
    path: Path, columns: Mapping[str, str], units: Mapping[str, str]
) -> Found:
    import xarray

    if not path.exists():
        raise ValueError(f"{path} is not there: give a folder or a netCDF file")
    try:
        with xarray.open_dataset(path) as opened:
            data = opened.load()
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{path} is no netCDF file that can be read: {error}"
        ) from None
    for column in columns.values():
        if column not in data.variables:
            raise ValueError(
                f"{path}: no variable {column!r}; found "
                f"{', '.join(map(str, data.variables))}"
            )
    for name, column in columns.items():
        _refuse_stated_unit(path, data[column], units[name])
    altitude = data[columns["altitude"]]
    if altitude.ndim != 1:
        raise ValueError(
            f"{path}: {altitude.name} has the dimensions {altitude.dims}; expected one, "
            "the altitudes of all profiles"
        )
    along = next((name for name in _PROFILES if name in data.sizes), None)
    if along is None:
        raise ValueError(
            f"{path}: no dimension 'profile' or 'run'; found "
            f"{', '.join(map(str, data.sizes))}"
        )
    found = {"altitude": np.asarray(altitude.values, float)}
    if not np.all(np.diff(found["altitude"]) > 0.0):
        raise ValueError(f"{path}: {altitude.name} must increase from value to value")
    for name, column in columns.items():
        if name != "altitude":
            found[name] = _variable(path, data[column], (along, altitude.dims[0]), name)
    names = data[along].values if along in data.coords else range(data.sizes[along])
    return tuple(map(str, names)), found


def _refuse_stated_unit(path: Path, variable: Any, unit: str) -> None:
    """Refuse a variable whose attribute `units` is a known unit other than `unit`."""
    stated = str(variable.attrs.get("units", "")).strip()
    if not stated:
        return
    try:
        same = math.isclose(parse_quantity(f"1 {stated}", unit), 1.0, rel_tol=1e-9)
    except UnknownUnit:
        return
    except ValueError:
        same = False
    if not same:
        raise ValueError(f"{path}: {variable.name} is in {stated}; expected {unit}")


def _variable(path: Path, variable, dims: tuple[Any, ...], name: str) -> np.ndarray:
    if set(variable.dims) != set(dims):
        raise ValueError(
            f"{path}: {variable.name} has the dimensions {variable.dims}; expected {dims}"
        )
    values = np.asarray(variable.transpose(*dims).values, float)
    wrong = ~np.isfinite(values)
    if name in _POSITIVE:
        wrong |= ~(values > 0.0)
    for profile, place in np.argwhere(wrong)[:1]:
        expected = "a number above zero" if name in _POSITIVE else "a finite number"
        raise ValueError(
            f"{path}: {variable.name} is {values[profile, place]:g} in profile {profile} "
            f"at altitude {place}, counted from 0; expected {expected}"
        )
    return values


def _refuse_other_unit(path: Path, altitudes: np.ndarray, unit: str) -> None:
    highest = float(np.max(altitudes))
    if not np.all(np.isfinite(altitudes)):
        raise ValueError(f"{path}: an altitude is not finite")
    if not _LOW <= highest <= _HIGH:
        other = "km" if highest < _LOW else "m"
        raise ValueError(
            f"{path}: the highest altitude is {highest / _UNITS[unit]:g} {unit}, which is "
            f"not that of an entry; are its altitudes in {other}?"
        )
