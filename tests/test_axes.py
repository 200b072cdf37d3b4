"""Law, case and world of a mission are chosen independently, and composed."""

import dataclasses
import json
import re

import cheap
import equinox as eqx
import numpy as np
import pytest
import xarray
from commands import assert_refused
from hypothesis import given, strategies as st

from jentry.addresses import leaves_by_address
from jentry.campaign import open_campaign
from jentry.campaign.errors import CampaignError
from jentry.cli.mission_report import print_missions
from jentry.cli.options import chosen_scenario
from jentry.flight.scenario_checks import check
from jentry.missions import ALL, find_mission
from jentry.missions.choice import Choice
from jentry.missions.stored import stored_choice, stored_scenario
from jentry.world import USStandardAtmosphere1976


def heavy(scenario):
    """A vehicle of twice the mass. And more words."""
    return _with_mass(scenario, 2.0)


def light(scenario):
    return _with_mass(scenario, 0.5)


def _with_mass(scenario, factor):
    vehicle = dataclasses.replace(scenario.vehicle, mass=factor * scenario.vehicle.mass)
    return dataclasses.replace(scenario, vehicle=vehicle)


def low(scenario):
    """A start 10 km lower."""
    start = scenario.initial_state
    start = dataclasses.replace(start, altitude=start.altitude - 10e3)
    return dataclasses.replace(scenario, initial_state=start)


def thin(scenario):
    """Air of half the density."""
    planet = dataclasses.replace(scenario.planet, density_scale=np.array(0.5))
    return dataclasses.replace(scenario, planet=planet)


def of_the_tail(scenario):
    """A world of a law that is another."""
    return eqx.tree_at(lambda s: s.guidance.tail, scenario, 1.0)


def nothing(scenario):
    return None


THREE = dataclasses.replace(
    cheap.MISSION,
    name="three",
    cases={"low": low},
    worlds={"thin": thin, "heavy": heavy, "tail": of_the_tail, "none": nothing},
    former_variants={"thin-right": "right world thin"},
)


@pytest.fixture
def three(command, monkeypatch):
    monkeypatch.setitem(ALL, "three", THREE)
    return command


name = st.text("abcxyz-123", min_size=1).filter(lambda x: x not in ("case", "world"))


@given(st.none() | name, st.none() | name, st.lists(name, unique=True))
def test_what_is_written_is_read_again(law, case, worlds):
    choice = Choice.given(law, case, worlds)
    assert Choice.of(str(choice)) == choice
    assert Choice.given(**choice.labels) == choice
    assert " " not in choice.folder
    assert all(x is not None for x in choice.labels.values())


@pytest.mark.parametrize(
    "text", ["a b", "a world", "a case", "a world x case 1", "a  world x", "case 1 a"]
)
def test_what_is_written_otherwise_is_refused(text):
    with pytest.raises(ValueError, match="write LAW"):
        Choice.of(text)


@pytest.mark.parametrize(
    "axes, message",
    [
        ({"law": 3}, "law is 3: it must be a name"),
        ({"case": ["1"]}, "case is"),
        ({"world": [1]}, "world is 1"),
        ({"world": 1.0}, "a list of names"),
        ({"world": ["a", "a"]}, "world a is given twice"),
    ],
)
def test_what_is_no_name_is_refused(axes, message):
    with pytest.raises(ValueError, match=message):
        Choice.given(**axes)


@pytest.mark.parametrize("law", THREE.laws)
def test_each_law_in_each_case_and_world(law):
    """The changes alone, one after another, and nothing else."""
    plain = leaves_by_address(THREE.scenario(law))
    changed = leaves_by_address(THREE.scenario(law, "low", ["thin", "heavy"]))
    factors = {
        "planet.density_scale": 0.5,
        "vehicle.mass": 2.0,
        "initial_state.altitude": 1.0 - 10e3 / float(plain["initial_state.altitude"]),
    }
    for address, leaf in plain.items():
        expected = factors.get(address, 1.0) * np.asarray(leaf)
        np.testing.assert_allclose(changed[address], expected, rtol=1e-15)


