"""Operations that move the numbers of arrays, or add them up, without a computation of
their own: on NumPy arrays of numbers and on those of elements alike."""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax import lax

from .elements import NotInKernel, as_elements, is_known, objects


def _broadcast(x: np.ndarray, *, shape, broadcast_dimensions, **_) -> np.ndarray:
    sizes = [1] * len(shape)
    for axis, place in enumerate(broadcast_dimensions):
        sizes[place] = x.shape[axis]
    return np.broadcast_to(x.reshape(sizes), shape)


def _reshape(x: np.ndarray, *, new_sizes, dimensions=None, **_) -> np.ndarray:
    return (x if dimensions is None else x.transpose(dimensions)).reshape(new_sizes)


def _squeeze(x: np.ndarray, *, dimensions) -> np.ndarray:
    return np.squeeze(x, tuple(dimensions))


def _expand_dims(x: np.ndarray, *, dimensions) -> np.ndarray:
    return np.expand_dims(x, tuple(dimensions))


def _transpose(x: np.ndarray, *, permutation) -> np.ndarray:
    return x.transpose(permutation)


def _reversed(x: np.ndarray, *, dimensions) -> np.ndarray:
    return np.flip(x, tuple(dimensions))


def _concatenate(*arrays: np.ndarray, dimension) -> np.ndarray:
    return np.concatenate(together(arrays), dimension)


def _stack(*arrays: np.ndarray, axis) -> np.ndarray:
    return np.stack(together(arrays), axis)


def _unstack(x: np.ndarray, *, axis) -> list[np.ndarray]:
    rows = np.moveaxis(x, axis, 0)
    return [rows[i, ...] for i in range(len(rows))]  # arrays, of one element too


def _split(x: np.ndarray, *, sizes, axis) -> list[np.ndarray]:
    return np.split(x, np.cumsum(sizes)[:-1], axis)


def _slice(x: np.ndarray, *, start_indices, limit_indices, strides) -> np.ndarray:
    steps = strides or [1] * x.ndim
    return x[tuple(map(slice, start_indices, limit_indices, steps))]


def _pad(x: np.ndarray, value: np.ndarray, *, padding_config) -> np.ndarray:
    x, value = together((x, value))
    shape = []
    for size, (low, high, inside) in zip(x.shape, padding_config, strict=True):
        shape.append(int(low + size + max(size - 1, 0) * inside + high))
    filled = objects([value.ravel()[0]] * int(np.prod(shape)), shape)
    if is_known(x):
        filled = np.full(shape, value, x.dtype)
    for at in np.ndindex(x.shape):
        place = [
            low + i * (inside + 1)
            for i, (low, _, inside) in zip(at, padding_config, strict=True)
        ]
        if all(0 <= p < size for p, size in zip(place, shape, strict=True)):
            filled[tuple(place)] = x[at]
    return filled


def _same(*arrays: np.ndarray, **_) -> list[np.ndarray]:
    return list(arrays)


def _side_by_side(*arrays: np.ndarray, count) -> list[np.ndarray]:
    return list(arrays[:count])


MOVES: dict[str, Callable[..., Any]] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _squeeze,
    "expand_dims": _expand_dims,
    "transpose": _transpose,
    "rev": _reversed,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _unstack,
    "split": _split,
    "slice": _slice,
    "pad": _pad,
    "side_by_side": _side_by_side,
    "optimization_barrier": _same,
}
"""Operations by name, as functions of arrays and of the parameters of the operation"""


