"""Places of arrays that are computed in the kernel: how they are read and written."""

import abc
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax import lax
from jax.lax import GatherScatterMode

from .elements import NotInKernel, as_elements, is_constant, is_known, objects
from .structure import chosen


MOST_CHOICES = 4096
"""Largest number of selections that one operation is written out as"""


FEW = 8
"""Numbers of an array that are selected, and not read from a table"""


class AbstractTables(abc.ABC):
    """Reads numbers that are known when the kernel is made, at places that are not."""

    @abc.abstractmethod
    def read(self, table: np.ndarray, place: Any) -> Any:
        """The element of a table of one axis at a place that is within it."""


def whole(number: int) -> Any:
    """A place, of the type that all computed places have."""
    return np.int32(number)


def as_place(element: Any) -> Any:
    """A place of the type that all computed places have."""
    if is_constant(element):
        # A place beyond what this type holds is beyond every array.
        return whole(int(np.clip(int(element), -(2**31), 2**31 - 1)))
    if element.dtype == np.int32:
        return element
    return lax.convert_element_type(element, np.int32)


def clamped(place: Any, last: int) -> Any:
    """A place, moved to the nearest one from 0 to the last."""
    if is_constant(place):
        return whole(min(max(int(place), 0), last))
    if last == 0:
        return whole(0)
    low = lax.max(place, whole(0))
    return lax.min(low, whole(last))


def _plus(place: Any, offset: int) -> Any:
    if is_constant(place):
        return whole(int(place) + offset)
    return lax.add(place, whole(offset)) if offset else place


def _times(place: Any, factor: int) -> Any:
    if is_constant(place):
        return whole(int(place) * factor)
    return lax.mul(place, whole(factor)) if factor != 1 else place


def element_at(tables: AbstractTables, array: np.ndarray, places: Sequence[Any]) -> Any:
    """The element of an array at a place, one number an axis, within the array."""
    unknown = [axis for axis, p in enumerate(places) if not is_constant(p)]
    at: list[Any] = [
        slice(None) if i in unknown else int(p) for i, p in enumerate(places)
    ]
    left = array[tuple(at)]
    if not unknown:
        return left
    if is_known(array) and array.size > FEW:
        # The whole array is one table: what a flight reads of it lies together.
        return tables.read(_flat(array), _flat_place(array.shape, places))
    place = _flat_place(left.shape, [places[axis] for axis in unknown])
    candidates = as_elements(left).reshape(-1)
    _check_size(candidates.size, "reads an array of a flight at computed places")
    found = candidates[0]
    for index, candidate in enumerate(candidates[1:], 1):
        here = lax.eq(place, whole(index))
        found = chosen(here, candidate, found)
    return found


def _flat(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array).reshape(-1)


def _flat_place(shape: Sequence[int], places: Sequence[Any]) -> Any:
    """The place in the flat array of a place with one number an axis."""
    steps = [_times(p, math.prod(shape[i + 1 :])) for i, p in enumerate(places)]
    known = sum(int(step) for step in steps if is_constant(step))
    moving = [step for step in steps if not is_constant(step)]
    total = functools.reduce(lax.add, moving)
    return _plus(total, known)


def _check_size(choices: int, what: str) -> None:
    if choices > MOST_CHOICES:
        raise NotInKernel(
            f"{what}, which takes {choices} selections; a kernel takes {MOST_CHOICES}"
        )


def dynamic_slice(
    tables: AbstractTables,
    array: np.ndarray,
    starts: Sequence[Any],
    sizes: Sequence[int],
) -> np.ndarray:
    """A part of an array; its start is moved so that it is within the array."""
    begins = [
        clamped(as_place(start), have - size)
        for start, have, size in zip(starts, array.shape, sizes, strict=True)
    ]
    return objects(
        (
            element_at(tables, array, list(map(_plus, begins, at)))
            for at in np.ndindex(tuple(sizes))
        ),
        sizes,
    )


def dynamic_update_slice(
    array: np.ndarray, update: np.ndarray, starts: Sequence[Any]
) -> np.ndarray:
    """An array with a part replaced; its start is moved so that it is within the array."""
    begins = [
        clamped(as_place(start), have - size)
        for start, have, size in zip(starts, array.shape, update.shape, strict=True)
    ]
    return _written(array, update[None], [begins], _replaced)


def _written(
    array: np.ndarray,
    updates: np.ndarray,
    windows: Sequence[Sequence[Any]],
    combine: Callable[[Any, Any], Any],
    counts: Sequence[Any] = (True,),
) -> np.ndarray:
    """An array with updates of shape (windows, ...) written, each from its start on."""
    out, updates = as_elements(array).copy(), as_elements(updates)
    shape = updates.shape[1:]
    for number, (begins, counted) in enumerate(zip(windows, counts, strict=True)):
        new = updates[number : number + 1].reshape(shape)
        computed = [i for i, begin in enumerate(begins) if not is_constant(begin)]
        choices = new.size * math.prod(array.shape[i] for i in computed)
        _check_size(choices, "writes into an array of a flight at computed places")
        for offset in np.ndindex(shape):
            reach = [
                range(have) if i in computed else [int(begins[i]) + offset[i]]
                for i, have in enumerate(array.shape)
            ]
            for place in itertools.product(*reach):
                if any(not 0 <= p < n for p, n in zip(place, array.shape, strict=True)):
                    continue
                here = counted
                for i in computed:
                    here = _both(here, _equal(begins[i], place[i] - offset[i]))
                if here is False:
                    continue
                value = combine(out[place], new[offset])
                out[place] = value if here is True else chosen(here, value, out[place])
    return out


