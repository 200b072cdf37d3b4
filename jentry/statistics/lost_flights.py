"""Magnitudes of an output over all runs, where lost flights are larger than any number."""

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..campaign.outputs import error_of
from ..flight.termination import Outcome


if TYPE_CHECKING:
    import xarray


MISS_OVER_GROUND = "miss_over_ground"
"""Distance from the target over the ground, of the downrange and the crossrange error"""

_PARTS = error_of("downrange"), error_of("crossrange")


def magnitudes(results: "xarray.Dataset", measure: str) -> Float[np.ndarray, " runs"]:
    """Magnitudes of an error for all runs, SI. A lost flight is infinite.

    A flight is lost if it did not reach the end of guided flight, or if the error is not
    finite.

    **Arguments:**

    - `measure`: an output of the results, or `MISS_OVER_GROUND`.

    **Raises:** `ValueError` for an output that the results do not have.
    """
    names = _PARTS if measure == MISS_OVER_GROUND else (measure,)
    for name in names:
        if name not in results:
            raise ValueError(
                f"the results have no output {name}, from which {measure} is computed"
            )
    parts = [np.asarray(results[name].values, dtype=float) for name in names]
    values = np.abs(parts[0]) if len(parts) == 1 else np.hypot(*parts)
    reached = results["outcome"].values == Outcome.REACHED
    return np.where(reached & np.isfinite(values), values, np.inf)


def percentile_with_lost(
    ordered: Float[np.ndarray, "*sets runs"], percentile: float
) -> Float[np.ndarray, "*sets"]:
    """A percentile along the last axis, in which the values increase and may be infinite.

    The interpolation between two runs is linear, as in `numpy.percentile`, which is NaN
    between infinite values. Here a percentile beyond the last finite value is infinite.
    """
    place = (ordered.shape[-1] - 1) * percentile / 100.0
    below = int(np.floor(place))
    above = min(below + 1, ordered.shape[-1] - 1)
    low, high = ordered[..., below], ordered[..., above]
    share = place - below
    if share == 0.0:
        return low
    finite = np.isfinite(high)
    high_ = np.where(finite, high, 0.0)
    low_ = np.where(finite, low, 0.0)
    return np.where(finite, low_ + share * (high_ - low_), np.inf)


def runs_needed(percentile: float) -> int:
    """Least number of runs of which one is expected to be beyond a percentile."""
    return math.ceil(100.0 / (100.0 - percentile) - 1e-6)
