"""Missions as TOML files, which other programs read."""

import dataclasses
import tomllib

import numpy as np
import pytest

from jentry.addresses import leaves_by_address, unit_of
from jentry.flight import Scenario
from jentry.missions import ALL, find_mission
from jentry.missions.choice import Choice
from jentry.missions.data_file import PARTS, mission_data, write_mission_data


def written(tmp_path, mission, *choice):
    path = tmp_path / "data.toml"
    write_mission_data(path, mission, Choice.given(*choice))
    return tomllib.loads(path.read_text())


def found(contents, address):
    """What a file has at an address, and the unit beside it."""
    *parts, name = address.split(".")
    for part in parts:
        contents = contents[int(part) if isinstance(contents, list) else part]
    return contents[name], contents.get("units", {}).get(name, "1")


@pytest.mark.parametrize("name", [mission.name for mission in ALL.values()])
def test_every_number_of_a_mission_is_in_its_file(name, tmp_path):
    mission = find_mission(name)
    contents = written(tmp_path, mission)
    scenario = mission.scenario()
    for address, leaf in leaves_by_address(scenario).items():
        if address.split(".")[0] in PARTS:
            value, unit = found(contents, address)
            np.testing.assert_array_equal(value, leaf, err_msg=address)
            assert unit == unit_of(scenario, address)
    assert contents["source"] == mission.source
    tables = (contents.get(x, {}) for x in ("dispersions", "dispersions_left_out"))
    assert set().union(*tables) == set(mission.dispersions)


def test_a_file_has_values_units_and_kinds_without_the_law(tmp_path):
    contents = written(tmp_path, find_mission("apollo-10"))
    assert contents["vehicle"]["mass"] == 5498.22
    assert contents["vehicle"]["units"]["mass"] == "kg"
    ends = contents["termination"]["conditions"]
    assert ends["altitude"]["kind"] == "AltitudeBelow"
    assert ends["altitude"]["outcome"] == "reached"
    assert "guidance" not in contents


def test_a_file_has_all_of_a_scenario_but_the_law(tmp_path):
    """What only concerns the computation and its outputs is no data either."""
    outputs = {"located_peaks", "values_at_end", "step"}
    fields = {field.name for field in dataclasses.fields(Scenario)}
    assert set(PARTS) == fields - outputs - {"guidance"}
    mission = find_mission("mars-drag-tracking")
    scenario = dataclasses.replace(mission.scenario(), angle_of_attack_error=0.01)
    path = tmp_path / "data.toml"
    write_mission_data(path, mission, scenario=scenario)
    contents = tomllib.loads(path.read_text())
    # It flies in the plane of the equator, and not in three dimensions.
    assert contents["dynamics"]["kind"] == "EquatorialDynamics"
    assert "equator" in contents["dynamics"]["about"]
    assert contents["angle_of_attack_error"] == 0.01
    assert contents["units"] == {"angle_of_attack_error": "rad"}
    assert "units" not in mission_data(mission)


def test_dispersions_say_what_they_change(tmp_path):
    contents = written(tmp_path, find_mission("mars-drag-tracking"))
    density = contents["dispersions"]["lift-to-drag-held"]["density"]
    assert density["changes"] == ["planet.density_scale"]
    assert density["distribution"] == "Uniform"
    assert density["how"] == "The draw replaces the nominal value."
    assert (density["lower"], density["upper"]) == (0.8, 1.2)


def test_dispersions_of_another_world_are_named_with_the_reason(tmp_path):
    mission = find_mission("apollo-10")
    left_out = written(tmp_path, mission)["dispersions_left_out"]
    assert "choose the world inertial" in left_out["knowledge"]
    contents = written(tmp_path, mission, None, "skip", "inertial")
    assert contents["case"] == "skip" and contents["worlds"] == ["inertial"]
    assert "dispersions_left_out" not in contents
    changes = contents["dispersions"]["knowledge"].values()
    assert any("navigation.knowledge.east" in each["changes"] for each in changes)


def test_a_file_has_the_changes_of_the_command(command, tmp_path):
    path = tmp_path / "data.toml"
    code, _, _ = command(
        "show", "cheap", "--set", "vehicle.mass=900", "--file", str(path)
    )
    assert code == 0
    assert tomllib.loads(path.read_text())["vehicle"]["mass"] == 900.0
