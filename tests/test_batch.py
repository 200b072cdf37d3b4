"""The batch runner gives every run its own, and counts none twice."""

import contextlib

import cheap
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.campaign import batch, monte_carlo
from jentry.campaign.batch import LANES, filled_up, in_blocks, over_runs, sum_over_runs


pytestmark = pytest.mark.batches


def scaled(shared, run):
    factor, word = shared
    assert word == "a part of the program"
    return {"one": factor * run["x"], "index": run["i"]}


def of_batch(factor, runs, counts):
    assert runs["x"].shape == counts.shape == (LANES,)
    return jnp.sum(jnp.where(counts, factor * runs["x"], 0.0)), jnp.sum(counts)


def given(count):
    return {"x": np.linspace(1.0, 2.0, count) ** 3, "i": np.arange(count)}


@pytest.mark.parametrize("count", [1, LANES, LANES + 5])
def test_every_run_has_its_own_and_the_fill_is_taken_off(count):
    runs, shared = given(count), (jnp.asarray(3.0), "a part of the program")
    found = over_runs(scaled, shared, runs)
    np.testing.assert_array_equal(found["one"], 3.0 * runs["x"])
    np.testing.assert_array_equal(found["index"], np.arange(count))
    alone = over_runs(scaled, shared, runs, one_device=True)
    assert jax.tree.all(jax.tree.map(np.array_equal, found, alone))


@pytest.mark.parametrize("count", [1, LANES, LANES + 5])
def test_a_sum_is_without_the_fill(count):
    runs = given(count)
    total, counted = sum_over_runs(of_batch, jnp.asarray(3.0), runs)
    assert int(counted) == count
    # Sums of numbers of order one.
    assert float(total) == pytest.approx(3.0 * np.sum(runs["x"]), rel=1e-13)


