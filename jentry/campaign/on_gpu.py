"""Batches of flights on a GPU: whole flights as kernels, or large batches by XLA.

A kernel flies a campaign at many times the speed of XLA. Where it does not know an
operation of a flight, or flies otherwise than XLA on the processor, XLA flies in its
place, and the campaign says so.
"""

import dataclasses
import functools
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from .. import _devices
from .._devices import Gpu
from .._trace_modes import stages_written_out
from ..kernel import NotInKernel, kernel_of


BLOCK = 131_072
"""Runs in one call, after which the host reports"""

CHECKED = 64
"""The first runs, which the processor flies as well: no kernel is trusted unseen"""

ROUNDING = 1e-6
"""Largest difference of a number that counts as rounding: as a share of the largest of its
kind, and in the unit of the number, since a miss may be a small difference of large ones"""

MOST_APART = 1.0 / 8.0
"""Share of these runs that may differ, since rounding may turn a decision of a law"""

_LEAST = 64
"""Runs in one call that a GPU must have memory for"""

Block = TypeVar("Block")


class Flier:
    """Flies the runs of a campaign on a GPU."""

    def __init__(
        self,
        gpu: Gpu,
        function: Callable[[Any, Any], Any],
        shared: PyTree,
        large: bool,
    ):
        self._gpu = gpu
        self._large = large
        self._function = function
        self._shared = shared
        self._fly: Callable[[PyTree], Any] | None = None
        self.how = ""
        """What flies, in words, after the first call"""

    def __call__(self, runs: PyTree) -> Any:
        """Values of the function for all runs, as numpy arrays."""
        if self._fly is None:
            self._fly = self._made(runs)
        return self._fly(runs)

    def over_blocks(
        self, blocks: Iterable[tuple[Block, PyTree]]
    ) -> Iterator[tuple[Block, Any]]:
        """The label of each block of runs, with its values."""
        for block, runs in blocks:
            yield block, self(runs)

    def _made(self, runs: PyTree) -> Callable[[PyTree], Any]:
        try:
            fly = self._of_kernel(runs)
            apart = self._flown_otherwise(fly, runs)
        except NotInKernel as error:
            why = f"a flight {error}"
        except Exception as error:  # the kernel was written, and not compiled
            why = f"its kernel was not compiled: {type(error).__name__} {error}"
        else:
            if apart <= MOST_APART:
                self.how = f"{self._gpu.name}, each flight in one kernel"
                return fly
            why = (
                f"{apart:.0%} of the first flights of its kernel are others than by XLA"
            )
        self.how = f"{self._gpu.name}, by XLA, since {why}"
        return functools.partial(by_xla, self._gpu, self._function, self._shared)

    def _of_kernel(self, runs: PyTree) -> Callable[[PyTree], Any]:
        if self._large:
            raise NotInKernel("has a history, which a kernel does not store")
        example = jax.tree.map(lambda x: jnp.asarray(x[0]), runs)
        kernel = _kernel(self._gpu, self._function, self._shared, example)
        return lambda runs: jax.tree.map(np.asarray, kernel(runs))

    def _flown_otherwise(self, fly: Callable[[PyTree], Any], runs: PyTree) -> float:
        """Share of the first runs that the processor, by XLA, flies otherwise."""
        first = _around(runs, 0, CHECKED)
        here = dataclasses.replace(self._gpu, device=_devices.cores()[0])
        expected = _fly(here, self._function, self._shared, first)
        return float(np.mean(differing(fly(first), expected)))


_KERNELS: OrderedDict[Any, Callable[[PyTree], PyTree]] = OrderedDict()
"""The kernels that flew last, by what they are made of"""

_MOST_KERNELS = 16
"""Largest number of them"""


def _kernel(
    gpu: Gpu, function: Callable[[Any, Any], Any], shared: PyTree, example: PyTree
) -> Callable[[PyTree], PyTree]:
    """The kernel of `function(shared, run)`, made if there is none of equal numbers."""
    key = (
        gpu,
        function,
        *_value(shared, np.ndarray.tobytes),
        *_value(example, _no_bytes),
    )
    known = _KERNELS.pop(key, None)
    if known is None:
        one = functools.partial(function, shared)
        known = kernel_of(one, example, form=gpu.form)
    _KERNELS[key] = known
    while len(_KERNELS) > _MOST_KERNELS:
        _KERNELS.popitem(last=False)
    return known


