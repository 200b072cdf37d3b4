"""Trajectories for other programs: tables, and paths over a globe."""

import csv
import datetime
import json
import sys
import xml.etree.ElementTree as ET

import cheap
import equinox as eqx
import jax
import numpy as np
import pytest
from helpers import fly_compiled

import jentry
from jentry.campaign import trajectory_files
from jentry.flight import FixedStep


INTERVAL = 2.0


@pytest.fixture(scope="module")
def flown():
    scenario = cheap.scenario()
    return scenario, fly_compiled(scenario, FixedStep(), INTERVAL)


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_a_table_has_all_samples_and_the_end_in_degrees(flown, tmp_path):
    scenario, flight = flown
    jentry.write_trajectory(scenario, flight, tmp_path / "flight.csv")
    lines = read(tmp_path / "flight.csv")
    history = flight.history
    flying = np.isfinite(np.asarray(history.states.velocity))
    assert len(lines) == np.sum(flying) + 1
    times = [float(line["time [s]"]) for line in lines]
    assert times[:3] == [0.0, INTERVAL, 2 * INTERVAL]
    assert times[-1] == float(flight.time)
    angles = [float(line["flight_path_angle [deg]"]) for line in lines]
    expected = np.asarray(history.states.flight_path_angle)[flying]
    np.testing.assert_allclose(np.deg2rad(angles[:-1]), expected, rtol=1e-14)
    assert np.deg2rad(angles[-1]) == pytest.approx(
        float(flight.state.flight_path_angle), rel=1e-14
    )
    altitudes = [float(line["altitude [m]"]) for line in lines]
    assert altitudes[-1] == float(flight.state.altitude)
    assert lines[-1]["bank_angle [deg]"] == "" and lines[0]["bank_angle [deg]"] != ""


def test_paths_over_a_globe_go_through_the_same_places(flown, tmp_path):
    scenario, flight = flown
    start = datetime.datetime(2026, 11, 28, 6, tzinfo=datetime.UTC)
    for ending in ("csv", "kml", "czml"):
        path = tmp_path / f"flight.{ending}"
        jentry.write_trajectory(scenario, flight, path, start)
    lines = read(tmp_path / "flight.csv")
    columns = "longitude [deg]", "latitude [deg]", "altitude [m]"
    expected = np.array([[float(line[c]) for c in columns] for line in lines])
    times = np.array([float(line["time [s]"]) for line in lines])

    root = ET.parse(tmp_path / "flight.kml").getroot()
    assert root.attrib["hint"] == "target=mars"  # as the radius of the planet says
    names = {
        "k": "http://www.opengis.net/kml/2.2",
        "gx": "http://www.google.com/kml/ext/2.2",
    }
    text = root.findtext(".//k:LineString/k:coordinates", namespaces=names)
    places = np.array([list(map(float, one.split(","))) for one in text.split()])
    np.testing.assert_allclose(places, expected, rtol=1e-12, atol=1e-12)
    track = [e.text.split() for e in root.findall(".//gx:Track/gx:coord", names)]
    np.testing.assert_allclose(np.array(track, float), expected, rtol=1e-9, atol=1e-9)
    when = [e.text for e in root.findall(".//gx:Track/k:when", names)]
    assert when[:2] == ["2026-11-28T06:00:00Z", "2026-11-28T06:00:02Z"]
    ends = [datetime.datetime.fromisoformat(one) for one in (when[0], when[-1])]
    assert (ends[1] - ends[0]).total_seconds() == pytest.approx(times[-1], abs=1e-6)

    document, run = json.loads((tmp_path / "flight.czml").read_text())
    assert document["id"] == "document" and document["version"] == "1.0"
    samples = np.reshape(run["position"]["cartographicDegrees"], (-1, 4))
    np.testing.assert_allclose(samples[:, 0], times, rtol=1e-12)
    np.testing.assert_allclose(samples[:, 1:], expected, rtol=1e-12, atol=1e-12)
    assert run["position"]["epoch"].startswith("2026-11-28T06:00:00")


