"""The batch runner: flies many runs side by side, in small batches, on all cores.

All code that flies many runs calls one of three functions. `over_runs` returns the values
of all runs, `over_blocks` returns them block by block, and `sum_over_runs` adds them up.
Each fills the runs up to whole batches and removes the fill from the results. Within
`flying_on(machines)` other processes fly instead, see `cluster`. On a GPU the batches are
large, see `on_gpu`.
"""

import abc
import contextlib
import contextvars
import functools
import operator
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import AxisType, PartitionSpec
from jaxtyping import PyTree

from .. import _devices
from .._devices import Kind, cores, kind_for
from .._programs import cached
from . import on_gpu


LANES = 64
"""Number of flights side by side. They are few enough to stay in the processor's cache. The
number is fixed, so that a run does not depend on how many others are flown. The result of a
law of your own may depend by rounding on the place of the run in its batch: where a flight
indexes one of its own arrays several times, the compiler may treat the last eight flights
differently."""

_CHUNKS = 8
"""Batches of each core in one call of a program, which reports to the host at its end"""

_CHUNKS_OF_HISTORIES = 1
"""Batches of each core in one call if the results of a run are large, which saves memory"""

_BLOCKS = 4
"""Calls of a program in a part that another machine flies. The time to store a part hardly
depends on its size."""

Block = TypeVar("Block")


