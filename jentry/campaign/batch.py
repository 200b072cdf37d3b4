"""The batch runner: flights side by side, a cache-full at a time, on all devices.

Everything that flies many runs goes through `over_runs`, which gives what each of them
gives, `over_blocks`, which gives it block by block, or `sum_over_runs`, which adds it up.
Runs are filled up to whole batches on the way in, and the fill is taken off on the way
out. Within `flying_on(machines)` other processes do all of it, see `cluster`.
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

from .._programs import kept


LANES = 64
"""Number of flights side by side: few enough to stay in the cache, and always as many,
so that a run does not depend on how many it is flown with. A law of your own may depend
by rounding on its place among them: the compiler may treat the last eight otherwise
than the others, where a flight reads several numbers out of one array of its own."""

_CHUNKS = 8
"""Batches of each core between two reports to the host: so many has a program room for."""

_CHUNKS_OF_HISTORIES = 1
"""Room of a program where each run gives much: no memory is taken for what does not fly"""

_BLOCKS = 4
"""Of a part that another machine flies: to store it takes as long, however large it is."""

Block = TypeVar("Block")


class AbstractMachines(abc.ABC):
    """Other processes that fly in place of this one, within `flying_on(machines)`."""

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """How many there are."""

    @property
    @abc.abstractmethod
    def cores(self) -> int:
        """Cores that one of them flies on."""

    @abc.abstractmethod
    def each(
        self, work: Callable[[Any, Any], Any], shared: PyTree, parts: Iterable[PyTree]
    ) -> Iterator[tuple[int, Any]]:
        """Place and value of `work(shared, part)` for each part, as they come."""


_MACHINES: contextvars.ContextVar[AbstractMachines | None]
_MACHINES = contextvars.ContextVar("_MACHINES", default=None)


@contextlib.contextmanager
def flying_on(machines: AbstractMachines) -> Iterator[None]:
    """Have other processes do the work of the batch runner."""
    if _MACHINES.get() is not None:
        raise RuntimeError("one cluster flies already: leave it before another begins")
    token = _MACHINES.set(machines)
    try:
        yield
    finally:
        _MACHINES.reset(token)


def in_blocks(runs: np.ndarray) -> Iterator[np.ndarray]:
    """Indices of runs in parts of constant memory, after each of which the host reports."""
    machines = _MACHINES.get()
    if machines is None:
        most = LANES * _CHUNKS * len(jax.devices())
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
    """Values of `function(shared, run)` for all runs, as numpy arrays, the runs in front.

    **Arguments:**

    - `function`: compiled once for each function; define it once, at module level.
    - `shared`: a pytree that is the same for all runs. What is no array is part of the
      compiled program.
    - `runs`: a pytree of arrays of shape (runs, ...).
    - `one_device`: for a function that cannot be compiled for several.
    - `large`: whether each run gives much, as a history: fewer of them fly in one call.
    """
    machines = _MACHINES.get()
    given = function, shared, one_device, large
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
    """Values of `over_runs` for each block of runs, with what the block is called.

    They come in the order of the blocks; from other machines as they are done.
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
    """Sum of `function(shared, runs, counts)` over the batches of which the runs are made.

    It is added up batch by batch in their order: the same on any number of devices, and
    of machines.

    **Arguments:**

    - `function`: takes runs of shape (`LANES`, ...) and which of them count, bools of shape
      (`LANES`,): the others are fill, and must add nothing. Define it once, at module
      level.
    - `shared`, `runs`: as for `over_runs`.
    """
    machines = _MACHINES.get()
    given = function, shared
    if machines is None:
        values = iter([_fly_batches(given, (runs, _count(runs)))])
    else:
        parts = _parts(machines, runs)
        values = _in_order(machines.each(_fly_batches, given, parts))
    batches = (batch for value in values for batch in _apart(value))
    total = functools.reduce(lambda *both: jax.tree.map(np.add, *both), batches)
    return jax.tree.map(jnp.asarray, total)


