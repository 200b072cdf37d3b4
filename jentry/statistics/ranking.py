"""Worst runs of a campaign by one output, and rank correlations with its inputs."""

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from ..addresses import nearest
from ..campaign.outputs import MISS_DISTANCE, is_error, is_output
from ..campaign.populations import finite_flights
from ..flight.termination import has_end
from .intervals import CONFIDENCE, Interval


if TYPE_CHECKING:
    import xarray


@dataclasses.dataclass(frozen=True)
class WorstRun:
    """One run, with the ranks of its inputs among all runs."""

    run: int
    value: float
    """Value of the output, SI; NaN for a flight without an end"""
    inputs: dict[str, float]
    """Inputs by address, SI"""
    ranks: dict[str, float]
    """Share of all runs whose input is less than that of this run, by address. Runs with an
    equal input count as one half"""


def ordered_by(results: "xarray.Dataset") -> str:
    """The default output for ranking runs.

    It is the miss distance if the results have one, or else their first error.

    **Raises:** `ValueError` if the results have no error.
    """
    if MISS_DISTANCE in results:
        return MISS_DISTANCE
    errors = [name for name in map(str, results.data_vars) if is_error(name)]
    if not errors:
        raise ValueError("the results have no error: say by what runs are the worst")
    return errors[0]


def require_output(results: "xarray.Dataset", name: str) -> None:
    """Raise `ValueError`, with the nearest names, if the results have no such output."""
    known = [str(n) for n in results.data_vars if is_output(str(n))]
    if name not in known:
        raise ValueError(f"the results have no output {name}; {nearest(name, known)}")


def inputs_of(results: "xarray.Dataset") -> dict[str, np.ndarray]:
    """Dispersed inputs of a stored campaign, by address."""
    return {
        str(name): values.values
        for name, values in results.data_vars.items()
        if "." in str(name) and values.dims == ("run",)
    }


def worst_runs(
    results: "xarray.Dataset", name: str, count: int, *, smallest: bool = False
) -> list[WorstRun]:
    """The runs with the largest values of an output, the worst first.

    Errors are compared by their magnitude. Flights without an end, and flights whose output
    is not finite, come before all others.

    **Arguments:**

    - `name`: the output.
    - `count`: number of runs.
    - `smallest`: whether the smallest values are the worst.

    **Raises:** `ValueError` if the results have no such output, and for a negative count.
    """
    require_output(results, name)
    if count < 0:
        raise ValueError(f"count is {count}: it must be zero or more")
    values = np.array(results[name].values, dtype=float)
    values[~np.asarray(has_end(results["outcome"].values))] = np.nan
    bad = np.abs(values) if is_error(name) else values
    bad = np.where(np.isfinite(values), -bad if smallest else bad, np.inf)
    # Runs with equal values remain in order.
    worst = np.argsort(-bad, kind="stable")[:count]
    inputs = inputs_of(results)
    ranks = {address: _ranks(x) for address, x in inputs.items()}
    return [
        WorstRun(
            run=int(results["run"].values[place]),
            value=float(values[place]) if np.isfinite(values[place]) else math.nan,
            inputs={address: float(x[place]) for address, x in inputs.items()},
            ranks={address: float(x[place]) for address, x in ranks.items()},
        )
        for place in worst
    ]


def rank_correlations(
    results: "xarray.Dataset", name: str
) -> tuple[dict[str, Interval], int]:
    """Spearman's rank correlations of an output with each input, and the number of flights.

    The strongest correlation is first. Only finite flights count. Inputs that are equal in
    all runs have no correlation and are left out. Inputs that only select something, such
    as the seed of noise, are left out as well. The intervals use Fisher's transformation
    with the variance 1.06 / (n - 3) (E. C. Fieller, H. O. Hartley and E. S. Pearson,
    Biometrika 44, 1957).

    **Arguments:**

    - `name`: the output. Bars select the magnitude: `|downrange_error|`.

    **Raises:** `ValueError` if the results have no such output.
    """
    bare = name.strip("|")
    require_output(results, bare)
    flown = finite_flights(results.drop_dims("time", errors="ignore"))
    values = flown[bare].values
    outputs = _ranks(np.abs(values) if name != bare else values)
    runs = outputs.size
    found = {}
    for address, x in inputs_of(flown).items():
        if flown[address].attrs.get("choice"):
            continue
        ranks = _ranks(x)
        if runs > 1 and np.ptp(ranks) > 0.0 and np.ptp(outputs) > 0.0:
            correlation = float(np.corrcoef(ranks, outputs)[0, 1])
            found[address] = _interval(correlation, runs)
    strongest = sorted(found.items(), key=lambda pair: -abs(pair[1].value))
    return dict(strongest), runs


def _interval(correlation: float, runs: int) -> Interval:
    from scipy.special import ndtri

    if runs <= 3:
        return Interval(correlation, math.nan, math.nan)
    inside = min(max(correlation, -1.0 + 1e-12), 1.0 - 1e-12)
    middle = math.atanh(inside)
    reach = float(ndtri(0.5 + 0.5 * CONFIDENCE)) * math.sqrt(1.06 / (runs - 3))
    return Interval(correlation, math.tanh(middle - reach), math.tanh(middle + reach))


def _ranks(values: np.ndarray) -> np.ndarray:
    """Share of the values less than each value, with equal values counted as one half."""
    # `scipy.stats.rankdata` takes 1.7 times as long, and 0.4 s to import. A NaN here has
    # the largest rank; there all ranks are NaN.
    _, places, counts = np.unique(values, return_inverse=True, return_counts=True)
    below = np.cumsum(counts) - counts
    return ((below + 0.5 * counts) / values.size)[places]
