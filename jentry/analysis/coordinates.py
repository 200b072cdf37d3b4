"""Coordinates of deviations: at equal index, in errors of a law, without unused ones."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array

from ..guidance.law import Tracked
from ..motion.state import EntryState
from .local_derivatives import LoopDerivatives


_SINGULAR = 1e10
"""Condition number of errors by deviations"""


def lift(gradient: Array | np.ndarray, out: int) -> np.ndarray:
    """Matrix from deviations at equal index to all deviations, (points, n, n - 1)."""
    gradient = np.asarray(gradient)
    points, n = gradient.shape
    lifted = np.tile(np.eye(n), (points, 1, 1))
    lifted[:, out] = -gradient / gradient[:, [out]]
    return np.delete(lifted, out, axis=2)


def in_errors(
    matrices: np.ndarray,
    names: Sequence[str],
    kept: np.ndarray,
    tracked: Tracked,
    found: LoopDerivatives,
    out: int,
    sampled: bool,
) -> tuple[np.ndarray, list[str]]:
    """Transform the deviations of the motion into the errors that the law tracks.

    The relation between errors and motion changes along the flight, and its rate is part of
    the rates of the errors. The matrices do not change if the number of errors differs from
    the number of coordinates of the motion that they depend on, or if the errors do not
    determine these coordinates.

    **Arguments:**

    - `names`: names of the rows and columns. The next argument has their places in the
        deviations at equal index.
    - `out`: place of the coordinate that is eliminated.
    - `sampled`: whether the matrices are maps of one guidance cycle, or else rates.
    """
    motion = np.isin(names, list(EntryState.__dataclass_fields__))
    equal = lift(found.gradient, out)[..., kept]
    rows = np.asarray(found.errors) @ equal
    replaced = np.flatnonzero(motion & np.any(rows != 0.0, axis=(0, 1))).tolist()
    if len(replaced) != rows.shape[1] or _is_singular(rows[..., replaced]):
        return matrices, list(names)
    onto = np.tile(np.eye(len(names)), (len(rows), 1, 1))
    onto[:, replaced] = rows
    if sampled:
        then = onto.copy()
        then[:, replaced] = (
            found.errors_then @ lift(found.gradient_then, out)[..., kept]
        )
        matrices = then @ matrices @ np.linalg.inv(onto)
    else:
        turning = _lift_rate(found, out)[..., kept]
        changing = np.zeros_like(onto)
        changing[:, replaced] = found.errors_then @ equal + found.errors @ turning
        matrices = (onto @ matrices + changing) @ np.linalg.inv(onto)
    primed = (
        f"e{place}" + "'" * order
        for place, error in enumerate(tracked.errors, 1)
        for order in range(len(error))
    )
    named = dict(zip(replaced, primed, strict=True))
    return matrices, [named.get(place, name) for place, name in enumerate(names)]


def _lift_rate(found: LoopDerivatives, out: int) -> np.ndarray:
    """Rate of `lift` per unit of the index, along the flight."""
    steep, steeper = found.gradient[:, [out]], found.gradient_then[:, [out]]
    rate = np.zeros((*found.gradient.shape, found.gradient.shape[1]))
    rate[:, out] = -(found.gradient_then - found.gradient * steeper / steep) / steep
    return np.delete(rate, out, axis=2)


def _is_singular(rows: np.ndarray) -> bool:
    """Whether the errors do not determine the motion at some point, in any units."""
    for axis in (2, 1, 2, 1):
        size = np.max(np.abs(rows), axis=axis, keepdims=True)
        if not np.all(size > 0.0):
            return True
        rows = rows / size
    return not np.all(np.linalg.cond(rows) < _SINGULAR)


def without(
    matrices: np.ndarray, alone: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Places of the remaining coordinates, and places of the removed coordinates.

    A coordinate is removed if its column equals that of `alone` exactly. The remaining
    coordinates do not depend on it: the matrices are block triangular.
    """
    gone: list[int] = []
    while True:
        rest = kept[~np.isin(kept, gone)]
        differs = (matrices - alone)[:, rest[:, None], rest] != 0.0
        more = rest[~differs.any(axis=(0, 1))]
        if not more.size:
            return rest, np.array(gone, int)
        gone += list(more)
