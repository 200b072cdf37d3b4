"""`jentry train`: networks of a mission."""

import dataclasses
import re
from pathlib import Path

import cheap
import pytest
from commands import Arrived, assert_refused, intercepted

from jentry.missions import ALL


def test_every_option_of_train_arrives(command, monkeypatch):
    seen = {}

    def train(folder, seed, **options):
        seen.update(options, folder=folder, seed=seed)
        raise Arrived

    able = dataclasses.replace(cheap.MISSION, train=train)
    monkeypatch.setitem(ALL, "cheap", able)
    words = ("--out", "there", "--seed", 11, "--flights", 150, "--again", 120)
    with pytest.raises(Arrived):
        command("train", "cheap", *words, "--iterations", 7)
    del seen["report"]
    numbers = {"seed": 11, "flights": 150, "again": 120, "iterations": 7}
    assert seen == {"folder": Path("there"), **numbers}


def test_train_is_for_missions_with_networks(command):
    assert_refused(
        command("train", "mars-drag-tracking"),
        "has no networks to train: see mars-range-tracking, cav-h",
    )
    assert_refused(command("train", "cav-h", "--flights", 3), "--flights is 3")
    assert_refused(command("train", "cav-h", "--iterations", 0), "--iterations is 0")


def test_every_option_of_the_training_of_a_law_arrives(command, monkeypatch):
    import jentry.learning.law_training as law_training

    seen = {}

    def train_law(training, seed, folder, **options):
        seen.update(options, training=training, folder=folder, seed=seed)
        raise Arrived

    monkeypatch.setattr(law_training, "train_law", train_law)
    trainings = {"neural": lambda: "its training"}
    able = dataclasses.replace(cheap.MISSION, law_trainings=trainings)
    monkeypatch.setitem(ALL, "cheap", able)
    words = ("--law", "neural", "--imitate", "--out", "there", "--seed", 11)
    with pytest.raises(Arrived):
        command("train", "cheap", *words)
    del seen["say"], seen["report"]
    made = {
        "mission": "cheap",
        "law": "neural",
        "command": "jentry train cheap --law neural --seed 11 --imitate",
    }
    given = {"training": "its training", "folder": Path("there"), "seed": 11}
    assert seen == given | {"imitate": True, "card": made}


def test_the_seeds_of_the_training_of_a_law_arrive(command, monkeypatch):
    seen = intercepted(monkeypatch, "jentry.learning.law_seeds", "train_law_of_seeds")
    trainings = {"neural": lambda: "its training"}
    able = dataclasses.replace(cheap.MISSION, law_trainings=trainings)
    monkeypatch.setitem(ALL, "cheap", able)
    words = ("--law", "neural", "--seed", 11, "--seed", 3, "--out", "there")
    with pytest.raises(Arrived):
        command("train", "cheap", *words)
    assert seen["given"] == ("its training", [11, 3], Path("there"))
    made = "jentry train cheap --law neural --seed 11 --seed 3"
    assert seen["card"]["command"] == made and seen["imitate"] is False
    assert_refused(
        command("train", "cav-h", "--seed", 1, "--seed", 2),
        "there are 2 seeds: networks that predict have one",
    )
    assert_refused(
        command("train", "cav-h", "--seed", 2**63), "the seed is 9223372036854775808"
    )


def test_the_laws_of_seeds_are_printed_with_their_spread(capsys):
    from jentry.cli.training_report import print_seeds
    from jentry.learning import LawTraining, SeedsOfLaw
    from jentry.learning.training_record import HeldOut

    choosing = {
        4: HeldOut((1.0, 2.0, 3.125, 4.0), 0),
        9: HeldOut((1.5, 2.5, 2.25, 4.5), 0),
        2: HeldOut((1.5, 2.5, 8.75, 4.5), 7),
    }
    final = HeldOut((1.0, 2.0, 2.5, 5.0), 1)
    laws = SeedsOfLaw({}, choosing, 9, final)
    training = LawTraining(cheap.scenario(), lambda network: cheap.scenario(), {})
    print_seeds(cheap.MISSION, "neural", training, laws)
    printed = capsys.readouterr().out
    for row in ("seed 4 1 2 3.125 4 0", "seed 2 1.5 2.5 8.75 4.5 7"):
        assert row in " ".join(re.findall(r"[\w.]+", printed))
    assert "others seed 9 1 2 2.5 5 1" in " ".join(re.findall(r"[\w.]+", printed))
    assert "best of 3 seeds by 99 %: seed 9; 99 % is from 2.25 to 8.75" in printed
    assert "median 3.125" in printed


def test_the_training_of_a_law_is_refused_by_name(command):
    mars = ("train", "mars-range-tracking")
    assert_refused(
        command(*mars, "--law", "neural", "--flights", 300),
        "--flights is for networks that predict: leave it out with --law",
    )
    assert_refused(command(*mars, "--imitate"), "--imitate is for a law")
    assert_refused(
        command(*mars, "--law", "range-tracking"),
        "has no training of a law 'range-tracking': choose from neural",
    )
    assert_refused(
        command("train", "sx-2", "--law", "neural"), "has no training of a law"
    )


@pytest.mark.slow
def test_train_trains_a_law_and_prints_its_errors(command, monkeypatch, tmp_path):
    from test_law_training import training_of

    from jentry.onboard import load_recurrent_network

    able = dataclasses.replace(cheap.MISSION, law_trainings={"small": training_of})
    monkeypatch.setitem(ALL, "cheap", able)
    code, printed, said = command("train", "cheap", "--law", "small", "--out", "law")
    assert code == 0
    assert "AdamSteps" not in said and "Adam 1, 12 of 12 steps, 768 flights" in said
    assert "GaussNewton 3, 2 of 2 steps, 1280 flights" in said
    assert "distance on held-out flights" in printed
    assert "of 1280 flights with derivatives" in printed
    _, card = load_recurrent_network(tmp_path / "law" / "law.npz")
    assert card["command"] == "jentry train cheap --law small --seed 0"


@pytest.mark.slow
def test_train_stores_networks_that_are_read_again(command, monkeypatch, tmp_path):
    """One of them: the others take as long."""
    from jentry.missions.cav_h.stored_networks import PURPOSES, network_predictor

    for name in set(PURPOSES) - {"stored"}:
        monkeypatch.delitem(PURPOSES, name)
    small = ("--flights", 150, "--again", 100, "--iterations", 20)
    code, printed, said = command("train", "cav-h", *small, "--out", "networks")
    assert code == 0
    assert "stored: L-BFGS, 20 steps" in said
    for name, purpose in PURPOSES.items():
        assert name in printed
        assert network_predictor(name, tmp_path / "networks").inputs is purpose.inputs
