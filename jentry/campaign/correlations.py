"""Correlated normal dispersions, from the matrix of their correlations."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from .dispersions import Dispersion
from .distributions import CorrelatedNormal, Normal


_SLACK = 1e-9
"""Tolerance of symmetry, of the diagonal of 1 and of the least eigenvalue of a matrix"""


def correlated_normals(
    dispersions: Mapping[str, Dispersion], correlation: Any
) -> dict[str, Dispersion]:
    """Dispersions with correlated draws, made of independent normal ones.

        dispersions = {
            "density": density,
            **correlated_normals(
                {"lift": lift, "drag": drag}, [[1.0, 0.8], [0.8, 1.0]]
            ),
        }

    They share one stream, which is named after all of them.

    **Arguments:**

    - `dispersions`: two or more, each `Normal` and without a stream.
    - `correlation`: the correlation matrix, in the order of the dispersions.

    **Raises:** `ValueError` for another distribution, and for a matrix that is not
    symmetric, has no diagonal of 1 or is not positive definite.
    """
    names = list(dispersions)
    if len(names) < 2:
        raise ValueError(
            f"{len(names)} dispersions are to be correlated: give 2 or more"
        )
    normals: dict[str, Normal] = {}
    for name, dispersion in dispersions.items():
        if not isinstance(dispersion.distribution, Normal):
            kind = type(dispersion.distribution).__name__
            raise ValueError(
                f"dispersion {name!r} is {kind}: dispersions that are correlated must be "
                "Normal"
            )
        if dispersion.stream is not None:
            raise ValueError(
                f"dispersion {name!r} has the stream {dispersion.stream!r}: leave it out, "
                "correlated dispersions have a stream of their own"
            )
        normals[name] = dispersion.distribution
    root = _lower_root(names, correlation)
    return {
        name: dataclasses.replace(
            dispersions[name],
            distribution=CorrelatedNormal(
                normals[name].mean, normals[name].standard_deviation, weights
            ),
            stream=" and ".join(names),
        )
        for name, weights in zip(names, root, strict=True)
    }


def _lower_root(names: list[str], correlation: Any) -> np.ndarray:
    """The lower triangular root of a correlation matrix. Refuses any other matrix."""
    of = f"the correlation of {', '.join(names)}"
    matrix = np.asarray(correlation, dtype=float)
    count = len(names)
    if matrix.shape != (count, count):
        raise ValueError(
            f"{of} has shape {matrix.shape}: expected a row and a column for each, "
            f"{(count, count)}"
        )
    if not np.all(np.isfinite(matrix)):
        raise ValueError(f"{of} has a number that is not finite: {matrix.tolist()}")
    for i, name in enumerate(names):
        if abs(matrix[i, i] - 1.0) > _SLACK:
            raise ValueError(
                f"{of} has {matrix[i, i]:g} for {name} itself: write 1 on the diagonal, "
                "the standard deviations are those of the dispersions"
            )
        for j in range(i):
            if abs(matrix[i, j] - matrix[j, i]) > _SLACK:
                raise ValueError(
                    f"{of} is not symmetric: {matrix[i, j]:g} for {name} with {names[j]} "
                    f"and {matrix[j, i]:g} for {names[j]} with {name}"
                )
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < _SLACK:
        raise ValueError(
            f"{of} is not positive definite, its least eigenvalue is {least:.2g}: no "
            "numbers are correlated like that. Where two always go together, give both "
            "dispersions one stream"
        )
    return np.linalg.cholesky(matrix)
