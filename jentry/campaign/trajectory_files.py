"""Trajectories as files that other programs open: tables, and paths over a globe."""

import datetime
import importlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._files import write_whole
from ..fields import units_of
from ..flight.flight import Flight
from ..flight.scenario import Scenario
from ..motion.state import EntryState
from ..units import at_edge
from ..world.planet import Planet
from ..world.shape import Sphere
from .campaign import campaign_of_one
from .outputs import at_end
from .results import dataset


if TYPE_CHECKING:
    import pandas
    import xarray


GLOBES = {"earth": 6.371e6, "mars": 3.3895e6, "moon": 1.7374e6}
"""Mean radii of the globes that viewers have, m"""

EPOCH = datetime.datetime(2000, 1, 1, 12, tzinfo=datetime.UTC)
"""Time at which a flight begins unless another is stated: viewers need a date"""

_NEAR = 0.05
"""Largest relative difference of a planet's radius from that of its globe"""


def write_trajectory(
    scenario: Scenario,
    flight: Flight,
    path: Path | str,
    start: datetime.datetime = EPOCH,
) -> None:
    """Write the history of one flight as a table or as a path over a globe.

    **Arguments:**

    - `scenario`: scenario of the flight.
    - `flight`: flight with a history.
    - `path`: file to write. `.csv` is a table of all that the history has: time in s,
      angles in degrees, everything else in SI units, with the end of the flight as its last
      line. `.kml` is for Google Earth and `.czml` for Cesium: over an ellipsoid they have
      the geodetic altitude and latitude.
    - `start`: date and time at which the flight begins, for the clock of the globe.

    **Raises:** `ValueError` for a flight without a history, for another ending of the path
    and for a planet without a globe; `ImportError` if `jentry[globe]` is not installed.

        write_trajectory(scenario, fly(scenario, history=1.0), "flight.kml")
    """
    if flight.history is None:
        raise ValueError(
            "the flight has no history: fly it with `fly(scenario, history=1.0)`"
        )
    time = np.asarray(flight.history.time)
    if time.ndim != 1:
        raise ValueError(
            f"the history has the shape {time.shape}: give one flight; for many, give the "
            "results of their campaign to `write_trajectories`"
        )
    one = campaign_of_one(scenario, flight)
    interval = float(f"{time[1] - time[0]:.12g}")  # without its rounding
    results = dataset(scenario, one, interval)
    if Path(path).suffix.lower() != ".csv":
        results = _geodetic(results, scenario.planet)
    write_trajectories(results, path, globe_of(float(scenario.planet.radius)), start)


def write_trajectories(
    results: "xarray.Dataset",
    path: Path | str,
    globe: str = "earth",
    start: datetime.datetime = EPOCH,
) -> None:
    """Write the histories of the runs of a campaign, as `write_trajectory` does.

    **Arguments:**

    - `results`: results with histories, such as those of `open_campaign`. A table has the
      run as its first column. On a globe each run is a path of its own.
    - `path`: file to write: `.csv`, `.kml` or `.czml`.
    - `globe`: `earth`, `mars` or `moon`. Altitude and latitude are those of the states,
      also over an ellipsoid.
    - `start`: date and time at which all flights begin.

    **Raises:** `ValueError` for results without histories, for another ending of the path
    and for an unknown globe; `ImportError` if `jentry[globe]` is not installed.
    """
    path = Path(path)
    if "time" not in results.dims:
        raise ValueError("the results have no histories: fly with `--history 1`")
    if globe not in GLOBES:
        raise ValueError(f"globe is {globe!r}: choose from {', '.join(GLOBES)}")
    if start.tzinfo is None:
        raise ValueError(
            f"start is {start}, without a time zone: give one, such as datetime.UTC"
        )
    check_trajectory_file(path)
    write = _WRITERS[path.suffix.lower()]
    write_whole(path, write(results, globe, start).encode())


def _geodetic(results: "xarray.Dataset", planet: Planet) -> "xarray.Dataset":
    """Results with the geodetic altitude and latitude, which globes take."""
    if isinstance(planet.shape, Sphere):
        return results
    found = jnp.vectorize(planet.shape.geodetic)
    changed = {}
    for altitude, latitude in (
        ("altitude", "latitude"),
        (at_end("altitude"), at_end("latitude")),
    ):
        radius = planet.radius + results[altitude].values
        both = found(radius, jnp.asarray(results[latitude].values))
        for name, values in zip((altitude, latitude), both, strict=True):
            changed[name] = results[name].copy(data=np.asarray(values))
    return results.assign(changed)


def check_trajectory_file(path: Path) -> None:
    """Refuse a file that `write_trajectories` could not write.

    **Raises:** `ValueError` for an ending without a format; `ImportError` if its library is
    not installed.
    """
    ending = path.suffix.lower()
    if ending not in _WRITERS:
        raise ValueError(f"{path} has the ending {ending!r}: use {', '.join(_WRITERS)}")
    if ending in _LIBRARIES:
        _imported(_LIBRARIES[ending])


