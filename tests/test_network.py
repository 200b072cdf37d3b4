"""The network, and the file that it is kept in."""

import io
import json
import pickle
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.missions.cav_h_networks import FOLDER, PURPOSES, network_predictor
from jentry.onboard import Network, load_network, save_network


CARD = {"purpose": "a test", "seed": 3}


@pytest.fixture
def network(key):
    rng = np.random.default_rng(0)
    inputs = rng.normal([5.0, -2.0, 7.0], [2.0, 1e-3, 0.0], (50, 3))
    return Network.untrained(inputs, rng.normal(100.0, 20.0, 50), (8, 4), key)


@pytest.fixture
def stored(network, tmp_path):
    path = tmp_path / "network.npz"
    save_network(path, network, CARD)
    return path


def test_normalisation_is_inside(network):
    """At the mean input only the biases count; they are zero before training."""
    assert float(network(network.input_mean)) == float(network.output_mean)
    assert float(network.input_deviation[2]) == 1.0  # the same in all samples
    moved = network.input_mean + jnp.array([2.0, 1e-3, 0.0])
    assert float(network(moved)) != float(network.output_mean)


def test_output_is_what_the_layers_say(network):
    x = (np.array([6.0, -2.001, 7.0]) - network.input_mean) / network.input_deviation
    for weights, biases in zip(network.weights[:-1], network.biases[:-1], strict=True):
        x = np.tanh(weights @ x + biases)
    (y,) = network.weights[-1] @ x + network.biases[-1]
    expected = network.output_mean + network.output_deviation * y
    found = network(jnp.array([6.0, -2.001, 7.0]))
    assert float(found) == pytest.approx(float(expected), rel=1e-13)


def test_what_is_stored_is_read_again(network, stored):
    again, card = load_network(stored, "a test")
    assert card == CARD
    for ours, theirs in zip(*map(jax.tree.leaves, (network, again)), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_no_file():
    with pytest.raises(FileNotFoundError, match="jentry train"):
        load_network("nowhere.npz")


@pytest.mark.parametrize("content", [b"", b"not a network", b"PK\x03\x04 broken"])
def test_something_else_is_refused(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="is no stored network"):
        load_network(path)


def test_other_arrays_are_refused(tmp_path):
    path = tmp_path / "other.npz"
    np.savez(path, a=np.arange(3))
    with pytest.raises(ValueError, match="is no stored network"):
        load_network(path)


class Trap:
    def __reduce__(self):
        return pytest.fail, ("a file was unpickled",)


def test_nothing_is_unpickled(stored):
    """A pickled array in the place of weights is refused, not executed."""
    with zipfile.ZipFile(stored) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    trap = np.empty(1, dtype=object)
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "|O", "fortran_order": False, "shape": (1,)}
    )
    trap[0] = Trap()
    buffer.write(pickle.dumps(trap))
    with zipfile.ZipFile(stored, "w") as archive:
        for name, content in members.items():
            archive.writestr(
                name, buffer.getvalue() if name == "leaf0.npy" else content
            )
    with pytest.raises(ValueError, match="is no stored network"):
        load_network(stored)


def test_a_changed_weight_is_noticed(network, stored):
    with np.load(stored) as arrays:
        changed = {name: arrays[name] for name in arrays.files}
    changed["leaf0"] = changed["leaf0"] + 1e-9
    with stored.open("wb") as file:
        np.savez(file, **changed)
    with pytest.raises(ValueError, match="is damaged"):
        load_network(stored)


def test_a_changed_card_is_noticed(stored):
    with np.load(stored) as arrays:
        changed = {name: arrays[name] for name in arrays.files}
    changed["card"] = np.array(json.dumps({"purpose": "another"}))
    with stored.open("wb") as file:
        np.savez(file, **changed)
    with pytest.raises(ValueError, match="is damaged"):
        load_network(stored)


def test_another_purpose_is_refused(stored):
    with pytest.raises(ValueError, match="for 'a test': expected 'this'"):
        load_network(stored, "this")


def test_weights_that_are_not_finite_are_refused(network, tmp_path):
    broken = jax.tree.map(lambda x: x * jnp.nan, network)
    save_network(tmp_path / "broken.npz", broken, CARD)
    with pytest.raises(ValueError, match="not finite"):
        load_network(tmp_path / "broken.npz")


@pytest.mark.parametrize("name", PURPOSES)
def test_a_network_that_comes_with_the_package(name):
    """Its card says what it is, and what to do to have it again."""
    predictor = network_predictor(name)
    _, card = load_network(FOLDER / f"{name}.npz")
    assert list(card["inputs"]) == list(predictor.inputs.names)
    assert card["command"].startswith(f"jentry train cav-h --seed {card['seed']} ")
    good = card["held out mean error, m/s"] <= 1.0
    assert good == (name != "state-only")