def test_the_first_law_is_the_missions_own():
    own = THREE.scenario(world="thin")
    assert eqx.tree_equal(own, THREE.scenario("right", world=("thin",)))
    assert THREE.complete(Choice(case="low")) == Choice("right", "low")
    assert eqx.tree_equal(
        THREE.scenario_of("steep case low"), THREE.scenario("steep", "low")
    )


@pytest.mark.parametrize(
    "text, message",
    [
        ("left", "mission three has no law 'left': choose from right, steep"),
        ("right case 1", "mission three has no case '1': choose from low"),
        ("right world wet", "has no world 'wet': choose from thin, heavy, tail, none"),
        (
            "steep world tail",
            "world tail of mission three does not go with .* steep world",
        ),
        ("right world none", "a world of mission three makes a NoneType"),
    ],
)
def test_what_there_is_not_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        THREE.scenario_of(text)


def test_a_mission_without_cases_says_so():
    with pytest.raises(ValueError, match="mission cheap has no case"):
        cheap.MISSION.scenario(case="low")


@pytest.mark.parametrize("name", ["a b", "all", "case", "world", ""])
@pytest.mark.parametrize("axis", ["laws", "cases", "worlds"])
def test_names_are_words(axis, name):
    with pytest.raises(ValueError, match=f"{axis} of mission .* without spaces"):
        dataclasses.replace(THREE, **{axis: {name: heavy}})


@pytest.mark.parametrize("mission", ALL.values(), ids=list(ALL))
def test_what_was_a_variant_is_still_chosen(mission):
    """Every one names a law, a case and worlds that there are."""
    for former, text in mission.former_variants.items():
        choice = Choice.of(text)
        assert choice.law in mission.laws
        assert choice.case is None or choice.case in mission.cases
        assert set(choice.worlds) <= set(mission.worlds)
        assert former != text


@pytest.mark.slow
def test_every_law_goes_with_every_world():
    """Those that do not are refused with a sentence; here none is."""
    for name in ("mars-range-tracking", "apollo-10", "cav-h-glide"):
        mission = find_mission(name)
        for law in mission.laws:
            for case in (None, *mission.cases):
                for world in mission.worlds:
                    check(mission.scenario(law, case, world))


def test_the_command_composes_and_stores(three, tmp_path):
    words = ("three", "--law", "steep", "--case", "low", "--world", "thin")
    words += ("--world", "heavy", "--runs", 3, "--step", 1, "--no-figures")
    code, _, said = three("monte-carlo", *words, "--out", tmp_path / "out")
    assert code == 0, said
    results = open_campaign(tmp_path / "out")
    described = json.loads(results.attrs["campaign"])
    chosen = {axis: described[axis] for axis in ("law", "case", "world")}
    assert chosen == {"law": "steep", "case": "low", "world": ["thin", "heavy"]}
    assert "variant" not in described
    code, _, _ = three("inspect", tmp_path / "out", "--by", "miss_distance")
    assert code == 0


def test_a_file_chooses_and_the_command_comes_first(three, tmp_path):
    config = tmp_path / "given.toml"
    config.write_text('law = "steep"\ncase = "low"\nworld = ["thin", "heavy"]\n')

    def numbers(*choice, config=config):
        _, scenario, _ = chosen_scenario("three", choice, config, None)
        return {
            a: float(x) for a, x in leaves_by_address(scenario).items() if x.ndim == 0
        }

    plain, filed = numbers(config=None), numbers()
    both = numbers("right", None, ["thin"])
    mass, density = "vehicle.mass", "planet.density_scale"
    assert filed[mass] == 2.0 * plain[mass] and both[mass] == plain[mass]
    assert filed[density] == both[density] == 0.5
    start = "initial_state.altitude"
    assert filed[start] == both[start] == plain[start] - 10e3
    bank = "guidance.bank_angle"
    assert filed[bank] != plain[bank] == both[bank]
    config.write_text('world = "thin"\n')
    assert numbers()[density] == 0.5
    config.write_text("world = [1]\n")
    assert_refused(three("show", "three", "--config", config), "world is 1")


def test_the_list_has_a_sentence_for_each(three):
    _, printed, _ = three("list", "three")
    assert "\n  cases\n    low  A start 10 km lower.\n" in printed
    assert "    heavy  A vehicle of twice the mass.\n" in printed
    assert "And more words" not in printed


