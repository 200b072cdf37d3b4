"""What a tuning run stores comes back to the last bit, or is refused."""

import gc
import json
import pickle
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jentry.tuning.record import CourseFile, Entry, restored


RNG = np.random.default_rng(20261121)

DESCRIPTION = {
    "seed": [0, 7],
    "runs": 256,
    "history_interval": None,
    "scenario": {"vehicle.mass": {"value": 0.1 + 0.2, "unit": "kg"}},
    "parameters": {"guidance.gains.a": "Positive"},
}

SCALAR, TABLE = "guidance.gains.a", "guidance.cos_bank.coefficients"


def entry(loss, **changes):
    free = {SCALAR: jnp.asarray(RNG.normal()), TABLE: jnp.asarray(RNG.normal(size=3))}
    given = dict(
        loss=loss,
        gradient_norm=RNG.uniform() * 1e-300,
        failed=3,
        gradients_failed=2,
        flights=2**53 - 1,
        seconds=RNG.uniform() * 1e5,
        values={SCALAR: RNG.normal(size=()), TABLE: RNG.normal(size=3) * 1e17},
        free=free,
        gradient_shares={SCALAR: 1.0, TABLE: 0.1 + 0.2},
    )
    return Entry(**(given | changes))


def write_record(path, description, history, following, state, converged=False):
    CourseFile(path, description).write(history, following, state, converged)


def read_record(path, description):
    history, following, state, _ = CourseFile(path, description).read()
    return history, following, state


def following():
    return {SCALAR: jnp.asarray(1.0 / 3.0), TABLE: jnp.asarray([-0.0, 5e-324, 1e308])}


def state(optimizer=None):
    """Of an optimizer after one step."""
    optimizer = optax.adam(0.1) if optimizer is None else optimizer
    free = following()
    gradient = jax.tree.map(lambda x: 0.1 * jnp.ones_like(x), free)
    _, state = optimizer.update(gradient, optimizer.init(free), free)
    return state


def same(first, second):
    """To the last bit, with all types and names."""
    leaves = [jax.tree.leaves(tree) for tree in (first, second)]
    return jax.tree.structure(first) == jax.tree.structure(second) and all(
        np.asarray(a).dtype == np.asarray(b).dtype
        and np.shape(a) == np.shape(b)
        and np.asarray(a).tobytes() == np.asarray(b).tobytes()
        for a, b in zip(*leaves, strict=True)
    )


def fields(entry):
    return dict(vars(entry))


@pytest.fixture
def record(tmp_path):
    """A stored run of three points."""
    path = tmp_path / "runs" / "record.npz"
    history = [entry(0.1), entry(np.inf), entry(1e-300)]
    write_record(path, DESCRIPTION, history, following(), state())
    return path, history


def test_round_trip_to_the_last_bit(record):
    path, history = record
    read, next_point, leaves = read_record(path, DESCRIPTION)
    assert same([fields(e) for e in read], [fields(e) for e in history])
    assert [type(e.failed) for e in read] == [int, int, int]
    assert same(next_point, following())
    assert same(restored(state(), leaves), state())


@pytest.mark.parametrize("converged", [False, True])
def test_whether_it_has_converged_is_kept(tmp_path, converged):
    path = tmp_path / "record.npz"
    write_record(path, DESCRIPTION, [entry(0.5)], following(), state(), converged)
    assert CourseFile(path, DESCRIPTION).read()[3] is converged


def test_random_keys_of_a_state_are_stored(tmp_path):
    optimizer = optax.add_noise(0.1, 0.5, jax.random.key(3))
    path = tmp_path / "record.npz"
    after = state(optimizer)
    write_record(path, DESCRIPTION, [entry(0.5)], following(), after)
    read = restored(state(optimizer), read_record(path, DESCRIPTION)[2])
    data = [jax.random.key_data(s.rng_key) for s in (read, after)]
    np.testing.assert_array_equal(*data)


def test_a_state_without_numbers_and_a_single_point(tmp_path):
    path = tmp_path / "record.npz"
    write_record(path, DESCRIPTION, [entry(0.5)], following(), optax.EmptyState())
    read, _, leaves = read_record(path, DESCRIPTION)
    assert len(read) == 1 and leaves == []
    assert restored(optax.EmptyState(), leaves) == optax.EmptyState()


def test_a_state_of_many_leaves_keeps_their_order(tmp_path):
    path = tmp_path / "record.npz"
    many = [jnp.asarray(float(i)) for i in range(23)]  # "10" comes before "2"
    write_record(path, DESCRIPTION, [entry(0.5)], following(), many)
    assert read_record(path, DESCRIPTION)[2] == many


