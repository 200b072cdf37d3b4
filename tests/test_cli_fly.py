"""`jentry fly`: one flight, printed and written."""

import json

import cheap
import pytest
import xarray
from commands import assert_refused
from helpers import fly_compiled, free_scenario
from pages import ROOT

from jentry.addresses import replace_leaves
from jentry.units import degree


def test_fly(command, tmp_path):
    code, printed, said = command("fly", "cheap", "--step", 1)
    assert (code, said) == (0, "")
    flight = fly_compiled(cheap.scenario(), cheap.SOLVER)
    assert f"{float(flight.time):.4f}" in printed
    assert f"{float(flight.state.altitude) / 1e3:.6f}" in printed
    assert "cheap: reached the end of guided flight (velocity)" in printed


def test_every_option_of_fly_arrives(command, tmp_path):
    """All at once, each other than where it is not given: the same flight by hand."""
    out, config = tmp_path / "flight.nc", tmp_path / "overrides.toml"
    config.write_text('law = "right"\n[set]\nplanet.density_scale = 1.25')
    words = ("--law", "steep", "--set", "vehicle.mass=900", "--config", config)
    how = ("--step", 1, "--history", 20, "--out", out)
    code, printed, _ = command("fly", "cheap", *words, *how)
    assert code == 0 and f"written: {out}" in printed
    changed = {"vehicle.mass": 900.0, "planet.density_scale": 1.25}
    scenario = replace_leaves(free_scenario(10 * degree), changed)
    flight = fly_compiled(scenario, cheap.SOLVER)
    with xarray.open_dataset(out, engine="h5netcdf") as written:
        # Compiled apart: rounding, grown over the flight.
        assert written["end_time"].values == pytest.approx([flight.time.item()], 1e-11)
        altitude = flight.state.altitude.item()
        assert written["end_altitude"].values == pytest.approx([altitude], 1e-9)
        # The arc cosine of a cosine.
        bank = written["bank_angle"].values[0, :3]
        assert bank == pytest.approx([10 * degree] * 3, rel=1e-12)
        assert written["time"].values.tolist() == [20.0 * i for i in range(15)]
        described = json.loads(written.attrs["campaign"])
    assert described["solver"] == str(cheap.SOLVER)
    assert described["mission"] == "cheap" and described["history_interval"] == 20.0


def test_a_flight_is_drawn(command, tmp_path):
    """In the format of its name; its end is that of the flight."""
    for kind, begin in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        path = tmp_path / f"flight.{kind}"
        code, printed, _ = command("fly", "cheap", "--step", 1, "--figure", path)
        assert code == 0 and f"figure: {path}" in printed
        assert path.read_bytes().startswith(begin)
    result = command("fly", "cheap", "--figure", tmp_path / "flight.gif")
    assert_refused(result, "ends in .png, .pdf, .svg")


def test_a_branch_of_a_law_on_a_number_of_the_flight_names_its_line(command, tmp_path):
    text = ROOT.joinpath("tests", "lander.py").read_text()
    law = "bank = jnp.clip(self.bank - self.gain * measurement.drag, 0.0, jnp.pi)"
    assert law in text
    branch = "bank = self.bank if measurement.drag > 5.0 else 0.0 * self.bank"
    path = tmp_path / "branching.py"
    path.write_text(text.replace(law, branch))
    code, _, said = command("fly", str(path))
    assert code == 2 and f"{path}, line " in said
    assert "measurement.drag > 5.0" in said and "write jnp.where(" in said


def test_the_nearest_missions_begin_with_what_was_written(command):
    code, _, said = command("fly", "mars")
    assert code == 2 and "nearest: mars-drag-tracking, mars-range-tracking" in said
