"""`jentry compare`: variants of a mission, stored campaigns, and what it refuses."""

import csv
import dataclasses
import json
import shutil

import cheap
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from commands import assert_refused
from test_report import rows

from jentry.campaign import monte_carlo, open_campaign
from jentry.campaign.outputs import is_output
from jentry.campaign.results import output_names
from jentry.flight import Outcome
from jentry.motion.constraints import HeatLoad, HeatRate


def test_variants_on_the_same_draws(command, tmp_path):
    out = tmp_path / "out"
    words = ("--law", "right", "--law", "steep", "--runs", 4, "--seed", 7)
    code, printed, said = command("compare", "cheap", *words, "--step", 1, "--out", out)
    assert (code, said) == (0, "")
    cheap.campaign(tmp_path / "same", 4)
    right, steep = open_campaign(out / "right"), open_campaign(out / "steep")
    xarray.testing.assert_equal(right, open_campaign(tmp_path / "same"))
    assert json.loads(steep.attrs["campaign"])["law"] == "steep"
    assert "steep less right: 4 pairs, since 5 inputs are the same" in printed
    row = rows(printed)["end time"]
    times = right["end_time"].values, steep["end_time"].values
    assert row[1:3] == [f"{x.mean():.4f}" for x in times]
    assert row[3].startswith(f"{np.mean(times[1] - times[0]):+.4f} [")
    row = rows(printed)["steep"]
    failures = int(np.sum(steep["outcome"].values != Outcome.REACHED))
    assert row[:2] == ["4", str(failures)]
    distances = steep["miss_distance"].values / 1e3
    assert row[2:6] == [
        f"{x:.4f}" for x in (*np.percentile(distances, (50, 95, 99)), distances.max())
    ]
    assert (out / "comparison.png").exists()
    # Stored ones likewise, and no files unless a folder is given.
    code, again, _ = command("compare", out / "right", out / "steep")
    assert code == 0 and again.splitlines() == printed.splitlines()[:-1]
    code, fewer, _ = command("compare", out / "right", out / "steep", "--runs", 3)
    assert code == 0 and "3 pairs" in fewer
    words = ("compare", out / "right", out / "steep", "--quiet")
    assert command(*words) == (0, "", "")


def test_what_no_flight_has_is_refused_before_any_is_flown(command, tmp_path):
    words = ("--law", "right", "--law", "steep", "--out", tmp_path / "out")
    code, _, said = command("compare", "cheap", *words, "--outputs", "downrange_eror")
    assert code == 2
    assert "right has no output downrange_eror; nearest: downrange_error" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("heading", [None, jnp.asarray(0.1)])
def test_outputs_are_known_by_their_names_without_a_flight(heading):
    scenario = cheap.scenario()
    target = dataclasses.replace(scenario.target, heading=heading)
    scenario = dataclasses.replace(scenario, target=target)
    if heading is not None:
        constraints = {"peak": HeatRate(), "heat_load": HeatLoad()}
        scenario = dataclasses.replace(
            scenario, constraints=constraints, located_peaks=("peak",)
        )
    flown = monte_carlo(
        scenario, inputs={"vehicle.mass": [900.0]}, solver=cheap.SOLVER
    ).to_xarray(scenario)
    assert sorted(output_names(scenario)) == sorted(filter(is_output, flown.data_vars))


@pytest.mark.slow
def test_three_of_which_all_pairs_are_asked(command, tmp_path):
    cheap.campaign(tmp_path / "one", 3)
    for name in ("two", "three"):
        shutil.copytree(tmp_path / "one", tmp_path / name)
    words = ("compare", "one", "two", "three", "--outputs", "peak_drag,downrange_error")
    words += ("--percentiles", "50,90", "--out", "files")
    code, printed, _ = command(*words)
    assert code == 0
    drag = open_campaign(tmp_path / "one")["peak_drag"].values
    middle, high = np.percentile(drag, (50, 90))
    expected = ["3", "0", *(f"{x:.4f}" for x in (middle, high, drag.max()))]
    for name in ("one", "two", "three"):
        assert rows(printed)[name][:5] == expected
    assert "two less one" in printed and "three less one" in printed
    assert "three less two" not in printed and "end time" not in printed
    code, told, _ = command(*words, "--all-pairs", "--json")
    assert code == 0 and told == (tmp_path / "files" / "comparison.json").read_text()
    pairs = [(x["first"], x["second"]) for x in json.loads(told)["differences"]]
    assert pairs == [("one", "two"), ("one", "three"), ("two", "three")]
    with (tmp_path / "files" / "comparison.csv").open() as file:
        (first, *_) = csv.DictReader(file)
    assert float(first["peak_drag maximum (m/s2)"]) == drag.max()


def test_how_many_of_each_are_not_paired(command, tmp_path):
    """All of both are compared; a number that one has not is refused."""
    cheap.campaign(tmp_path / "one", 5)
    cheap.campaign(tmp_path / "two", 3, seed=cheap.SEED + 1)
    words = "compare", "one", "two", "--outputs", "|downrange error|"
    code, printed, _ = command(*words)
    assert code == 0 and "two less one: 3 and 5 flights, not paired" in printed
    told = json.loads(command(*words, "--json")[1])["differences"][0]
    assert (told["flights"], told["runs"]) == ([5, 3], 3)
    assert_refused(command(*words, "--runs", 4), "--runs is 4, and two has 3")


def test_a_configuration_beside_the_mission(command, tmp_path):
    config = tmp_path / "heavy.toml"
    config.write_text('[set]\n"planet.density_scale" = 1.01')
    words = ("--config", config, "--runs", 2, "--dispersions", "mass-only", "--quiet")
    code, printed, _ = command("compare", "cheap", *words, "--step", 1)
    assert (code, printed) == (0, "")
    assert (tmp_path / "results" / "cheap-compared" / "comparison.png").exists()
    folder = tmp_path / "results" / "cheap-compared"
    described = json.loads(open_campaign(folder / "heavy").attrs["campaign"])
    assert described["scenario"]["planet.density_scale"]["value"] == 1.01


@pytest.mark.parametrize(
    "words, message",
    [
        (("cheap",), "takes two"),
        (("cheap", "--law", "right"), "takes two"),
        (("cheap", "--law", "right", "--law", "left"), "left: mission cheap"),
        (("cheap", "steep"), "holds no campaign"),
        (("a", "a"), "given twice"),
        (("a", "b", "--law", "right"), "compared as they are"),
        (("a", "b", "--seed", 3), "compared as they are"),
        (("a", "b", "--runs", 1), "takes 2 or more"),
        (("a", "b", "--json", "--quiet"), "give one of them"),
        (("a", "b", "--percentiles", "0"), "above 0 and below 100"),
    ],
)
def test_what_cannot_be_compared(command, words, message):
    result = command("compare", *words)
    assert_refused(result, message, 3 if "holds" in message else 2)


def test_what_does_not_fit_is_said(command, tmp_path):
    """A dispersion of a leaf that one of the variants does not have."""
    config = tmp_path / "bank.toml"
    config.write_text(
        '[dispersions.bank]\naddress = "guidance.bank_angl"\n'
        'distribution = "uniform"\nlower = 0.1\nupper = 0.2\n'
    )
    words = ("--law", "right", "--config", config)
    assert_refused(
        command("compare", "cheap", *words), "bank: dispersions.bank.address"
    )