def _equal(place: Any, number: int) -> Any:
    if is_constant(place):
        return int(place) == number
    return lax.eq(place, whole(number))


def _both(a: Any, b: Any) -> Any:
    if a is False or b is False:
        return False
    if a is True:
        return b
    return a if b is True else lax.bitwise_and(a, b)


def _start_vectors(indices: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """The start of each window, shape (windows, numbers), and the shape of the windows."""
    shape = indices.shape[:-1]
    return as_elements(indices).reshape(-1, indices.shape[-1]), shape


def gather(
    tables: AbstractTables,
    array: np.ndarray,
    indices: np.ndarray,
    *,
    dimension_numbers,
    slice_sizes,
    mode,
    fill_value,
    out_type: Any,
    **_,
) -> np.ndarray:
    """Windows of an array at computed places, `lax.gather`."""
    numbers = dimension_numbers
    if numbers.operand_batching_dims:
        raise NotInKernel("gathers along an axis of batches")
    starts, batch = _start_vectors(indices)
    mode = GatherScatterMode.from_any(mode)
    dropped = numbers.collapsed_slice_dims
    kept = [axis for axis in range(array.ndim) if axis not in dropped]
    window = [slice_sizes[axis] for axis in kept]
    rows = []
    for start in starts:
        begins: list[Any] = [whole(0)] * array.ndim
        inside: Any = True
        for axis, number in zip(numbers.start_index_map, start, strict=True):
            last = array.shape[axis] - slice_sizes[axis]
            place = as_place(number)
            if mode is GatherScatterMode.FILL_OR_DROP:
                inside = _both(inside, _within(place, last))
            begins[axis] = clamped(place, last)
        elements = []
        for at in np.ndindex(tuple(window)):
            offsets = [0] * array.ndim
            for axis, offset in zip(kept, at, strict=True):
                offsets[axis] = offset
            found = element_at(tables, array, list(map(_plus, begins, offsets)))
            if inside is not True:
                missing = _filler(fill_value, out_type.dtype)
                found = missing if inside is False else chosen(inside, found, missing)
            elements.append(found)
        rows.append(elements)
    flat = itertools.chain.from_iterable(rows)
    out = objects(flat, (*batch, *window))
    # The axes of the windows are `offset_dims` of the result.
    of_batch = [i for i in range(out.ndim) if i not in numbers.offset_dims]
    order = np.argsort([*of_batch, *numbers.offset_dims])
    return out.transpose(order)


def _within(place: Any, last: int) -> Any:
    if is_constant(place):
        return 0 <= int(place) <= last
    above = lax.ge(place, whole(0))
    return lax.bitwise_and(above, lax.le(place, whole(last)))


def _filler(value: Any, dtype: Any) -> Any:
    """What `lax.gather` returns beyond an array if nothing is stated."""
    dtype = np.dtype(dtype)
    if value is None:
        if np.issubdtype(dtype, np.inexact):
            value = np.nan
        elif np.issubdtype(dtype, np.signedinteger):
            value = np.iinfo(dtype).min
        elif dtype.kind == "b":
            value = True
        else:
            value = np.iinfo(dtype).max
    return np.asarray(value, dtype)[()]


def _replaced(old: Any, new: Any) -> Any:
    return new


WRITES: dict[str, Callable[[Any, Any], Any]] = {
    "scatter": _replaced,
    "scatter-add": lax.add,
    "scatter-sub": lax.sub,
    "scatter-mul": lax.mul,
    "scatter-min": lax.min,
    "scatter-max": lax.max,
}
"""Operations that write at computed places, with what they make of the old number and the
new one"""


def scatter(
    name: str,
    array: np.ndarray,
    indices: np.ndarray,
    updates: np.ndarray,
    *,
    dimension_numbers,
    mode,
    **_,
) -> np.ndarray:
    """An array with windows of updates at computed places, `lax.scatter` and its kin."""
    numbers = dimension_numbers
    if numbers.operand_batching_dims:
        raise NotInKernel("scatters along an axis of batches")
    starts, _ = _start_vectors(indices)
    of_batch = [i for i in range(updates.ndim) if i not in numbers.update_window_dims]
    moved = updates.transpose([*of_batch, *numbers.update_window_dims])
    window = list(moved.shape[len(of_batch) :])
    for axis in sorted(numbers.inserted_window_dims):
        window.insert(axis, 1)
    mode = GatherScatterMode.from_any(mode)
    begins, counts = [], []
    for start in starts:
        at: list[Any] = [whole(0)] * array.ndim
        inside: Any = True
        for axis, number in zip(
            numbers.scatter_dims_to_operand_dims, start, strict=True
        ):
            last = array.shape[axis] - window[axis]
            place = as_place(number)
            if mode is GatherScatterMode.CLIP:
                place = clamped(place, last)
            else:
                inside = _both(inside, _within(place, last))
            at[axis] = place
        begins.append(at)
        counts.append(inside)
    return _written(
        array, moved.reshape(len(begins), *window), begins, WRITES[name], counts
    )