def globe_of(radius: float) -> str:
    """Name of the globe whose radius (m) is near. Raises `ValueError` if there is none."""
    for name, mean in GLOBES.items():
        if math.isclose(radius, mean, rel_tol=_NEAR):
            return name
    raise ValueError(
        f"the planet has a radius of {radius / 1e3:.0f} km, and there is no such globe; "
        f"there are {', '.join(f'{k} ({r / 1e3:.0f} km)' for k, r in GLOBES.items())}"
    )


def trajectory_table(results: "xarray.Dataset") -> "pandas.DataFrame":
    """All histories as one table: a line for each sample, and one for each end.

    Columns are named with their units. Angles are in degrees. The line of the end has the
    time and the state; the other quantities are missing there.
    """
    import pandas

    columns = {str(n): v for n, v in results.data_vars.items() if v.dims == _BOTH}
    tables = []
    for run in range(results.sizes["run"]):
        flying = np.isfinite(results["velocity"].values[run])
        state = {n: results[at_end(n)].values[run] for n in units_of(EntryState)}
        ends = {"time": results[at_end("time")].values[run], **state}
        sampled = {"time": results["time"].values[flying]}
        sampled |= {name: v.values[run][flying] for name, v in columns.items()}
        table = pandas.DataFrame(sampled)
        if not len(table) or ends["time"] > table["time"].iloc[-1]:
            table = pandas.concat([table, pandas.DataFrame([ends])], ignore_index=True)
        table.insert(0, "run", int(results["run"].values[run]))
        tables.append(table)
    whole = pandas.concat(tables, ignore_index=True)
    names = {"run": "run", "time": "time [s]"}
    for name, variable in columns.items():
        unit = variable.attrs["units"]
        if unit == ANGLE:
            whole[name], unit = at_edge(whole[name], unit)
        names[name] = f"{name} [{unit}]"
    return whole.rename(columns=names)


_BOTH = "run", "time"

ANGLE = units_of(EntryState)["heading"]
"""SI unit of an angle"""


class _Path(NamedTuple):
    """One flight over the ground."""

    name: str
    time: np.ndarray
    """s from its start"""
    longitude: np.ndarray
    """Degrees, from -180 to 180"""
    latitude: np.ndarray
    """Degrees"""
    altitude: np.ndarray
    """m"""


def _paths(results: "xarray.Dataset") -> Iterator[_Path]:
    table = trajectory_table(results)
    for run, rows in table.groupby("run"):
        place = [rows[f"{n} [deg]"].to_numpy() for n in ("longitude", "latitude")]
        longitude = (place[0] + 180.0) % 360.0 - 180.0
        times, altitude = (rows[n].to_numpy() for n in ("time [s]", "altitude [m]"))
        yield _Path(f"run {run}", times, longitude, place[1], altitude)


def _csv(results: "xarray.Dataset", globe: str, start: datetime.datetime) -> str:
    return trajectory_table(results).to_csv(index=False)


def _kml(results: "xarray.Dataset", globe: str, start: datetime.datetime) -> str:
    """A line down to the ground, and a track over the time, for each flight."""
    import simplekml

    kml = simplekml.Kml()
    kml.hint = f"target={globe}"
    for path in _paths(results):
        places = list(zip(path.longitude, path.latitude, path.altitude, strict=True))
        line = kml.newlinestring(name=path.name, coords=places)
        line.altitudemode, line.extrude = simplekml.AltitudeMode.absolute, 1
        track = kml.newgxtrack(name=f"{path.name}, over the time")
        track.altitudemode = simplekml.AltitudeMode.absolute
        track.newwhen([_iso(start, second) for second in path.time])
        track.newgxcoord(places)
    return kml.kml()


def _czml(results: "xarray.Dataset", globe: str, start: datetime.datetime) -> str:
    """A point that moves along its path, for each flight, and a clock for all."""
    from czml3 import Document, Packet
    from czml3.properties import Clock, Color, Path as Line, Point, Position
    from czml3.types import IntervalValue, TimeInterval

    paths = list(_paths(results))
    last = max(path.time[-1] for path in paths)
    whole = TimeInterval(start=start, end=start + datetime.timedelta(seconds=last))
    clock = IntervalValue(
        start=whole.start, end=whole.end, value=Clock(currentTime=start, multiplier=10)
    )
    packets = [Packet(id="document", name="jentry", version="1.0", clock=clock)]
    for path in paths:
        places = np.stack(
            [path.time, path.longitude, path.latitude, path.altitude], axis=1
        )
        packets.append(
            Packet(
                id=path.name,
                availability=whole,
                position=Position(
                    epoch=start, cartographicDegrees=places.ravel().tolist()
                ),
                point=Point(pixelSize=8, color=Color(rgba=[255, 140, 0, 255])),
                path=Line(leadTime=0, width=2),
            )
        )
    return Document(packets=packets).dumps()


def _iso(start: datetime.datetime, seconds: float) -> str:
    time = start + datetime.timedelta(seconds=float(seconds))
    return time.astimezone(datetime.UTC).isoformat().replace("+00:00", "Z")


_WRITERS = {".csv": _csv, ".kml": _kml, ".czml": _czml}
_LIBRARIES = {".kml": "simplekml", ".czml": "czml3"}


def _imported(name: str) -> None:
    try:
        importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"a file of this kind takes {name}: python -m pip install 'jentry[globe]'"
        ) from error
