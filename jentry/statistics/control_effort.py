"""Control effort of flights with histories: how much and how often the bank moves."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float


if TYPE_CHECKING:
    import xarray


BANK, ANGLE_OF_ATTACK = "bank_angle", "angle_of_attack"


def mean_rates(histories: "xarray.Dataset", angle: str) -> Float[np.ndarray, " runs"]:
    """Mean magnitude of the rate of an angle over each flight, rad/s.

    It is the sum of the changes from one entry of the history to the next, over the time
    between the first and the last entry. What an angle does between two entries is not
    seen. NaN for a flight with fewer than two entries.

    **Arguments:**

    - `angle`: `BANK` or `ANGLE_OF_ATTACK`. The command counts if the history has it.
    """
    angles = _commanded(histories, angle)
    steps = np.diff(angles, axis=1)
    steps = np.abs(np.mod(steps + np.pi, 2.0 * np.pi) - np.pi)  # the shorter way around
    duration = np.sum(np.isfinite(steps), axis=1) * np.diff(
        histories["time"].values[:2]
    )
    moved = np.nansum(steps, axis=1)
    return np.divide(
        moved, duration, out=np.full(len(moved), np.nan), where=duration > 0.0
    )


def reversals(histories: "xarray.Dataset") -> Float[np.ndarray, " runs"]:
    """Number of changes of the side of the bank in each flight.

    A bank of zero, or of half a turn, is on no side.
    """
    sides = np.sign(np.round(np.sin(_commanded(histories, BANK)), 9))
    counts = []
    for side in sides:
        side = side[np.isfinite(side) & (side != 0.0)]
        counts.append(np.count_nonzero(side[1:] != side[:-1]))
    return np.array(counts, dtype=float)


def _commanded(histories: "xarray.Dataset", angle: str) -> np.ndarray:
    name = f"commanded_{angle}"
    chosen = histories[name if name in histories else angle]
    return np.asarray(chosen.transpose("run", "time").values, dtype=float)
