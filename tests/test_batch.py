"""The batch runner gives every run its own, and counts none twice."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jentry.campaign import batch
from jentry.campaign.batch import LANES, filled_up, in_blocks, over_runs, sum_over_runs


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


def test_blocks_are_all_of_the_runs_in_order(monkeypatch):
    monkeypatch.setattr(batch, "_CHUNKS", 1)
    runs = np.arange(7, 7 + 3 * LANES * len(jax.devices()) + 1)
    blocks = list(in_blocks(runs))
    assert [len(b) for b in blocks][-1] == 1 and len(blocks) == 4
    np.testing.assert_array_equal(np.concatenate(blocks), runs)
    filled = filled_up(runs[-3:])
    assert len(filled) == LANES * len(jax.devices())
    assert set(filled) == set(runs[-3:])