def _parts(machines: AbstractMachines, runs: PyTree) -> Iterator[tuple[PyTree, int]]:
    """Runs in parts of one size, and how many of each count: as many for each machine,
    and none of more than a block."""
    count, cores = machines.count, machines.cores
    batches = -(-_count(runs) // LANES)
    rounds = -(-batches // (count * _CHUNKS * _BLOCKS * cores))
    size = LANES * -(-batches // (count * rounds))
    runs = jax.tree.map(np.asarray, runs)
    for begin in range(0, _count(runs), size):
        yield _around(runs, begin, size), min(size, _count(runs) - begin)


def _in_order(values: Iterable[tuple[int, Any]]) -> Iterator[Any]:
    """Values in the order of their places, each as soon as it may be."""
    waiting: dict[int, Any] = {}
    place = 0
    for own, value in values:
        waiting[own] = value
        while place in waiting:
            yield waiting.pop(place)
            place += 1


def _apart(values: PyTree) -> Iterator[PyTree]:
    """Batch by batch what several of them give."""
    for i in range(_count(values)):
        yield jax.tree.map(operator.itemgetter(i), values)


def _fly(given: tuple[Callable, PyTree, bool, bool], runs: PyTree) -> Any:
    """Here, as `over_runs` says."""
    function, shared, one_device, large = given
    devices = 1 if one_device else len(jax.devices())
    most = _CHUNKS_OF_HISTORIES if large else _CHUNKS
    flown = _called(_mapped, function, shared, runs, devices, most)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[: _count(runs)], flown)


def _fly_batches(given: tuple[Callable, PyTree], part: tuple[PyTree, int]) -> Any:
    """Here, what each batch gives, of runs of which the first so many count."""
    runs, counted = part
    size = _up(counted, LANES)
    batches = _around(runs, 0, size), np.arange(size) < counted
    return _called(_batches, *given, batches, len(jax.devices()), _CHUNKS)


def _called(
    program: Callable,
    function: Callable,
    shared: PyTree,
    runs: PyTree,
    devices: int,
    most: int,
) -> Any:
    """What a program gives of each batch of the runs, in their order.

    It is compiled for each number of devices: there is room on each for the largest number
    of batches, and how many there are it is told. A single batch has a program without the
    loop over them, which is sooner compiled (of `sx-2` in 15 s, not 21).
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
    """Indices of runs, and the first ones again until they are whole blocks."""
    size = LANES * _CHUNKS * len(jax.devices())
    return _around(runs, 0, _up(len(runs), size))


def _count(runs: PyTree) -> int:
    return len(jax.tree.leaves(runs)[0])


def _up(count: int, multiple: int) -> int:
    """The next multiple that is no less."""
    return -(-count // multiple) * multiple


def _around(runs: PyTree, begin: int, size: int) -> PyTree:
    """So many runs from a place on, the first ones again behind the last.

    What fills a batch up are other flights of the campaign, so that those at its end are
    not beside themselves alone. On other machines they are the same.
    """
    return _at(np.arange(begin, begin + size) % _count(runs), runs)


@kept
def _mapped(function, shared, runs, count, devices: int):
    def on_batch(shared, runs):
        return jax.vmap(lambda run: function(shared, run))(runs)

    return _on_devices(on_batch, shared, runs, count, devices)


@kept
def _batches(function, shared, runs, count, devices: int):
    def on_batch(shared, runs):
        return function(shared, *runs)

    return _on_devices(on_batch, shared, runs, count, devices)


def _on_devices(function, shared, batches, count, devices: int):
    """`function(shared, batch)` of the first so many batches of each device, in parallel.

    What it returns is put together along the first axis, with room for all batches.
    """
    numbers, structure = eqx.partition(shared, eqx.is_array)

    @jax.jit  # traced once, for its shapes and in the loop
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
    mesh = jax.make_mesh((devices,), ("flights",), axis_types=(AxisType.Auto,))
    split = PartitionSpec("flights")
    on_all = jax.shard_map(
        on_one_device,
        mesh=mesh,
        in_specs=(PartitionSpec(), split, PartitionSpec()),
        out_specs=split,
        check_vma=False,
    )
    return on_all(numbers, batches, count)
