"""Flights side by side: how many at a time, filled up to as many, on all devices."""

from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax import lax
from jax.sharding import AxisType, PartitionSpec


LANES = 64
"""Flights side by side: few enough to stay in the cache, and always as many, so that a
run does not depend on how many it is flown with. A law of your own may depend by rounding
on its place among them: the compiler may treat the last eight otherwise than the others,
where a flight reads several numbers out of one array of its own."""

_CHUNKS = 8
"""Of lanes, for each core, between two reports to the host."""


def in_blocks(
    indices: np.ndarray, devices: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The runs of each block, and what is flown for them: as many, filled up."""
    most = LANES * _CHUNKS * devices
    for begin in range(0, len(indices), most):
        runs = indices[begin : begin + most]
        yield runs, filled_up(runs, devices)


def over_runs(
    function: Callable[[Any, Any], Any], shared: Any, runs: Any, devices: int
) -> Any:
    """`function(shared, run)` for every run, a cache-full at a time, on all devices.

    **Arguments:**

    - `shared`: a pytree that is the same for all runs.
    - `runs`: a pytree of arrays with the runs in front, a multiple of `LANES * devices`.
    """

    def on_one_device(shared, runs):
        return lax.map(lambda run: function(shared, run), runs, batch_size=LANES)

    return on_devices(on_one_device, shared, runs, devices)


def on_devices(
    function: Callable[[Any, Any], Any], shared: Any, runs: Any, devices: int
) -> Any:
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


def filled_up(runs: np.ndarray, devices: int) -> np.ndarray:
    """Runs up to a multiple of what is flown side by side; the last one again fills."""
    padded = -len(runs) % (LANES * devices)
    return np.concatenate([runs, np.repeat(runs[-1:], padded)])