@pytest.mark.parametrize("most", [1, 2, 8])
@pytest.mark.parametrize("devices", [1, 2, 3])
@pytest.mark.parametrize("count", [1, LANES, LANES + 1, 16 * LANES, 50 * LANES + 7])
def test_every_batch_flies_once_on_one_of_the_devices(count, devices, most):
    """Behind the batches that a device is told to fly there is room, and no flight."""
    calls = []
    most = 1 if count <= LANES else most

    def program(function, shared, room, each, number):
        assert (function, shared, number) == (len, "shared", devices)
        assert room["x"].shape == room["i"].shape == (devices * most, LANES)
        values = np.full((devices * most, LANES), -1)
        for device in range(devices):
            own = slice(device * most, device * most + int(each))
            values[own] = room["i"][own]
        calls.append(int(each))
        return {"i": values}

    called = batch._called
    found = called(program, len, "shared", given(count), devices, most)["i"]
    batches = -(-count // LANES)
    assert found.shape == (batches, LANES)
    np.testing.assert_array_equal(found.ravel()[:count], np.arange(count))
    assert np.all(found.ravel()[count:] == count - 1)
    assert all(0 < each <= most for each in calls)
    # The devices have as many as each other; no call is made for what another has room for.
    assert sum(calls) - batches / devices < 1 and len(calls) == -(
        -batches // (devices * most)
    )


def test_another_number_of_runs_is_the_same_program():
    traced = []

    def noted(shared, run):
        traced.append(run["x"].shape)
        return shared * run["x"]

    def noted_sum(shared, runs, counts):
        traced.append(counts.shape)
        return jnp.sum(jnp.where(counts, shared * runs["x"], 0.0))

    many = 9 * LANES * len(jax.devices()) + 1
    for count in (3, LANES, many, LANES + 1):
        runs = given(count)
        for large in (False, True):
            found = over_runs(noted, jnp.asarray(2.0), runs, large=large)
            np.testing.assert_array_equal(found, 2.0 * runs["x"])
        total = sum_over_runs(noted_sum, jnp.asarray(2.0), runs)
        # Sums of numbers of order one.
        assert float(total) == pytest.approx(2.0 * np.sum(runs["x"]), rel=1e-13)
    # One of a single batch, also where there is no room for more, and one of many.
    assert traced == 2 * [(), (LANES,)]


def test_blocks_are_all_of_the_runs_in_order(monkeypatch):
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    monkeypatch.setattr(batch, "_BLOCKS", 1)
    runs = np.arange(7, 7 + 3 * LANES * len(jax.devices()) + 1)
    blocks = list(in_blocks(runs))
    assert [len(b) for b in blocks][-1] == 1 and len(blocks) == 4
    np.testing.assert_array_equal(np.concatenate(blocks), runs)
    filled = filled_up(runs[-3:])
    assert len(filled) == LANES * len(jax.devices())
    assert set(filled) == set(runs[-3:])


class Backwards(batch.AbstractMachines):
    """Machines in this process that give the last part first."""

    def __init__(self, count, cores):
        self._count, self._cores = count, cores
        self.parts = []

    @property
    def count(self):
        return self._count

    @property
    def cores(self):
        return self._cores

    def each(self, work, shared, parts):
        for place, part in reversed(list(enumerate(parts))):
            self.parts.append(part)
            yield place, work(shared, part)


@pytest.mark.optimized
@pytest.mark.parametrize("count", [1, LANES, 5 * LANES + 5])
@pytest.mark.parametrize("machines", [1, 3])
def test_other_machines_give_the_same_bits(monkeypatch, count, machines):
    """In parts of one size, one for each machine or as many, in whatever order."""
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    monkeypatch.setattr(batch, "_BLOCKS", 1)
    runs, shared = given(count), (jnp.asarray(3.0), "a part of the program")
    here = over_runs(scaled, shared, runs), sum_over_runs(of_batch, jnp.pi, runs)
    others = Backwards(machines, 2)
    with batch.flying_on(others):
        there = over_runs(scaled, shared, runs), sum_over_runs(of_batch, jnp.pi, runs)
        with pytest.raises(RuntimeError, match="one cluster flies already"):
            with batch.flying_on(others):
                pass
    assert jax.tree.all(jax.tree.map(np.array_equal, here, there))
    batches = -(-count // LANES)
    assert len(others.parts) == 2 * min(batches, 3)
    sizes = {len(part["i"]) for part in others.parts[: len(others.parts) // 2]}
    assert len(sizes) == 1 and sizes.pop() <= 2 * LANES
    counted = [so_many for _, so_many in others.parts[len(others.parts) // 2 :]]
    assert sum(counted) == count
    before = len(others.parts)
    over_runs(scaled, shared, runs)
    assert len(others.parts) == before  # it flies here again


def test_a_sum_is_added_up_in_the_order_of_the_runs(monkeypatch):
    """Numbers so far apart that any other order would round otherwise."""
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    monkeypatch.setattr(batch, "_BLOCKS", 1)
    x = np.repeat([1.0, 1e16, 1.0, -1e16, 1.0], LANES) / LANES
    runs = {"x": x, "i": np.arange(len(x))}
    expected = 0.0
    for of_one in (1.0, 1e16, 1.0, -1e16, 1.0):
        expected += of_one
    clusters = [batch.flying_on(Backwards(*of)) for of in ((1, 1), (2, 1), (3, 2))]
    for flying in (contextlib.nullcontext(), *clusters):
        with flying:
            total, counted = sum_over_runs(of_batch, jnp.asarray(1.0), runs)
        assert float(total) == expected == 1.0
        assert int(counted) == len(x)


def test_blocks_from_other_machines_come_with_their_names(monkeypatch):
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    monkeypatch.setattr(batch, "_BLOCKS", 1)
    names = ["first", "second", "third"]
    blocks = [
        (name, given(count)) for name, count in zip(names, (3, 70, 5), strict=True)
    ]
    shared = (jnp.asarray(3.0), "a part of the program")
    here = list(batch.over_blocks(scaled, shared, blocks))
    with batch.flying_on(Backwards(2, 3)):
        there = list(batch.over_blocks(scaled, shared, blocks))
        sizes = [len(block) for block in in_blocks(np.arange(7 * LANES))]
    assert [name for name, _ in here] == names
    assert [name for name, _ in there] == names[::-1]
    assert jax.tree.all(jax.tree.map(np.array_equal, here, there[::-1]))
    assert sizes == [3 * LANES, 3 * LANES, LANES]


@pytest.mark.optimized
def test_a_campaign_whose_blocks_come_in_any_order(monkeypatch, key):
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    monkeypatch.setattr(batch, "_BLOCKS", 1)
    fly = lambda: monte_carlo(
        cheap.scenario(), cheap.dispersions(), key, 2 * LANES + 3, solver=cheap.SOLVER
    )
    here = fly()
    with batch.flying_on(Backwards(2, 1)):
        there = fly()
    assert jax.tree.all(jax.tree.map(np.array_equal, here, there))