def together(arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Arrays of elements if any of them is one."""
    if all(map(is_known, arrays)):
        return list(arrays)
    return [as_elements(x) for x in arrays]


def _along(x: np.ndarray, axes: Sequence[Any]) -> tuple[np.ndarray, tuple[int, ...]]:
    """The elements to be reduced along a last axis, and the shape of the result."""
    axes = tuple(axes)
    kept = [i for i in range(x.ndim) if i not in axes]
    shape = tuple(x.shape[i] for i in kept)
    return x.transpose([*kept, *axes]).reshape(*shape, -1), shape


def _reduce(function: Callable[..., Any]) -> Callable[..., np.ndarray]:
    def rule(x: np.ndarray, *, axes, **_) -> np.ndarray:
        rows, shape = _along(x, axes)
        act = function
        flat = rows.reshape(-1, rows.shape[-1])
        return objects((functools.reduce(act, row) for row in flat), shape)

    return rule


def _place_of(better: Callable[..., Any]) -> Callable[..., np.ndarray]:
    """Index of the first best number, or of the first NaN."""

    def of_row(row: Sequence[Any], dtype: Any) -> Any:
        best, place = row[0], np.zeros((), dtype)[()]
        for index, x in enumerate(row[1:], 1):
            wins = better(x, best)
            if np.issubdtype(np.dtype(x.dtype), np.floating):
                lost = lax.ne(best, best)
                wrong = lax.ne(x, x)
                wins = lax.bitwise_or(wins, wrong)
                wins = lax.bitwise_and(wins, _not(lost))
            best = chosen(wins, x, best)
            place = chosen(wins, np.asarray(index, dtype)[()], place)
        return place

    def rule(x: np.ndarray, *, axes, index_dtype, **_) -> np.ndarray:
        rows, shape = _along(x, axes)
        flat = rows.reshape(-1, rows.shape[-1])
        return objects((of_row(list(row), index_dtype) for row in flat), shape)

    return rule


def _not(x: Any) -> Any:
    return np.invert(x) if isinstance(x, np.generic) else lax.bitwise_not(x)


def chosen(condition: Any, x: Any, otherwise: Any) -> Any:
    """`x` where the condition holds, and `otherwise` elsewhere."""
    return lax.select_n(condition, otherwise, x)


def _cumulative(function: Callable[..., Any]) -> Callable[..., np.ndarray]:
    def rule(x: np.ndarray, *, axis, reverse, **_) -> np.ndarray:
        rows = np.moveaxis(x, axis, -1)
        rows = rows[..., ::-1] if reverse else rows
        act = function
        flat = rows.reshape(-1, rows.shape[-1])
        sums = itertools.chain.from_iterable(itertools.accumulate(r, act) for r in flat)
        out = objects(sums, rows.shape)
        return np.moveaxis(out[..., ::-1] if reverse else out, -1, axis)

    return rule


def dot_general(
    x: np.ndarray, y: np.ndarray, *, dimension_numbers, preferred_element_type, **_
) -> np.ndarray:
    """Sums of products, written out."""
    (x_summed, y_summed), (x_batch, y_batch) = dimension_numbers
    x_kept = [i for i in range(x.ndim) if i not in (*x_summed, *x_batch)]
    y_kept = [i for i in range(y.ndim) if i not in (*y_summed, *y_batch)]
    batch = [x.shape[i] for i in x_batch]
    x_rows = x.transpose([*x_batch, *x_kept, *x_summed])
    y_rows = y.transpose([*y_batch, *y_kept, *y_summed])
    summed = int(np.prod([x.shape[i] for i in x_summed]))
    shape = *batch, *(x.shape[i] for i in x_kept), *(y.shape[i] for i in y_kept)
    x_rows = x_rows.reshape(int(np.prod(batch)), -1, summed)
    y_rows = y_rows.reshape(int(np.prod(batch)), -1, summed)
    out = [
        _dot(x_rows[b, i], y_rows[b, j])
        for b in range(x_rows.shape[0])
        for i in range(x_rows.shape[1])
        for j in range(y_rows.shape[1])
    ]
    return objects(out, shape)


def _dot(x: np.ndarray, y: np.ndarray) -> Any:
    total = None
    for pair in zip(x, y, strict=True):
        product = lax.mul(*pair)
        total = product if total is None else lax.add(total, product)
    if total is None:
        raise NotInKernel("a sum of no products")
    return total


SUMS: dict[str, Callable[..., np.ndarray]] = {
    "reduce_sum": _reduce(lax.add),
    "reduce_prod": _reduce(lax.mul),
    "reduce_max": _reduce(lax.max),
    "reduce_min": _reduce(lax.min),
    "reduce_and": _reduce(lax.bitwise_and),
    "reduce_or": _reduce(lax.bitwise_or),
    "reduce_xor": _reduce(lax.bitwise_xor),
    "argmax": _place_of(lax.gt),
    "argmin": _place_of(lax.lt),
    "cumsum": _cumulative(lax.add),
    "cumprod": _cumulative(lax.mul),
    "cummax": _cumulative(lax.max),
    "cummin": _cumulative(lax.min),
    "dot_general": dot_general,
}
"""Operations on arrays of elements that combine several of them"""
