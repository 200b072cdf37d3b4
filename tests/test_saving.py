"""What was tuned is written so that the command line flies it again, to the last digit."""

import json
import tomllib

import cheap
import jax
import numpy as np
import optax
import pytest
from commands import monte_carlo

from jentry.addresses import leaves_by_address, unit_of
from jentry.cli.overrides import apply_values, in_si, read_overrides
from jentry.missions import ALL
from jentry.missions.choice import Choice
from jentry.tuning import Bounds, Budget, Draws, MeanSquare, Scale, tune
from jentry.tuning.saving import with_unit
from jentry.units import quantity


LATITUDE = "initial_state.latitude"


@pytest.fixture(scope="module")
def tuned():
    """Of two numbers with units, after two steps."""
    return tune(
        cheap.scenario(),
        lambda s: (s.guidance.bank_angle, s.initial_state.latitude),
        MeanSquare(lambda misses: misses.downrange / 1e4),
        optax.adam(0.05),
        Draws(cheap.mass_only(), jax.random.key(5), 32, 48),
        ranges={"guidance.bank_angle": Bounds(0.1, 1.5), LATITUDE: Scale(0.01)},
        solver=cheap.SOLVER,
        budget=Budget(2),
    )


def read_back(path, scenario):
    overrides = in_si(read_overrides(path), scenario)
    return overrides, apply_values(scenario, overrides.values)


@pytest.mark.slow
def test_what_is_saved_is_read_to_the_last_bit(tuned, tmp_path):
    path = tmp_path / "tuned.toml"
    tuned.save(path)
    overrides, scenario = read_back(path, cheap.scenario())
    assert overrides.choice == Choice()
    assert overrides.base is overrides.dispersions is None
    assert set(overrides.values) == set(tuned.values) == set(tuned.moved)
    found, expected = map(leaves_by_address, (scenario, tuned.scenario))
    for address, value in expected.items():
        np.testing.assert_array_equal(found[address], value)
    assert float(found[LATITUDE]) != 0.0
    contents = tomllib.loads(path.read_text())
    bank = float(tuned.values["guidance.bank_angle"])
    assert contents["set"]["guidance.bank_angle"] == f"{bank!r} rad"


@pytest.mark.slow
def test_judgement_and_what_was_tuned_are_saved(tuned, tmp_path):
    path = tmp_path / "tuned.toml"
    tuned.save(path)
    said = tomllib.loads(path.read_text())["tuned"]
    assert said["stopped"] == tuned.stopped == "2 steps"
    assert said["loss_at_start"] == tuned.course[0].loss
    assert said["loss"] == tuned.course[tuned.best].loss
    assert said["best_step"] == tuned.best + 1 and said["steps"] == 2
    start = float(cheap.scenario().guidance.bank_angle)
    assert said["parameters"]["guidance.bank_angle"] == {
        "start": f"{start!r} rad",
        "value": f"{float(tuned.values['guidance.bank_angle'])!r} rad",
        "gradient_share": 1.0,
    }
    judgement = tuned.judgement
    assert said["judgement"]["runs"] == judgement.runs == 48
    found = said["judgement"]["comparisons"]
    assert len(found) == len(judgement.comparisons)
    for saved in found:
        comparison = judgement[saved["quantity"], saved["statistic"]]
        assert saved["before"] == comparison.before.value
        assert saved["after"] == comparison.after.value
        change = comparison.change
        assert saved["change"] == change.value
        assert saved["interval"] == [change.low, change.high]


def test_variant_dispersions_further_values_and_comment(tuned, tmp_path):
    path = tmp_path / "tuned.toml"
    bank = "guidance.bank_angle"
    tuned.save(
        path,
        law='the "right" \N{ROCKET}\x7f one',
        dispersions="mass-only",
        values={"vehicle.mass": 900.0, bank: 0.3},
        comment="Two\n[lines]",
    )
    overrides, scenario = read_back(path, cheap.scenario())
    assert overrides.choice.law == 'the "right" \N{ROCKET}\x7f one'
    assert overrides.base == "mass-only"
    assert float(scenario.vehicle.mass) == 900.0
    # What was tuned is not what was set before.
    assert float(scenario.guidance.bank_angle) == float(tuned.values[bank])
    assert path.read_text().startswith("# Two\n# [lines]\n")


def test_a_saved_file_flies(tuned, tmp_path, command):
    path = tmp_path / "tuned.toml"
    tuned.save(path, law="right", dispersions="mass-only")
    flown = monte_carlo(command, "--config", path, "--runs", 4, "--out", "flown")
    assert flown[0] == 0
    described = json.loads((tmp_path / "flown" / "campaign.json").read_text())
    for address, value in tuned.values.items():
        assert described["scenario"][address]["value"] == float(value)
    assert list(described["dispersions"]) == ["mass"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_every_number_of_a_mission_can_be_saved(name):
    """With the unit of its field, for each unit that there is."""
    scenario = ALL[name].scenario()
    for address in leaves_by_address(scenario):
        unit = unit_of(scenario, address)
        for number in (1.0 / 3.0, -2.5e-17, 1e300):
            assert quantity(with_unit(number, unit)).si(unit) == number