def test_laws_are_compared_in_one_world(three, tmp_path):
    """`all` are all of them."""
    words = ("three", "--law", "all", "--world", "thin", "--runs", 4, "--step", 1)
    code, printed, said = three("compare", *words, "--out", tmp_path / "out")
    assert code == 0, said
    assert "2 alternatives on the same draws" in printed
    for law in THREE.laws:
        described = json.loads(open_campaign(tmp_path / "out" / law).attrs["campaign"])
        assert (described["law"], described["world"]) == (law, ["thin"])
    refused = three("compare", "a", "b", "--world", "thin")
    assert_refused(refused, "compared as they are")


def described(**labels):
    return {"mission": "three", "scenario": {}, **labels}


def test_campaigns_of_earlier_versions_are_read():
    """They name a variant; what it is now is in the mission."""
    assert stored_choice(described(variant="thin-right"), THREE) == Choice(
        "right", None, ("thin",)
    )
    assert stored_choice(described(variant="steep"), THREE) == Choice("steep")
    given = described(law="steep", world=["thin", "heavy"])
    assert stored_choice(given, THREE) == Choice("steep", None, ("thin", "heavy"))
    assert stored_choice(described(), THREE) == Choice()
    with pytest.raises(CampaignError, match="is of left, which three does not have"):
        stored_scenario(described(variant="left"), THREE)


@pytest.mark.parametrize("frequency, world", [(3.0, "attitude-3"), (8.0, "attitude-8")])
def test_a_law_that_inverts_the_lag_knows_the_attitude_of_its_world(frequency, world):
    mission = find_mission("rlv")
    scenario = mission.scenario("lag-inverted", world=world)
    response = scenario.attitude.angle_of_attack_response
    assert float(response.frequency) == frequency
    lag = scenario.guidance.angle_of_attack.lag
    assert float(lag.frequency) == frequency
    assert float(lag.damping) == float(response.damping) == 0.9
    assert (
        mission.scenario("modulation", world=world).guidance.angle_of_attack.lag is None
    )
    noisy = mission.scenario("lag-inverted", world=[world, "noise"])
    assert float(noisy.accelerometers.noise) == pytest.approx(2e-4 * 9.80665)
    assert float(noisy.attitude.angle_of_attack_response.frequency) == frequency


@pytest.mark.parametrize("mission", ALL.values(), ids=list(ALL))
def test_each_entry_of_a_mission_has_a_sentence_that_stands_by_itself(mission, capsys):
    print_missions([mission])
    printed = capsys.readouterr().out
    for axis in ("laws", "cases", "worlds", "dispersions"):
        for entry in getattr(mission, axis):
            found = re.search(
                rf"^    {re.escape(entry)} +(\S.*)$", printed, re.MULTILINE
            )
            assert found, entry
            assert found[1].endswith("."), found[1]
            assert not found[1].lower().startswith("the same"), found[1]


def test_worlds_of_the_glider():
    mission = find_mission("cav-h-glide")
    still, thick = (mission.scenario(world=world) for world in ("at-rest", "us-1976"))
    plain = mission.scenario()
    known = lambda scenario: scenario.guidance.model.planet
    assert float(known(still).rotation_rate) == 0.0 < float(known(plain).rotation_rate)
    assert eqx.tree_equal(still.planet, plain.planet)
    assert isinstance(thick.planet.atmosphere, USStandardAtmosphere1976)
    assert eqx.tree_equal(known(thick), known(plain))


def test_one_flight_is_stored_with_what_was_flown(three, tmp_path):
    words = ("three", "--law", "steep", "--case", "low", "--world", "thin", "--step", 1)
    code, _, said = three("fly", *words, "--out", tmp_path / "flight.nc")
    assert code == 0, said
    with xarray.open_dataset(tmp_path / "flight.nc", engine="h5netcdf") as stored:
        described = json.loads(stored.attrs["campaign"])
    chosen = {axis: described[axis] for axis in ("law", "case", "world")}
    assert chosen == {"law": "steep", "case": "low", "world": ["thin"]}
