"""`jentry corridor`: asked, printed, written, and what it refuses."""

import json

import pytest
from commands import Arrived, assert_refused, intercepted

from jentry.flight import FixedStep
from jentry.missions import find_mission
from jentry.planning import aerocapture_corridor, capture_corridor
from jentry.units import degree, km


MISSION = "neptune-aerocapture"
CORRIDOR = "jentry.planning.aerocapture_corridor"
QUICK = "--step", 2


def test_every_option_of_corridor_arrives(command, monkeypatch, tmp_path):
    seen = intercepted(monkeypatch, CORRIDOR, "capture_corridor")
    with pytest.raises(Arrived):
        command("corridor", MISSION)
    scenario, *angles, solver = seen["given"]
    usual = aerocapture_corridor.STEEPEST, aerocapture_corridor.SHALLOWEST
    assert angles == pytest.approx(usual, rel=1e-15) and solver == FixedStep(None)
    config = tmp_path / "changes.toml"
    config.write_text("[set]\nplanet.density_scale = 1.25")
    words = ("--steepest", "-17deg", "--shallowest", "-0.2", "--case", "free-plane")
    words += ("--set", "vehicle.mass=900", "--config", config, "--step", 2)
    with pytest.raises(Arrived):
        command("corridor", "mars-aerocapture", *words, "--json", "--out", tmp_path)
    scenario, *angles, solver = seen["given"]
    assert angles == pytest.approx([-17 * degree, -0.2], rel=1e-15)
    assert solver == FixedStep(2.0) and scenario.target.inclination is None
    assert float(scenario.vehicle.mass) == 900.0
    assert float(scenario.planet.density_scale) == 1.25
    with pytest.raises(Arrived):
        command("corridor", "apollo-10", "--world", "us-1976")
    assert (
        type(seen["given"][0].planet.atmosphere).__name__ == "USStandardAtmosphere1976"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((MISSION, "--steepest", "-17km"), "--steepest -17km: "),
        ((MISSION, "--shallowest", "-17"), "did you mean -17deg?"),
        ((MISSION, "--shallowest", "-30deg"), "steepest < shallowest < 0"),
        (("cheap",), "target is a place"),
        ((MISSION, "--set", "vehicle.mas=9"), "nearest: vehicle.mass"),
    ],
)
def test_wrong_input_is_refused(command, tmp_path, words, message):
    assert_refused(command("corridor", *words), message)
    assert not list(tmp_path.glob("results/**/*"))


@pytest.mark.slow
def test_corridor(command, tmp_path):
    """Printed, written and as JSON: the limits of the function, and their flights."""
    out = tmp_path / "found"
    code, printed, said = command("corridor", MISSION, *QUICK, "--out", out)
    assert (code, said) == (0, "")
    numbers = json.loads((out / "corridor.json").read_text())
    assert (out / "figures" / "corridor.png").stat().st_size > 10_000
    scenario = find_mission(MISSION).scenario()
    found = capture_corridor(scenario, solver=FixedStep(2.0))
    for name in ("shallow", "steep", "width"):
        expected = float(getattr(found, name))
        assert numbers[name] == pytest.approx(expected, rel=1e-12)
        assert f"{expected / degree:.5f}" in printed
    assert numbers["entry"] == pytest.approx(-13.85 * degree)
    share = 100.0 * (found.shallow / degree + 13.85) / (found.width / degree)
    assert f"-13.85000 deg, {share:.1f} % of the way from the shallow to" in printed
    high = float(scenario.target.apoapsis_altitude)
    for flight in numbers["flights"].values():
        # 1e-9 of the interval, and a flight that doubles a difference many times.
        assert flight["apoapsis_altitude"] == pytest.approx(high, rel=1e-4)
        assert f"{flight['lowest_altitude'] / km:.3f}" in printed
    shallow, steep = numbers["flights"].values()
    assert shallow["peak_load_factor"] < steep["peak_load_factor"]
    assert shallow["lowest_altitude"] > steep["lowest_altitude"] > 100 * km
    code, printed, said = command("corridor", MISSION, *QUICK, "--json")
    assert (code, said) == (0, "") and json.loads(printed) == numbers
    assert (tmp_path / "results" / f"{MISSION}-corridor" / "corridor.json").exists()


@pytest.mark.slow
def test_an_entry_outside_and_a_corridor_without_a_capture_are_said(command):
    outside = ("--set", "initial_state.flight_path_angle=-12.5deg")
    _, printed, _ = command("corridor", MISSION, *QUICK, *outside)
    assert "-12.50000 deg, outside the corridor" in printed
    # With the lift the other way round its limits change places.
    _, printed, _ = command(
        "corridor", MISSION, *QUICK, "--set", "vehicle.lift_scale=-1"
    )
    assert "no flight-path angle allows a capture" in printed
    found = capture_corridor(find_mission(MISSION).scenario(), solver=FixedStep(2.0))
    assert f"width: {-float(found.width) / degree:.5f} deg" in printed
