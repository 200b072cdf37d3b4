"""Ranks of several laws on the same draws, with intervals by bootstrap."""

import numpy as np
from jaxtyping import Float

from .intervals import CONFIDENCE, FEWEST, MOST_AT_ONCE, RESAMPLES, Interval
from .lost_flights import percentile_with_lost, runs_needed


def ranks_of(
    values: Float[np.ndarray, "laws ..."],
) -> Float[np.ndarray, "laws ..."]:
    """Ranks along the first axis; 1 is the smallest. Equal values have their mean rank.

    Infinite values are equal.
    """
    smaller = np.sum(values[None] < values[:, None], axis=1)
    equal = np.sum(values[None] == values[:, None], axis=1)
    return smaller + 0.5 * (equal + 1.0)


def rank_intervals(
    sizes: Float[np.ndarray, "laws runs"], percentile: float
) -> list[Interval]:
    """Rank of each law by a percentile of its magnitudes, with a bootstrap interval.

    Run i of all laws has the same draw. So the bootstrap draws runs, and takes each drawn
    run of all laws. The bounds are percentiles of the ranks of the resamples, NaN for fewer
    than `FEWEST` runs. The rank is NaN if the runs are too few for the percentile.

    **Arguments:**

    - `sizes`: magnitudes by law and run, infinite for a lost flight.
    """
    laws, runs = sizes.shape
    if runs < runs_needed(percentile):
        return laws * [Interval(np.nan, np.nan, np.nan)]
    ranks = ranks_of(percentile_with_lost(np.sort(sizes, axis=1), percentile))
    if runs < FEWEST:
        return [Interval(float(rank), np.nan, np.nan) for rank in ranks]
    generator = np.random.default_rng(0)
    most = max(1, MOST_AT_ONCE // (laws * runs))
    found = []
    for begin in range(0, RESAMPLES, most):
        drawn = generator.integers(runs, size=(min(most, RESAMPLES - begin), runs))
        resampled = np.sort(sizes[:, drawn], axis=2)
        found.append(ranks_of(percentile_with_lost(resampled, percentile)))
    missed = 50.0 * (1.0 - CONFIDENCE)
    # A bound is the rank of a resample: nothing is interpolated between ranks.
    lower = np.percentile(
        np.concatenate(found, axis=1), missed, axis=1, method="inverted_cdf"
    )
    upper = np.percentile(
        np.concatenate(found, axis=1), 100.0 - missed, axis=1, method="inverted_cdf"
    )
    return [
        Interval(*map(float, each)) for each in zip(ranks, lower, upper, strict=True)
    ]
