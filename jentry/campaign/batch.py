"""The batch runner: flights side by side, a cache-full at a time, on all devices.

Everything that flies many runs goes through `over_runs`, which gives what each of them
gives, or `sum_over_runs`, which adds it up. Runs are filled up to whole batches on the
way in, and the fill is taken off on the way out.
"""

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import AxisType, PartitionSpec
from jaxtyping import PyTree

from .._programs import kept


LANES = 64
"""Number of flights side by side: few enough to stay in the cache, and always as many,
so that a run does not depend on how many it is flown with. A law of your own may depend
by rounding on its place among them: the compiler may treat the last eight otherwise
than the others, where a flight reads several numbers out of one array of its own."""

_CHUNKS = 8
"""Of lanes, for each core, between two reports to the host."""


def in_blocks(runs: np.ndarray) -> Iterator[np.ndarray]:
    """Indices of runs in parts of constant memory, after each of which the host reports."""
    most = LANES * _CHUNKS * len(jax.devices())
    for begin in range(0, len(runs), most):
        yield runs[begin : begin + most]


def over_runs(
    function: Callable[[Any, Any], Any],
    shared: PyTree,
    runs: PyTree,
    *,
    one_device: bool = False,
) -> Any:
    """Values of `function(shared, run)` for all runs, as numpy arrays, the runs in front.

    **Arguments:**

    - `function`: compiled once for each function; define it once, at module level.
    - `shared`: a pytree that is the same for all runs. What is no array is part of the
      compiled program.
    - `runs`: a pytree of arrays of shape (runs, ...).
    - `one_device`: for a function that cannot be compiled for several.
    """
    devices = 1 if one_device else len(jax.devices())
    count = _count(runs)
    flown = _mapped(function, shared, _filled_up(runs, devices), devices)
    return jax.tree.map(lambda x: np.asarray(x)[:count], flown)


def sum_over_runs(
    function: Callable[[Any, Any, Any], Any], shared: PyTree, runs: PyTree
) -> Any:
    """Sum of `function(shared, runs, counts)` over the batches of which the runs are made.

    **Arguments:**

    - `function`: takes runs of shape (`LANES`, ...) and which of them count, bools of shape
      (`LANES`,): the others are fill, and must add nothing. Define it once, at module
      level.
    - `shared`, `runs`: as for `over_runs`.
    """
    devices = len(jax.devices())
    filled = _filled_up(runs, devices)
    counts = jnp.arange(_count(filled)) < _count(runs)
    return _summed(function, shared, (filled, counts), devices)


def filled_up(runs: np.ndarray) -> np.ndarray:
    """Indices of runs, filled up to whole batches with the last one."""
    return np.asarray(_filled_up(runs, len(jax.devices())))


def _count(runs: PyTree) -> int:
    return len(jax.tree.leaves(runs)[0])


def _filled_up(runs: PyTree, devices: int) -> PyTree:
    padded = -_count(runs) % (LANES * devices)

    def filled(values):
        values = np.asarray(values)
        return jnp.asarray(np.concatenate([values, np.repeat(values[-1:], padded, 0)]))

    return jax.tree.map(filled, runs)


@kept
def _mapped(function, shared, runs, devices: int):
    def on_one_device(shared, runs):
        return lax.map(lambda run: function(shared, run), runs, batch_size=LANES)

    return _on_devices(on_one_device, shared, runs, devices)


@kept
def _summed(function, shared, runs, devices: int):
    def on_one_device(shared, runs):
        batches = jax.tree.map(lambda x: x.reshape(-1, LANES, *x.shape[1:]), runs)

        def add(total, batch):
            return jax.tree.map(jnp.add, total, function(shared, *batch)), None

        first = jax.tree.map(lambda x: x[0], batches)
        shapes = jax.eval_shape(lambda: function(shared, *first))
        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        total, _ = lax.scan(add, nothing, batches)
        return jax.tree.map(lambda x: x[None], total)

    parts = _on_devices(on_one_device, shared, runs, devices)
    return jax.tree.map(lambda x: jnp.sum(x, axis=0), parts)


def _on_devices(function, shared, runs, devices: int):
    """`function(shared, runs)` on each device with its part of the runs, in parallel.

    What it returns is put together along the first axis.
    """
    numbers, structure = eqx.partition(shared, eqx.is_array)

    def on_one_device(numbers, runs):
        return function(eqx.combine(numbers, structure), runs)

    if devices == 1:
        return on_one_device(numbers, runs)
    mesh = jax.make_mesh((devices,), ("flights",), axis_types=(AxisType.Auto,))
    split = PartitionSpec("flights")
    on_all = jax.shard_map(
        on_one_device,
        mesh=mesh,
        in_specs=(PartitionSpec(), split),
        out_specs=split,
        check_vma=False,
    )
    return on_all(numbers, runs)