class AbstractMachines(abc.ABC):
    """Other processes that fly instead of this one, within `flying_on(machines)`."""

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Number of machines."""

    @property
    @abc.abstractmethod
    def cores(self) -> int:
        """Number of cores of one machine."""

    @abc.abstractmethod
    def each(
        self, work: Callable[[Any, Any], Any], shared: PyTree, parts: Iterable[PyTree]
    ) -> Iterator[tuple[int, Any]]:
        """Index of each part and its `work(shared, part)`, in the order of completion."""


_MACHINES: contextvars.ContextVar[AbstractMachines | None]
_MACHINES = contextvars.ContextVar("_MACHINES", default=None)


@contextlib.contextmanager
def flying_on(machines: AbstractMachines) -> Iterator[None]:
    """Context in which other processes do the work of the batch runner."""
    if _MACHINES.get() is not None:
        raise RuntimeError("one cluster flies already: leave it before another begins")
    token = _MACHINES.set(machines)
    try:
        yield
    finally:
        _MACHINES.reset(token)


def device_of(runs: int) -> Kind:
    """The device that flies a number of runs. Other machines fly on their processors."""
    return "cpu" if _MACHINES.get() is not None else kind_for(runs)


def in_blocks(runs: np.ndarray, device: Kind = "cpu") -> Iterator[np.ndarray]:
    """Indices of runs in blocks of constant memory. The host reports after each block."""
    machines = _MACHINES.get()
    if device == "gpu":
        most = on_gpu.BLOCK
    elif machines is None:
        most = LANES * _CHUNKS * len(cores())
    else:
        most = LANES * _CHUNKS * _BLOCKS * machines.cores
    for begin in range(0, len(runs), most):
        yield runs[begin : begin + most]


def over_runs(
    function: Callable[[Any, Any], Any],
    shared: PyTree,
    runs: PyTree,
    *,
    one_device: bool = False,
    large: bool = False,
) -> Any:
    """Values of `function(shared, run)` for all runs, as numpy arrays of shape (runs, ...).

    **Arguments:**

    - `function`: each function object is compiled once. Define it at module level.
    - `shared`: a pytree that all runs have in common. Leaves that are not arrays are part
      of the compiled program.
    - `runs`: a pytree of arrays of shape (runs, ...).
    - `one_device`: use one device, for a function that cannot be compiled for several.
    - `large`: whether the result of a run is large, such as a history. Then fewer runs fly
      in one call.
    """
    machines = _MACHINES.get()
    given = function, shared, one_device, large
    if not (one_device or large) and device_of(_count(runs)) == "gpu":
        return on_gpu.by_xla(_gpu(), function, shared, runs)
    if machines is None:
        return _fly(given, runs)
    parts = (part for part, _ in _parts(machines, runs))
    flown = list(_in_order(machines.each(_fly, given, parts)))
    return jax.tree.map(lambda *x: np.concatenate(x)[: _count(runs)], *flown)


def over_blocks(
    function: Callable[[Any, Any], Any],
    shared: PyTree,
    blocks: Iterable[tuple[Block, PyTree]],
    *,
    large: bool = False,
) -> Iterator[tuple[Block, Any]]:
    """The label of each block of runs, with its values as `over_runs` returns them.

    The blocks come in their order, or from other machines in the order of completion.
    """
    machines = _MACHINES.get()
    given = function, shared, False, large
    if machines is None:
        for block, runs in blocks:
            yield block, _fly(given, runs)
        return
    called: dict[int, Block] = {}

    def parts() -> Iterator[PyTree]:
        for place, (block, runs) in enumerate(blocks):
            called[place] = block
            yield runs

    for place, flown in machines.each(_fly, given, parts()):
        yield called.pop(place), flown


def sum_over_runs(
    function: Callable[[Any, Any, Any], Any], shared: PyTree, runs: PyTree
) -> Any:
    """Sum of `function(shared, runs, counts)` over all batches of the runs.

    The batches are added in their order, so the sum does not depend on the number of
    devices or machines.

    **Arguments:**

    - `function`: takes the runs of a batch, of shape (n, ...), and bools of shape (n,) that
      are true for the runs that count. The other runs are fill and must add nothing. Define
      it at module level. n is `LANES`, and larger on a GPU.
    - `shared`, `runs`: as for `over_runs`.
    """
    machines = _MACHINES.get()
    given = function, shared
    if device_of(_count(runs)) == "gpu":
        return on_gpu.sum_by_xla(_gpu(), function, shared, runs)
    if machines is None:
        values = iter([_fly_batches(given, (runs, _count(runs)))])
    else:
        parts = _parts(machines, runs)
        values = _in_order(machines.each(_fly_batches, given, parts))
    batches = (batch for value in values for batch in _apart(value))
    total = functools.reduce(lambda *both: jax.tree.map(np.add, *both), batches)
    return jax.tree.map(jnp.asarray, total)


def flier(
    function: Callable[[Any, Any], Any], shared: PyTree, large: bool = False
) -> on_gpu.Flier:
    """What flies the runs of a campaign on the GPU."""
    return on_gpu.Flier(_gpu(), function, shared, large)


def _gpu() -> _devices.Gpu:
    found = _devices.gpu()
    assert found is not None  # by `kind_for`
    return found


def _parts(machines: AbstractMachines, runs: PyTree) -> Iterator[tuple[PyTree, int]]:
    """Parts of the runs, and how many runs of each part count.

    All parts have one size, each machine has the same number of them, and no part is larger
    than a block.
    """
    count, cores = machines.count, machines.cores
    batches = -(-_count(runs) // LANES)
    rounds = -(-batches // (count * _CHUNKS * _BLOCKS * cores))
    size = LANES * -(-batches // (count * rounds))
    runs = jax.tree.map(np.asarray, runs)
    for begin in range(0, _count(runs), size):
        yield _around(runs, begin, size), min(size, _count(runs) - begin)


def _in_order(values: Iterable[tuple[int, Any]]) -> Iterator[Any]:
    """Values in the order of their indices, each as soon as all earlier ones are there."""
    waiting: dict[int, Any] = {}
    place = 0
    for own, value in values:
        waiting[own] = value
        while place in waiting:
            yield waiting.pop(place)
            place += 1


def _apart(values: PyTree) -> Iterator[PyTree]:
    """The values of each batch, from the stacked values of several batches."""
    for i in range(_count(values)):
        yield jax.tree.map(operator.itemgetter(i), values)


def _fly(given: tuple[Callable, PyTree, bool, bool], runs: PyTree) -> Any:
    """Values of `over_runs`, computed by this process."""
    function, shared, one_device, large = given
    devices = 1 if one_device else len(cores())
    most = _CHUNKS_OF_HISTORIES if large else _CHUNKS
    flown = _called(_mapped, function, shared, runs, devices, most)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[: _count(runs)], flown)


def _fly_batches(given: tuple[Callable, PyTree], part: tuple[PyTree, int]) -> Any:
    """Values of all batches, computed by this process.

    The part consists of its runs and of how many of them count, from the first.
    """
    runs, counted = part
    size = _up(counted, LANES)
    batches = _around(runs, 0, size), np.arange(size) < counted
    return _called(_batches, *given, batches, len(cores()), _CHUNKS)


def _called(
    program: Callable,
    function: Callable,
    shared: PyTree,
    runs: PyTree,
    devices: int,
    most: int,
) -> Any:
    """Values of a program for each batch of the runs, in their order.

    The program is compiled once for each number of devices. It has room for the largest
    number of batches on each device, and the actual number is an argument. A single batch
    has a program without the loop over batches, which compiles faster (15 s instead of 21 s
    for `sx-2`).
    """
    count = _count(runs)
    if count <= LANES:
        most = 1
    device, own = np.divmod(np.arange(devices * most), most)
    flown = []
    for begin in range(0, count, LANES * devices * most):
        batches = min(_up(count - begin, LANES) // LANES, devices * most)
        each = -(-batches // devices)
        lane = LANES * (device * each + own)[:, None] + np.arange(LANES)
        room = _at(np.minimum(begin + lane, count - 1), runs)
        room = jax.tree.map(jnp.asarray, room)
        values = program(function, shared, room, jnp.asarray(each), devices)
        flown.append(_at(np.flatnonzero(own < each)[:batches], values))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *flown)


def _at(places: np.ndarray, runs: PyTree) -> PyTree:
    return jax.tree.map(lambda x: np.asarray(x)[places], runs)


def filled_up(runs: np.ndarray) -> np.ndarray:
    """Indices of runs, followed by the first of them again up to whole blocks."""
    size = LANES * _CHUNKS * len(cores())
    return _around(runs, 0, _up(len(runs), size))


def _count(runs: PyTree) -> int:
    return len(jax.tree.leaves(runs)[0])


def _up(count: int, multiple: int) -> int:
    """The smallest multiple that is not less than the count."""
    return -(-count // multiple) * multiple


def _around(runs: PyTree, begin: int, size: int) -> PyTree:
    """A number of runs from an index on, with the first ones again after the last.

    A batch is filled up with other flights of the campaign, and not with copies of its last
    flight. The fill is the same on all machines.
    """
    return _at(np.arange(begin, begin + size) % _count(runs), runs)


@cached
def _mapped(function, shared, runs, count, devices: int):
    def on_batch(shared, runs):
        return jax.vmap(lambda run: function(shared, run))(runs)

    return _on_devices(on_batch, shared, runs, count, devices)


@cached
def _batches(function, shared, runs, count, devices: int):
    def on_batch(shared, runs):
        return function(shared, *runs)

    return _on_devices(on_batch, shared, runs, count, devices)


def _on_devices(function, shared, batches, count, devices: int):
    """`function(shared, batch)` for the first `count` batches of each device, in parallel.

    The results are stacked along the first axis, with room for all batches.
    """
    numbers, structure = eqx.partition(shared, eqx.is_array)

    @jax.jit  # so that it is traced once, for its shapes and in the loop
    def on_batch(numbers, batch):
        return function(eqx.combine(numbers, structure), batch)

    def on_one_device(numbers, batches, count):
        def take(index):
            at = functools.partial(
                lax.dynamic_index_in_dim, index=index, keepdims=False
            )
            return jax.tree.map(at, batches)

        def body(index, values):
            put = lambda s, x: lax.dynamic_update_index_in_dim(s, x, index, 0)
            return jax.tree.map(put, values, on_batch(numbers, take(index)))

        room = _count(batches)
        if room == 1:
            return jax.tree.map(lambda x: x[None], on_batch(numbers, take(0)))
        shapes = jax.eval_shape(on_batch, numbers, take(0))
        values = jax.tree.map(lambda s: jnp.zeros((room, *s.shape), s.dtype), shapes)
        return lax.fori_loop(0, count, body, values)

    if devices == 1:
        return on_one_device(numbers, batches, count)
    mesh = jax.make_mesh(
        (devices,),
        ("flights",),
        axis_types=(AxisType.Auto,),
        devices=cores()[:devices],
    )
    split = PartitionSpec("flights")
    on_all = jax.shard_map(
        on_one_device,
        mesh=mesh,
        in_specs=(PartitionSpec(), split, PartitionSpec()),
        out_specs=split,
        check_vma=False,
    )
    return on_all(numbers, batches, count)
