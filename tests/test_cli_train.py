"""`jentry train`: networks of a mission."""

import dataclasses
from pathlib import Path

import cheap
import pytest
from commands import Arrived, assert_refused

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