def test_a_point_where_no_flight_was_finite_can_be_stored(tmp_path):
    """Of which the loss is infinite, and no flight is reached."""
    path = tmp_path / "record.npz"
    history = [
        entry(0.5),
        entry(
            np.inf,
            failed=256,
            gradient_shares=dict.fromkeys(entry(0.5).gradient_shares, 0.0),
        ),
    ]
    write_record(path, DESCRIPTION, history, following(), state())
    read, _, _ = read_record(path, DESCRIPTION)
    assert [e.loss for e in read] == [0.5, np.inf]
    assert read[0].gradient_shares == history[0].gradient_shares


# What is refused.


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"runs": 257}, "runs is 256 there and 257 now"),
        ({"seed": [0, 8]}, "seed differs"),
        ({"history_interval": 1.0}, "history_interval is None there and 1.0 now"),
        (
            {"scenario": {"vehicle.mass": {"value": 0.3, "unit": "kg"}}},
            "scenario.vehicle.mass.value is 0.30000000000000004 there and 0.3 now",
        ),
        (
            {"parameters": {"guidance.gains.b": "Positive"}},
            "parameters.guidance.gains.a is given only there",
        ),
        ({"loss": "MeanSquare"}, "loss is given only now"),
    ],
)
def test_another_tuning_run_is_refused(record, change, message):
    path, _ = record
    with pytest.raises(ValueError, match=message) as raised:
        read_record(path, DESCRIPTION | change)
    assert str(path) in str(raised.value)
    assert "holds another tuning run" in str(raised.value)


def test_a_description_is_compared_as_it_is_written(record):
    """A tuple is a list in the file."""
    same = read_record(record[0], DESCRIPTION)
    history, *_ = read_record(record[0], DESCRIPTION | {"seed": (0, 7)})
    assert len(history) == len(same[0]) > 0


def truncated(record: bytes) -> bytes:
    return record[: len(record) // 2]


def changed(record: bytes) -> bytes:
    """One bit of a number, in the middle of the file's first array."""
    place = record.index(b"\x93NUMPY") + 200
    return record[:place] + bytes([record[place] ^ 1]) + record[place + 1 :]


NO_RECORDS = {
    "empty": lambda record: b"",
    "garbage": lambda record: RNG.bytes(4000),
    "text": lambda record: b"loss = 3\n",
    "beginning of an archive": lambda record: b"PK\x03\x04" + RNG.bytes(100),
    "truncated": truncated,
    "one bit changed": changed,
}


@pytest.mark.parametrize("name", NO_RECORDS)
def test_a_file_that_is_no_record_is_refused(record, name):
    path, _ = record
    path.write_bytes(NO_RECORDS[name](path.read_bytes()))
    with pytest.raises(ValueError, match="is no record of a tuning run") as raised:
        read_record(path, DESCRIPTION)
    assert str(path) in str(raised.value)
    # A file that was left open is an error here, and not in the next test.
    del raised
    gc.collect()


def test_no_flipped_bit_changes_a_record(record):
    """Of 500: it is refused, or what is read is what was written (a date, say).

    numpy alone takes the length that an array states, skips its checksum then, and an
    archive may lose an array without a word.
    """
    path, _ = record
    contents = path.read_bytes()
    before = read_record(path, DESCRIPTION)
    refused = 0
    for bit in RNG.integers(8 * len(contents), size=500):
        place = bit // 8
        byte = bytes([contents[place] ^ 1 << bit % 8])
        path.write_bytes(contents[:place] + byte + contents[place + 1 :])
        try:
            after = read_record(path, DESCRIPTION)
        except ValueError as error:
            assert "is no record of a tuning run" in str(error)
            refused += 1
        else:
            stored = [[fields(e) for e in known[0]] for known in (after, before)]
            assert same(*stored) and same(after[1:], before[1:])
    assert refused > 250


@pytest.mark.parametrize(
    "arrays",
    [{"loss": np.zeros(3)}, {"description": np.array("{]")}, {}],
    ids=["no description", "description no JSON", "nothing"],
)
def test_other_arrays_are_no_record(tmp_path, arrays):
    path = tmp_path / "record.npz"
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match="is no record of a tuning run"):
        read_record(path, DESCRIPTION)


