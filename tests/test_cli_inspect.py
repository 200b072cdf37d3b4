"""`jentry inspect`: worst runs, derivatives, and one run again to the last bit."""

import json

import cheap
import numpy as np
import pytest
import xarray
from commands import assert_refused
from test_report import rows

from jentry.addresses import replace_leaves
from jentry.analysis import sensitivity
from jentry.campaign import open_campaign
from jentry.campaign.campaign import fly_run
from jentry.campaign.results import OutputNamed
from jentry.flight import misses
from jentry.statistics.ranking import inputs_of


RUNS = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("stored") / "campaign"
    cheap.campaign(out, RUNS, mission="cheap", law="right")
    return out


def test_the_worst_by_an_error(command, folder):
    results = open_campaign(folder)
    words = ("--by", "|downrange error|", "--worst", 3, "--no-gradient")
    code, printed, _ = command("inspect", folder, *words)
    assert code == 0
    errors = results["downrange_error"].values
    worst = np.argsort(-np.abs(errors))[:3]
    table = rows(printed)
    for run in worst:
        value, outcome, *shares = table[str(run)]
        assert value == f"{errors[run] / 1e3:.4f}" and outcome == "reached"
        for address, share in zip(inputs_of(results), shares, strict=True):
            x = results[address].values
            below = np.mean(x < x[run]) + 0.5 * np.mean(x == x[run])
            assert share == f"{100 * below:.1f} %"
    assert f"{RUNS} flights" in printed
    assert set(inputs_of(results)) <= set(table)


@pytest.mark.slow
def test_derivatives_of_one_run_are_those_of_differences(folder):
    """At the inputs of the run, with the target where the nominal entry point has it."""
    scenario, results = cheap.scenario(), open_campaign(folder)
    inputs = {address: float(x[5]) for address, x in inputs_of(results).items()}
    found = sensitivity(
        scenario,
        outputs=OutputNamed("downrange_error"),
        solver=cheap.SOLVER,
        inputs=inputs,
    )
    (slopes,) = found.jacobian.values()
    (value,) = found.values.values()
    # The same flight, fused otherwise for its derivatives.
    assert float(value) == pytest.approx(float(results["downrange_error"][5]), abs=1e-6)
    for address, slope in slopes.items():
        step = 1e-4 * max(abs(inputs[address]), 1e-2)
        ends = []
        for side in (1, -1):
            moved = inputs | {address: inputs[address] + side * step}
            flight, aimed = fly_run(scenario, moved, cheap.SOLVER)
            ends.append(float(misses(aimed, flight).downrange))
        # Central differences: the third derivative leaves about 1e-4 of the slope.
        expected = (ends[0] - ends[1]) / (2 * step)
        assert float(slope) == pytest.approx(expected, rel=1e-3), address


def test_what_is_given_for_derivatives_of_a_run():
    with pytest.raises(ValueError, match="not both"):
        sensitivity(
            cheap.scenario(), wrt=lambda s: s.vehicle.mass, inputs={"vehicle.mass": 1.0}
        )
    with pytest.raises(ValueError, match="the inputs are empty"):
        sensitivity(cheap.scenario(), inputs={})
    with pytest.raises(ValueError, match="nearest: vehicle.mass"):
        sensitivity(cheap.scenario(), inputs={"vehicle.mas": 1.0})


@pytest.mark.slow
def test_one_run_again(command, folder):
    results = open_campaign(folder)
    code, printed, _ = command("inspect", folder, "--run", 7, "--by", "end_time")
    assert code == 0
    assert "run 7 flown again: every stored number agrees, to the last bit" in printed
    assert "other steps" not in printed
    table = rows(printed)
    path = folder / "inspect" / "run-000000007.nc"
    assert f"written: {path}" in printed and path.with_suffix(".png").exists()
    with xarray.open_dataset(path, engine="h5netcdf") as flown:
        assert flown["end_time"].values[0] == results["end_time"].values[7]
        altitude = flown["altitude"].values[0]
        assert flown["run"].values == [7]
        for name, values in results.data_vars.items():  # inputs and misses as well
            np.testing.assert_array_equal(flown[name], values[7:8], str(name))
        described = json.loads(flown.attrs["campaign"])
        assert np.isfinite(altitude[0]) and described["mission"] == "cheap"
        assert (described["seed"], described["law"]) == (cheap.SEED, "right")
        assert set(described["dispersions"]) == set(cheap.dispersions())
    # The derivatives by one standard deviation of the runs.
    inputs = {address: float(x[7]) for address, x in inputs_of(results).items()}
    found = sensitivity(
        cheap.scenario(),
        outputs=OutputNamed("end_time"),
        solver=cheap.SOLVER,
        inputs=inputs,
    )
    (slopes,) = found.jacobian.values()
    lines = [line for line in printed.splitlines() if line.startswith("│")]
    last = {line.split("│")[1].strip(): line.split("│")[2:-1] for line in lines}
    assert table
    for address, slope in slopes.items():
        derivative, _, effect, unit = (cell.strip() for cell in last[address])
        spread = np.std(results[address].values, ddof=1)
        assert derivative == f"{float(slope):.6g}" and unit == "s"
        assert float(effect) == pytest.approx(float(slope) * spread, abs=5.1e-5)


def test_another_flight_is_told(command, folder, monkeypatch):
    """What is flown with another number differs, and it is said by how much."""

    def another(description, mission):
        return replace_leaves(cheap.scenario(), {"planet.rotation_rate": 1e-4})

    monkeypatch.setattr("jentry.missions.stored.stored_scenario", another)
    words = ("--run", 3, "--no-gradient")
    code, printed, _ = command("inspect", folder, *words)
    assert code == 0 and "differs from what is stored: end_time by" in printed


@pytest.mark.parametrize(
    "words, message",
    [
        (("--by", "mass"), "no output mass"),
        (("--run", RUNS), f"has the runs 0 to {RUNS - 1}"),
        (("--run", -1), "has the runs 0 to"),
        (("--worst", 0), "--worst is 0"),
        (("--history", 5), "--history is the interval of"),
        (("--run", 1, "--history", 0), "must be positive"),
    ],
)
def test_what_cannot_be_inspected(command, folder, words, message):
    assert_refused(command("inspect", folder, *words), message)