def _value(tree: PyTree, of_numbers: Callable[[np.ndarray], bytes]) -> tuple[Any, ...]:
    """What a kernel depends on in a pytree: two that are equal make the same kernel."""
    leaves, structure = jax.tree.flatten(tree)
    values = []
    for leaf in leaves:
        if not eqx.is_array_like(leaf):
            values.append(leaf)
            continue
        array = np.asarray(leaf)
        values.append((array.dtype.str, array.shape, of_numbers(array)))
    return structure, tuple(values)


def _no_bytes(array: np.ndarray) -> bytes:
    """In place of the numbers, for those that a kernel gets when it is called."""
    return b""


def differing(found: PyTree, expected: PyTree) -> np.ndarray:
    """Which runs have another number somewhere, beyond rounding."""
    other = np.zeros(_count(expected), bool)
    leaves = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    for x, y in leaves:
        x, y = (np.asarray(each, float).reshape(len(other), -1) for each in (x, y))
        largest = np.max(np.abs(y), initial=0.0, where=np.isfinite(y))
        with np.errstate(invalid="ignore"):  # infinity less infinity
            near = np.abs(x - y) <= ROUNDING * max(largest, 1.0)
        other |= ~np.all(near | (x == y) | (np.isnan(x) & np.isnan(y)), axis=1)
    return other


def _count(runs: PyTree) -> int:
    return len(jax.tree.leaves(runs)[0])


def _around(runs: PyTree, begin: int, size: int) -> PyTree:
    """A number of runs from an index on, with the first ones again after the last."""
    places = np.arange(begin, begin + size) % _count(runs)
    return jax.tree.map(lambda x: np.asarray(x)[places], runs)


_FITS: dict[Any, int] = {}
"""Runs in one call for which a GPU had memory, by function"""


def by_xla(
    gpu: Gpu, function: Callable[[Any, Any], Any], shared: PyTree, runs: PyTree
) -> Any:
    """Values of `function(shared, run)` for all runs, in the largest batches that fit."""

    def fly(begin: int, size: int) -> Any:
        return _fly(gpu, function, shared, _around(runs, begin, size))

    flown = [
        jax.tree.map(lambda x, n=kept: np.asarray(x)[:n], values)
        for values, kept in _in_batches(function, fly, _count(runs))
    ]
    return jax.tree.map(lambda *parts: np.concatenate(parts), *flown)


def sum_by_xla(
    gpu: Gpu, function: Callable[[Any, Any, Any], Any], shared: PyTree, runs: PyTree
) -> Any:
    """Sum of `function(shared, runs, counts)` over batches, as `sum_over_runs`."""
    count = _count(runs)

    def fly(begin: int, size: int) -> Any:
        counts = np.arange(begin, begin + size) < count
        return _sum(gpu, function, shared, _around(runs, begin, size), counts)

    sums = (values for values, _ in _in_batches(function, fly, count))
    total = functools.reduce(lambda *both: jax.tree.map(np.add, *both), sums)
    return jax.tree.map(jnp.asarray, total)


def _in_batches(
    function: Any, fly: Callable[[int, int], Any], count: int
) -> Iterator[tuple[Any, int]]:
    """Values of each batch, and how many of its runs count. A batch that does not fit
    into the memory is halved, and the size that fits is remembered."""
    begin = 0
    while begin < count:
        size = _FITS.get(function, min(BLOCK, _power_of_two(count)))
        try:
            values = jax.tree.map(np.asarray, fly(begin, size))
        except jax.errors.JaxRuntimeError as error:
            if "RESOURCE_EXHAUSTED" not in str(error) or size <= _LEAST:
                raise
            _FITS[function] = size // 2
            continue
        yield values, min(size, count - begin)
        begin += size


def _power_of_two(count: int) -> int:
    """The smallest power of two that is not less: few programs serve all counts."""
    return max(1 << (count - 1).bit_length(), _LEAST)


def _fly(gpu: Gpu, function, shared, runs):
    numbers, structure = eqx.partition(shared, eqx.is_array)
    there = jax.device_put((numbers, runs), gpu.device)
    with stages_written_out():
        return _mapped(function, structure, *there)


def _sum(gpu: Gpu, function, shared, runs, counts):
    numbers, structure = eqx.partition(shared, eqx.is_array)
    there = jax.device_put((numbers, runs, counts), gpu.device)
    with stages_written_out():
        return _summed(function, structure, *there)


@eqx.filter_jit
def _mapped(function, structure, numbers, runs):
    shared = eqx.combine(numbers, structure)
    return jax.vmap(lambda run: function(shared, run))(runs)


@eqx.filter_jit
def _summed(function, structure, numbers, runs, counts):
    return function(eqx.combine(numbers, structure), runs, counts)