def test_longitudes_of_a_globe_are_within_half_a_turn(flown, tmp_path):
    scenario, flight = flown
    states = flight.history.states
    turned = eqx.tree_at(
        lambda f: (f.history.states.longitude, f.state.longitude),
        flight,
        (states.longitude + 3.5, flight.state.longitude + 3.5),
    )
    jentry.write_trajectory(scenario, turned, tmp_path / "flight.czml")
    _, run = json.loads((tmp_path / "flight.czml").read_text())
    first = run["position"]["cartographicDegrees"][1]
    expected = np.rad2deg(float(states.longitude[0]) + 3.5) - 360.0
    assert first == pytest.approx(expected, rel=1e-12)


def test_runs_of_a_campaign_are_paths_of_their_own(tmp_path):
    scenario = cheap.scenario()
    runs = cheap.mass_only()
    campaign = jentry.monte_carlo(
        scenario, runs, jax.random.key(0), 3, history=INTERVAL
    )
    results = campaign.to_xarray(scenario, INTERVAL)
    jentry.write_trajectories(results, tmp_path / "all.csv")
    jentry.write_trajectories(results, tmp_path / "all.czml", "mars")
    lines = read(tmp_path / "all.csv")
    assert {line["run"] for line in lines} == {"0", "1", "2"}
    last = [line for line in lines if line["run"] == "1"][-1]
    assert float(last["time [s]"]) == float(campaign.flights.time[1])
    ids = [one["id"] for one in json.loads((tmp_path / "all.czml").read_text())]
    assert ids == ["document", "run 0", "run 1", "run 2"]


def test_what_cannot_be_written_is_refused(flown, tmp_path, monkeypatch):
    scenario, flight = flown
    write = lambda **kw: jentry.write_trajectory(
        **{"scenario": scenario, "flight": flight, "path": tmp_path / "x.csv", **kw}
    )
    with pytest.raises(ValueError, match="no history: fly it with"):
        write(flight=fly_compiled(scenario, FixedStep()))
    with pytest.raises(ValueError, match=r"ending '.txt': use .csv, .kml, .czml"):
        write(path=tmp_path / "x.txt")
    with pytest.raises(ValueError, match="without a time zone"):
        write(start=datetime.datetime(2026, 1, 1))
    with pytest.raises(ValueError, match=r"radius of 60268 km.*moon \(1737 km\)"):
        trajectory_files.globe_of(60_268e3)
    with pytest.raises(ValueError, match="no histories"):
        jentry.write_trajectories(
            jentry.monte_carlo(
                scenario, cheap.mass_only(), jax.random.key(0), 3
            ).to_xarray(scenario),
            tmp_path / "x.csv",
        )
    with pytest.raises(ValueError, match="globe is 'venus': choose from earth"):
        jentry.write_trajectories(_with_time(), tmp_path / "x.csv", "venus")
    monkeypatch.setitem(sys.modules, "czml3", None)
    with pytest.raises(ImportError, match=r"takes czml3: .* 'jentry\[globe\]'"):
        write(path=tmp_path / "x.czml")
    assert not list(tmp_path.iterdir())


def _with_time():
    import xarray

    return xarray.Dataset(coords={"time": [0.0]})


@pytest.mark.parametrize(("name", "radius"), [("mars", 3397e3), ("earth", 6378e3)])
def test_a_planet_has_the_globe_of_its_radius(name, radius):
    assert trajectory_files.globe_of(radius) == name


def test_the_command_writes_one(command, tmp_path):
    path = tmp_path / "flight.kml"
    code, printed, _ = command("fly", "mars-range-tracking", "--trajectory", str(path))
    assert code == 0 and f"written: {path}" in printed
    assert ET.parse(path).getroot().tag.endswith("kml")
    code, _, said = command("fly", "mars-range-tracking", "--trajectory", "x.gpx")
    assert code == 2 and "'.gpx': use .csv, .kml, .czml" in said
