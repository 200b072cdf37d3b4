"""The network, and the file that it is kept in."""

import io
import json
import pickle
import zipfile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._files import digest_of_arrays
from jentry.guidance.bezier.prediction import VELOCITIES
from jentry.missions.cav_h.stored_networks import FOLDER, PURPOSES, network_predictor
from jentry.onboard import Network, load_network, save_network


CARD = {"purpose": "a test", "seed": 3}


NAMES = "range", "rate", "the same", "the same but for rounding"


@pytest.fixture
def network(key):
    rng = np.random.default_rng(0)
    inputs = rng.normal([5.0, -2.0, 7.0, 0.8], [2.0, 1e-3, 0.0, 1e-13], (50, 4))
    return Network.untrained(NAMES, inputs, rng.normal(100.0, 20.0, 50), (8, 4), key)


@pytest.fixture
def stored(network, tmp_path):
    path = tmp_path / "network.npz"
    save_network(path, network, CARD)
    return path


def test_normalisation_is_inside(network):
    """At the mean input only the biases count; they are zero before training."""
    assert float(network(network.input_mean)) == float(network.output_mean)
    moved = network.input_mean + jnp.array([2.0, 1e-3, 0.0, 0.0])
    assert float(network(moved)) != float(network.output_mean)


def test_a_constant_input_has_no_influence(network):
    """Rounding in the training data is no scale: a network cannot have learnt from it."""
    at = network.input_mean + jnp.array([1.0, 1e-3, 0.0, 0.0])
    for moved in ([0.0, 0.0, 1e-12, 1e-12], [0.0, 0.0, 100.0, -3.0]):
        assert float(network(at + jnp.array(moved))) == float(network(at))
    assert bool(network.knows(at + jnp.array([0.0, 0.0, 1e-12, 1e-12])))
    for moved, outside in (([0.0, 0.0, 1e-6, 0.0], 2), ([0.0, 0.0, 0.0, 1e-6], 3)):
        found = network.outside(at + jnp.array(moved))
        assert np.flatnonzero(found).tolist() == [outside]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("number", range(4))
def test_each_input_has_its_range(network, number, sign):
    bound = network.input_ranges[number, 0 if sign < 0.0 else 1]
    at = network.input_mean.at[number].set(bound)
    assert bool(network.knows(at))
    beyond = at.at[number].add(sign * 1e-6)
    assert np.flatnonzero(network.outside(beyond)).tolist() == [number]
    assert not bool(network.knows(at.at[number].set(jnp.nan)))


def test_output_is_what_the_layers_say(network):
    given = np.array([6.0, -2.001, 7.0, 0.8])
    x = (given - network.input_mean) * network.input_scale
    for weights, biases in zip(network.weights[:-1], network.biases[:-1], strict=True):
        x = np.tanh(weights @ x + biases)
    (y,) = network.weights[-1] @ x + network.biases[-1]
    expected = network.output_mean + network.output_deviation * y
    found = network(jnp.asarray(given))
    assert float(found) == pytest.approx(float(expected), rel=1e-13)


def test_what_is_stored_is_read_again(network, stored):
    again, card = load_network(stored, "a test")
    ranges = np.asarray(network.input_ranges).tolist()
    assert card == CARD | {
        "inputs": dict(zip(NAMES, ranges, strict=True)),
        "hidden": [8, 4],
    }
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
                name, buffer.getvalue() if name == "weights0.npy" else content
            )
    with pytest.raises(ValueError, match="is no stored network"):
        load_network(stored)


def test_a_changed_weight_is_noticed(network, stored):
    with np.load(stored) as arrays:
        changed = {name: arrays[name] for name in arrays.files}
    changed["weights0"] = changed["weights0"] + 1e-9
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


NAN = float("nan")


@pytest.mark.parametrize(
    "where, value, message",
    [
        (lambda n: n.weights[1], lambda x: x * NAN, "its weights are not finite"),
        (lambda n: n.input_mean, lambda x: x * NAN, "its input_mean are not finite"),
        (lambda n: n.weights[0], lambda x: x[:, :3], "do not lead from 4 inputs to"),
        (lambda n: n.biases[0], lambda x: x[:5], "do not lead from 4 inputs to"),
        (lambda n: n.input_scale, lambda x: x[:3], r"input_scale has shape \(3,\)"),
        (lambda n: n.output_mean, lambda x: x[None], "output_mean has shape"),
        (lambda n: n.input_scale, lambda x: -x, "scale of its inputs is negative"),
        (lambda n: n.input_mean, lambda x: x + 9.0, "mean of 'range' is outside"),
        (lambda n: n.input_ranges, lambda x: x * NAN, "range of 'range' .*two finite"),
        (lambda n: n.input_ranges, lambda x: x[:, ::-1], "the smaller first"),
        (lambda n: n.input_ranges, lambda x: x[:, :1], "two finite numbers"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(
    network, tmp_path, where, value, message
):
    """Its digest is right: it was written so. The message names the file."""
    path = tmp_path / "broken.npz"
    save_network(path, eqx.tree_at(where, network, value(where(network))), CARD)
    with pytest.raises(ValueError, match=f"broken.npz contradicts itself: .*{message}"):
        load_network(path)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"extra": np.zeros(3)}, "a network has no extra"),
        ({"weights2": np.array("text")}, "weights2 is an array of <U4"),
        ({"card": np.array("[]")}, "no ranges of inputs on its card"),
        ({"card": np.array('{"inputs": 3}')}, "no ranges of inputs on its card"),
        ({"card": np.array('{"inputs": {"a": [0, "b"]}}')}, "two finite numbers"),
        ({"card": np.array('{"inputs": {"a": [0, 1]}}')}, "lead from 1 inputs"),
    ],
)
def test_other_contents_are_refused(stored, change, message):
    """With the digest of what is there."""
    with np.load(stored) as arrays:
        changed = {name: arrays[name] for name in arrays.files if name != "digest"}
    changed |= change
    changed["digest"] = np.array(digest_of_arrays(changed, "jentry network 2"))
    with stored.open("wb") as file:
        np.savez(file, **changed)
    with pytest.raises(ValueError, match=f"network.npz .*{message}"):
        load_network(stored)