def test_a_single_array_is_no_record(tmp_path):
    path = tmp_path / "record.npy"
    np.save(path, np.zeros(3))
    with pytest.raises(ValueError, match="is no record of a tuning run"):
        read_record(path, DESCRIPTION)


@pytest.mark.parametrize("missing", ["nowhere", "."])
def test_a_place_without_a_file_is_no_record(tmp_path, missing):
    with pytest.raises(ValueError, match="is no record of a tuning run"):
        read_record(tmp_path / missing, DESCRIPTION)


class Trap:
    """Leaves a trace if it is ever unpickled."""

    def __init__(self, trace: Path):
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


def test_the_trap_works(tmp_path):
    trace = tmp_path / "trace"
    pickle.loads(pickle.dumps(Trap(trace)))
    assert trace.exists()


@pytest.mark.parametrize("name", ["whole file", "description", "loss", "state/0"])
def test_a_pickle_is_never_loaded(record, tmp_path, name):
    path, _ = record
    trap = Trap(tmp_path / "trace")
    if name == "whole file":
        path.write_bytes(pickle.dumps(trap))
    else:
        with np.load(path) as stored:
            arrays = dict(stored) | {name: np.array([trap], dtype=object)}
        np.savez(path, **arrays)
    with pytest.raises(ValueError, match="is no record of a tuning run"):
        read_record(path, DESCRIPTION)
    assert not trap.trace.exists()


@pytest.mark.parametrize(
    "other",
    [optax.sgd(0.1), optax.sgd(0.1, momentum=0.9), optax.lbfgs(0.1)],
    ids=["no state", "less", "more"],
)
def test_the_state_of_another_optimizer_is_refused(record, other):
    path, _ = record
    _, _, leaves = read_record(path, DESCRIPTION)
    with pytest.raises(ValueError, match="written with another optimizer"):
        restored(other.init(following()), leaves)


def test_a_state_of_other_shapes_is_refused(record):
    path, _ = record
    _, _, leaves = read_record(path, DESCRIPTION)
    longer = optax.adam(0.1).init(following() | {TABLE: jnp.zeros(4)})
    with pytest.raises(ValueError, match="written with another optimizer"):
        restored(longer, leaves)


# At once or not at all.


def test_a_record_is_written_over_and_nothing_else_is_left(record):
    path, history = record
    write_record(path, DESCRIPTION, [*history, entry(0.05)], following(), state())
    assert len(read_record(path, DESCRIPTION)[0]) == 4
    assert list(path.parent.iterdir()) == [path]


def test_the_name_is_kept_whatever_its_end(tmp_path):
    path = tmp_path / "record"
    write_record(path, DESCRIPTION, [entry(0.5)], following(), state())
    assert list(tmp_path.iterdir()) == [path]
    read_record(path, DESCRIPTION)


@pytest.fixture(params=["while writing", "before writing", "at its end"])
def failing(request, monkeypatch):
    """A disk that is full, at one point or another; gives what is stored and the error."""

    def full(file, **arrays):
        file.write(b"half of it")
        raise OSError("no space left on device")

    def denied(first, second):
        raise PermissionError("denied")

    if request.param == "while writing":
        monkeypatch.setattr(np, "savez", full)
        return DESCRIPTION, OSError
    if request.param == "at its end":
        monkeypatch.setattr("os.replace", denied)
        return DESCRIPTION, PermissionError
    return DESCRIPTION | {"loss": object()}, TypeError  # of which there is no JSON


def test_a_write_that_fails_leaves_the_record_as_it_was(record, failing):
    path, history = record
    before = path.read_bytes()
    description, error = failing
    with pytest.raises(error):
        write_record(path, description, [*history, entry(0.05)], following(), state())
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_better_is_fewer_failures_and_then_less_loss():
    good, worse = entry(1.0, failed=0), entry(2.0, failed=0)
    failed = entry(0.1, failed=1)
    assert good.better_than(worse) and not worse.better_than(good)
    assert worse.better_than(failed) and not failed.better_than(worse)
    assert not good.better_than(good)
    assert worse.better_than(entry(np.inf, failed=0))
    assert not entry(np.nan, failed=0).better_than(worse)


def test_the_description_in_the_file_is_text(record):
    """Which anyone can read with numpy alone."""
    with np.load(record[0], allow_pickle=False) as stored:
        assert json.loads(str(stored["description"])) == DESCRIPTION
        assert stored["loss"].tolist() == [0.1, np.inf, 1e-300]
        assert stored[f"values/{TABLE}"].shape == (3, 3)
