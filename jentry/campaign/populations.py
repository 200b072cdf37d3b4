"""Populations: a statistic of many sets of runs, to judge that of one set.

Sets of runs with different draws differ. A statistic that a source prints for its one set
is compared with a population of sets of the same size. These are consecutive runs of one
campaign, which share no draw.
"""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np

from ..flight.termination import has_end
from .outputs import is_output


if TYPE_CHECKING:
    import xarray


def finite_flights(results: "xarray.Dataset") -> "xarray.Dataset":
    """The runs that count in statistics.

    Runs without an end (see `has_end`) are left out. So are runs with an output that is not
    finite, whatever their outcome.
    """
    finite = np.array(has_end(results["outcome"].values))
    for name in map(str, results.data_vars):
        if is_output(name):
            finite &= np.isfinite(results[name].values)
    return results.isel(run=np.flatnonzero(finite))


def sets_of(results: "xarray.Dataset", size: int) -> "list[xarray.Dataset]":
    """The finite flights of each complete set, without their histories.

    **Arguments:**

    - `results`: a stored campaign, in the order of its runs.
    - `size`: number of runs in a set. The first set has the runs 0 to size - 1.

    **Raises:** `ValueError` for a set without two finite flights.
    """
    ends = results.drop_dims("time", errors="ignore")
    sets = []
    for begin in range(0, ends.sizes["run"] - size + 1, size):
        flown = finite_flights(ends.isel(run=slice(begin, begin + size)))
        if flown.sizes["run"] < 2:
            raise ValueError(
                f"of the runs {begin} to {begin + size - 1}, {flown.sizes['run']} are "
                "finite: a statistic takes two or more"
            )
        sets.append(flown)
    return sets


class Population(eqx.Module):
    """One statistic of many sets of runs."""

    values: np.ndarray
    """The statistic of each set, shape (sets,)"""

    @property
    def mean(self) -> float:
        """Mean over the sets."""
        return float(np.mean(self.values))

    @property
    def spread(self) -> float:
        """Standard deviation over the sets, the uncertainty of one set."""
        return float(np.std(self.values, ddof=1))

    def deviations(self, value: float) -> float:
        """How many spreads a value is above the mean, or NaN if all sets are equal."""
        return (value - self.mean) / self.spread if self.spread > 0.0 else np.nan

    def below(self, value: float) -> int:
        """Number of sets whose statistic is below a value."""
        return int(np.sum(self.values < value))


def population(
    statistic: Callable[[Any], float], sets: "Iterable[xarray.Dataset]"
) -> Population:
    """The population of a statistic, a function of the variables of a set by name."""
    return Population(np.array([statistic(one) for one in sets]))