def test_velocities_of_another_card_are_refused(tmp_path):
    """What is on the card beside the inputs is checked too."""
    network, card = load_network(FOLDER / "stored.npz")
    for given in ([3000.0, 2000.0], [2000.0, NAN], None, 2630.0):
        save_network(tmp_path / "stored.npz", network, card | {VELOCITIES: given})
        with pytest.raises(ValueError, match="stored.npz .*velocity at the target"):
            network_predictor.__wrapped__("stored", tmp_path)
    other, _ = load_network(FOLDER / "state-only.npz")
    save_network(tmp_path / "stored.npz", other, card)
    with pytest.raises(ValueError, match="stored.npz .*has 8 inputs"):
        network_predictor.__wrapped__("stored", tmp_path)


@pytest.mark.parametrize("name", PURPOSES)
def test_a_network_that_comes_with_the_package(name):
    """Its card says what it is, and what to do to have it again."""
    predictor = network_predictor(name)
    network, card = load_network(FOLDER / f"{name}.npz")
    assert list(card["inputs"]) == list(predictor.inputs.names)
    assert card["command"].startswith(f"jentry train cav-h --seed {card['seed']} ")
    assert predictor.velocities.tolist() == card[VELOCITIES]
    reasons = card["left out"]
    assert "do not reach the target" in reasons
    # Beside what the median of all flights would miss by.
    at_entry = card["held out mean error at the entry, m/s"]
    by_chance = card["mean deviation at the entry from the median, m/s"]
    if name == "state-only":
        assert list(reasons.values()) == [0]
        # What no state tells. The notes: 10 % of C_D, or of density, move the velocity by
        # 320 m/s; each has 3.3 % of one sigma, and a normal error a mean of 0.8 sigma.
        unknown = np.sqrt(2.0 / np.pi) * np.sqrt(2.0) * 320.0 / 3.0
        assert at_entry == pytest.approx(unknown, rel=0.1)
        assert at_entry < by_chance  # the entry itself is known
    else:
        assert len(reasons) == 3
        assert card["held out mean error, m/s"] < 1.0
        assert at_entry < 0.01 * by_chance


@pytest.mark.parametrize("name", PURPOSES)
def test_shipped_network_as_numpy_reads_its_file(name):
    """Evaluated from the file alone, with the layers written out."""
    with np.load(FOLDER / f"{name}.npz") as file:
        stored = {key: file[key] for key in file.files}
    ranges = json.loads(str(stored["card"]))["inputs"]
    lower, upper = np.array(list(ranges.values())).T
    network = network_predictor(name).network
    shares = np.random.default_rng(1).uniform(size=(50, len(lower)))
    for x in lower + shares * (upper - lower):
        layer = (x - stored["input_mean"]) * stored["input_scale"]
        layer = np.tanh(stored["weights0"] @ layer + stored["biases0"])
        layer = np.tanh(stored["weights1"] @ layer + stored["biases1"])
        out = (stored["weights2"] @ layer + stored["biases2"]).item()
        expected = stored["output_mean"] + stored["output_deviation"] * out
        # Sums of 24 terms of mixed signs, in another order.
        assert float(network(jnp.asarray(x))) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", PURPOSES)
def test_shipped_network_is_continuous_in_every_input(name):
    """A billionth of the size of any input moves the prediction by next to nothing.

    The inputs are of the order of 1. For the entry, X is about 1 rad and v about 7 km/s:
    1e-6 of the output, which is about 1, is 3 mm/s at the target.
    """
    network = network_predictor(name).network
    lower, upper = np.asarray(network.input_ranges).T
    shares = np.random.default_rng(2).uniform(size=(100, len(lower)))
    at = jnp.asarray(lower + shares * (upper - lower))
    evaluate = jax.jit(jax.vmap(network))
    for number in range(len(lower)):
        moved = at.at[:, number].add(1e-9 * max(abs(lower[number]), abs(upper[number])))
        assert np.max(np.abs(evaluate(moved) - evaluate(at))) < 1e-6
