"""The recurrent network of a law, and the file that it is kept in."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry._files import read_sealed, write_sealed
from jentry.onboard import (
    RecurrentNetwork,
    load_recurrent_network,
    save_recurrent_network,
)
from jentry.onboard.recurrent_network import _FORMAT, ranges_of


CARD = {"purpose": "a test"}

SAMPLES = {
    name: np.random.default_rng(place).normal(place, 1.0 + place, 40)
    for place, name in enumerate(("height", "speed", "angle"))
}


def network_of(memory=2, hidden=(5, 4), outputs=1):
    key = jax.random.key(3)
    return RecurrentNetwork.untrained(SAMPLES, memory, hidden, outputs, key)


@pytest.fixture
def network():
    return network_of()


@pytest.fixture
def stored(network, tmp_path):
    path = tmp_path / "law.npz"
    save_recurrent_network(path, network, CARD)
    return path


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def by_formulas(network, inputs, memory):
    """Cho and others (2014), with the reset gate on the product, in numpy."""
    x = (inputs - np.asarray(network.input_mean)) * np.asarray(network.input_scale)
    cell = jax.tree.map(np.asarray, network.cell)
    of_input = cell.weight_ih @ x + cell.bias
    of_memory = cell.weight_hh @ memory
    reset, keep, new = np.split(of_input, 3)
    reset_memory, keep_memory, new_memory = np.split(of_memory, 3)
    reset, keep = sigmoid(reset + reset_memory), sigmoid(keep + keep_memory)
    new = np.tanh(new + reset * (new_memory + cell.bias_n))
    memory = new + keep * (memory - new)
    y = np.concatenate([x, memory])
    for layer in network.layers[:-1]:
        y = np.tanh(np.asarray(layer.weight) @ y + np.asarray(layer.bias))
    last = network.layers[-1]
    return np.asarray(last.weight) @ y + np.asarray(last.bias), memory


def test_outputs_and_memory_are_those_of_the_formulas(network):
    memory, expected_memory = network.start(), np.zeros(2)
    for inputs in np.random.default_rng(0).normal(0.0, 2.0, (4, 3)):
        found, memory = network(jnp.asarray(inputs), memory)
        expected, expected_memory = by_formulas(network, inputs, expected_memory)
        np.testing.assert_allclose(found, expected, rtol=1e-13)
        np.testing.assert_allclose(memory, expected_memory, rtol=1e-13)


def test_without_a_cell_there_is_no_memory():
    plain = network_of(memory=0)
    assert plain.start().shape == (0,)
    inputs = jnp.asarray([0.1, 0.2, 0.3])
    first, memory = plain(inputs, plain.start())
    second, _ = plain(inputs, memory)
    assert float(first[0]) == float(second[0])


def test_the_first_outputs_are_small(network):
    """A law from random weights begins close to the middle of its range."""
    output, _ = network(network.input_mean, network.start())
    assert abs(float(output[0])) < 0.3


def test_an_input_that_hardly_varies_is_scaled_less():
    """By a thousandth; one that is constant in the samples is not scaled at all."""
    samples = {
        "constant": np.full(9, 5.0),
        "hardly": np.linspace(-1e-5, 1e-5, 9),
        "usual": np.linspace(-2.0, 2.0, 9),
    }
    key = jax.random.key(0)
    found = RecurrentNetwork.untrained(samples, 2, (3,), 1, key)
    expected = [1.0, 1e3, 1.0 / np.std(samples["usual"])]
    np.testing.assert_allclose(found.input_scale, expected, rtol=1e-12)
    np.testing.assert_allclose(found.input_mean, [5.0, 0.0, 0.0], atol=1e-18)


def test_each_input_has_its_range(network):
    lower, upper = np.asarray(network.input_ranges).T
    assert bool(network.knows(jnp.asarray(lower))) and bool(
        network.knows(jnp.asarray(upper))
    )
    for place in range(3):
        for bound, sign in ((lower, -1.0), (upper, 1.0)):
            beyond = bound.copy()
            beyond[place] += sign * 1e-9
            assert not bool(network.knows(jnp.asarray(beyond)))
    assert not bool(network.knows(jnp.full(3, jnp.nan)))


def test_ranges_are_those_of_the_samples():
    samples = np.array([[1.0, -3.0], [2.0, -5.0], [0.5, 4.0]])
    assert ranges_of(samples).tolist() == [[0.5, 2.0], [-5.0, 4.0]]


def test_a_stored_network_is_the_same(network, stored):
    found, card = load_recurrent_network(stored, "a test")
    assert eqx.tree_equal(found, network)
    assert card["inputs"].keys() == SAMPLES.keys()
    assert (card["memory"], card["hidden"], card["outputs"]) == (2, [5, 4], 1)


def changed(path, change):
    arrays = read_sealed(path, _FORMAT)
    card = json.loads(str(arrays["card"]))
    change(arrays, card)
    write_sealed(path, arrays | {"card": np.array(json.dumps(card))}, _FORMAT)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda a, c: c.update(purpose="another"), "expected 'a test'"),
        (lambda a, c: c.pop("purpose"), "for None: expected 'a test'"),
        (lambda a, c: c.update(hidden=[5, 5]), "by its card they are"),
        (lambda a, c: c.update(memory=-1), "must not be negative"),
        (lambda a, c: c["inputs"].update(speed=[3.0, 1.0]), "range of 'speed'"),
        (lambda a, c: c["inputs"].update(speed=[0.0, 1.0]), "not those of its card"),
        (lambda a, c: a.pop("layers.0.bias"), "by its card they are"),
        (
            lambda a, c: a["layers.0.bias"].fill(np.nan),
            "layers.0.bias is not of finite",
        ),
        (
            lambda a, c: a.update({"input_mean": a["input_mean"].astype(np.float32)}),
            "input_mean is not of finite numbers of 64 bits",
        ),
    ],
)
def test_a_file_that_lies_is_refused(stored, change, said):
    changed(stored, change)
    with pytest.raises(ValueError, match=said):
        load_recurrent_network(stored, "a test")


def test_a_damaged_or_missing_file_is_refused(stored):
    stored.write_bytes(stored.read_bytes()[:-200])
    with pytest.raises(ValueError, match="is no stored network"):
        load_recurrent_network(stored)
    stored.unlink()
    with pytest.raises(FileNotFoundError, match="jentry train MISSION --law"):
        load_recurrent_network(stored)


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda n: {"names": ("height", "speed")}, "input_mean has shape"),
        (lambda n: {"input_ranges": jnp.zeros((3, 3))}, "input_ranges has shape"),
        (lambda n: {"cell": None}, "the layers read"),
        (lambda n: {"layers": n.layers[2:]}, "the layers read"),
        (lambda n: {"layers": ()}, "the layers read"),
    ],
)
def test_parts_that_do_not_fit_are_refused(network, change, said):
    parts = {f: getattr(network, f) for f in network.__dataclass_fields__}
    with pytest.raises(ValueError, match=said):
        RecurrentNetwork(**parts | change(network))


def test_sizes_must_be_positive():
    for sizes in ((-1, (3,)), (2, (0,))):
        with pytest.raises(ValueError, match="must not be negative"):
            network_of(*sizes)
