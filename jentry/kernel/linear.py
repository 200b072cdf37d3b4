"""Small systems of linear equations, written out."""

from typing import Any

import numpy as np
from jax import lax

from .elements import NotInKernel, as_elements, objects
from .structure import chosen


LARGEST = 12
"""Largest number of equations of a system that is written out"""


def _times(x: Any, y: Any) -> Any:
    return lax.mul(x, y)


def _less(x: Any, y: Any) -> Any:
    return lax.sub(x, y)


def lu(matrix: np.ndarray) -> list[np.ndarray]:
    """Factors, pivots and permutation of a square matrix, as `lax.linalg.lu` returns."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise NotInKernel(f"factors a matrix of shape {matrix.shape}")
    size = matrix.shape[0]
    if size > LARGEST:
        raise NotInKernel(
            f"solves {size} equations for each flight; a kernel solves {LARGEST}"
        )
    rows = as_elements(matrix).copy()
    order = objects((np.int32(i) for i in range(size)), (size,))
    pivots = []
    for k in range(size):
        best, pivot = lax.abs(rows[k, k]), np.int32(k)
        for i in range(k + 1, size):
            other = lax.abs(rows[i, k])
            wins = lax.gt(other, best)
            best, pivot = chosen(wins, other, best), chosen(wins, np.int32(i), pivot)
        pivots.append(pivot)
        for i in range(k + 1, size):
            here = lax.eq(pivot, np.int32(i))
            rows[k], rows[i] = _swapped(here, rows[k], rows[i])
            both = _swapped(here, order[k : k + 1], order[i : i + 1])
            order[k : k + 1], order[i : i + 1] = both
        for i in range(k + 1, size):
            rows[i, k] = lax.div(rows[i, k], rows[k, k])
            for j in range(k + 1, size):
                rows[i, j] = _less(rows[i, j], _times(rows[i, k], rows[k, j]))
    return [rows, objects(pivots, (size,)), order]


def _swapped(here: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pairs = [
        (chosen(here, b, a), chosen(here, a, b)) for a, b in zip(x, y, strict=True)
    ]
    first, second = zip(*pairs, strict=True)
    return objects(first, x.shape), objects(second, y.shape)


def triangular_solve(
    matrix: np.ndarray,
    right: np.ndarray,
    *,
    left_side: bool,
    lower: bool,
    transpose_a: bool,
    unit_diagonal: bool,
    **_,
) -> np.ndarray:
    """The solution of a triangular system, as `lax.linalg.triangular_solve` returns it."""
    matrix, right = as_elements(matrix), as_elements(right)
    if matrix.ndim != 2 or matrix.shape[0] > LARGEST:
        raise NotInKernel(
            f"solves equations with a matrix of shape {matrix.shape} for each flight"
        )
    if not left_side:  # X A = B is A' X' = B'
        matrix, right = matrix.T, right.T
        lower = not lower
    if transpose_a:
        matrix, lower = matrix.T, not lower
    columns = [_substituted(matrix, column, lower, unit_diagonal) for column in right.T]
    flat = [columns[j][i] for i in range(len(matrix)) for j in range(len(columns))]
    out = objects(flat, right.shape)
    return out if left_side else out.T


def _substituted(
    matrix: np.ndarray, column: np.ndarray, lower: bool, unit_diagonal: bool
) -> list[Any]:
    size = len(matrix)
    found: dict[int, Any] = {}
    for i in range(size) if lower else reversed(range(size)):
        value = column[i]
        for j, x in found.items():
            value = _less(value, _times(matrix[i, j], x))
        found[i] = value if unit_diagonal else lax.div(value, matrix[i, i])
    return [found[i] for i in range(size)]
