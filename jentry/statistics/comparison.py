"""Comparison of two campaigns: differences of statistics, paired where the draws agree."""

import dataclasses
import functools
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._printed import in_words
from ..addresses import nearest
from ..campaign.outputs import edge_of, is_error, is_output
from ..campaign.populations import finite_flights
from .intervals import (
    CONFIDENCE,
    FEWEST,
    MOST_AT_ONCE,
    RESAMPLES,
    Interval,
    share_bound,
)
from .summary import END_STATE


if TYPE_CHECKING:
    import xarray


PERCENTILE = 95.0
"""Percentile that is compared, besides mean and standard deviation"""


class TooFewFlights(ValueError):
    """A campaign has fewer than two finite flights to compare."""


def words(name: str) -> str:
    """Printed name of an output, between bars if its magnitude is compared."""
    return f"|{in_words(name)}|" if is_error(name) else in_words(name)


def quantity(name: str) -> str:
    """Name of an output in files, between bars if its magnitude is compared."""
    return f"|{name}|" if is_error(name) else name


@dataclasses.dataclass(frozen=True)
class Difference:
    """Differences of the statistics of one output, second campaign minus first, SI."""

    name: str
    """Name of the output. Errors are compared by their magnitude"""
    unit: str
    shown_unit: str
    shown_size: float
    first: float
    """Mean of the first campaign"""
    second: float
    """Mean of the second campaign"""
    mean: Interval
    """Difference of the means, with its interval. The next two are alike"""
    standard_deviation: Interval
    percentile: Interval
    smaller: Interval | None
    """Share of the pairs in which the second value is smaller. Pairs of equal values count
    as one half. None if the runs are not paired"""

    @property
    def words(self) -> str:
        """Printed name of the output, between bars if its magnitude is compared."""
        return words(self.name)

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values, SI."""
        return {
            "quantity": quantity(self.name),
            "unit": self.unit,
            "first_mean": self.first,
            "second_mean": self.second,
            "mean": self.mean._asdict(),
            "standard_deviation": self.standard_deviation._asdict(),
            f"percentile_{PERCENTILE:.10g}": self.percentile._asdict(),
            "smaller": None if self.smaller is None else self.smaller._asdict(),
        }


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Comparison of a second campaign with a first."""

    paired: bool
    """Whether run i of both campaigns has the same draw"""
    why: str
    """Why the runs are paired, or why they are not"""
    flights: tuple[int, int]
    """Numbers of finite flights of the first and the second that are compared"""
    left_out: int
    """Pairs with a flight that is not finite or, without pairs, such flights"""
    differences: list[Difference]
    only_one: list[str]
    """Outputs that only one of the campaigns has"""
    beyond: int
    """Runs of either campaign that have no partner. 0 without pairs"""
    spread: bool
    """Whether a sampler has spread the runs of a campaign evenly: the intervals are
    too wide"""

    @property
    def runs(self) -> int:
        """Number of pairs or, without pairs, the smaller number of finite flights."""
        return min(self.flights)

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values, SI."""
        return {
            "paired": self.paired,
            "why": self.why,
            "runs": self.runs,
            "flights": list(self.flights),
            "left_out": self.left_out,
            "beyond": self.beyond,
            "spread_by_a_sampler": self.spread,
            "of_one_alone": self.only_one,
            "outputs": [each.plain() for each in self.differences],
        }


def compared(
    first: "xarray.Dataset",
    second: "xarray.Dataset",
    outputs: Sequence[str] | None = None,
) -> Comparison:
    """Compare the outputs of two campaigns.

    The flights are paired if run i of both has the same inputs to the last bit. The effect
    of the common draws then cancels in the differences. Inputs that only one campaign has,
    such as those of a law, do not count. At least one input must be common and vary.

    The intervals are percentiles of a bootstrap. It resamples pairs or, without pairs, the
    runs of each campaign separately. The bounds are NaN for fewer than `FEWEST` flights.

    **Arguments:**

    - `outputs`: names of the outputs to compare. The default is all that both have.

    **Raises:** `TooFewFlights`, a `ValueError`, if there are fewer than two pairs of finite
    flights or, without pairs, fewer than two finite flights in a campaign. `ValueError` for
    an output that neither has.
    """
    first, second = (x.drop_dims("time", errors="ignore") for x in (first, second))
    paired, why = are_pairs(first, second)
    flown = [finite_flights(first), finite_flights(second)]
    partners = len(common_runs(first, second))
    if paired:
        common = common_runs(*flown)
        flown = [x.sel(run=common) for x in flown]
        left_out = partners - len(common)
    else:
        left_out = sum(x.sizes["run"] for x in (first, second))
        left_out -= sum(x.sizes["run"] for x in flown)
    if min(x.sizes["run"] for x in flown) < 2:
        raise TooFewFlights(
            "a comparison takes two finite flights of each campaign, or two pairs: there "
            f"are {flown[0].sizes['run']} and {flown[1].sizes['run']}"
        )
    known = [[n for n in map(str, x.data_vars) if is_output(n)] for x in flown]
    if outputs is None:
        names = [[n for n in each if n not in END_STATE] for each in known]
    else:
        for unknown in sorted({*outputs} - {*known[0], *known[1]})[:1]:
            told = nearest(unknown, dict.fromkeys([*known[0], *known[1]]))
            raise ValueError(f"no campaign has the output {unknown}; {told}")
        names = [[n for n in each if n in outputs] for each in known]
    both = [name for name in names[0] if name in names[1]]
    return Comparison(
        paired=paired,
        why=why,
        flights=(flown[0].sizes["run"], flown[1].sizes["run"]),
        left_out=left_out,
        differences=[_difference(flown[0], flown[1], name, paired) for name in both],
        only_one=sorted({*names[0], *names[1]} - set(both)),
        beyond=first.sizes["run"] + second.sizes["run"] - 2 * partners if paired else 0,
        spread=any(
            "sampler" in json.loads(x.attrs.get("campaign", "{}"))
            for x in (first, second)
        ),
    )


def are_pairs(first: "xarray.Dataset", second: "xarray.Dataset") -> tuple[bool, str]:
    """Whether run i of both campaigns has the same draw, and why or why not.

    Runs are identified by their number, not by their position.
    """
    inputs = [
        {str(n) for n, x in runs.data_vars.items() if "." in str(n)}
        for runs in (first, second)
    ]
    both = common_runs(first, second)
    if not both.size:
        return False, "they have no run in common"
    first, second = first.sel(run=both), second.sel(run=both)
    # An input that is equal in all runs does not identify pairs.
    common = [
        address
        for address in sorted(inputs[0] & inputs[1])
        if any(np.ptp(x[address].values) > 0.0 for x in (first, second))
    ]
    if not common:
        return False, "they have no input in common that varies"
    for address in common:
        one, other = (x[address].values for x in (first, second))
        if not np.array_equal(one, other):
            return False, f"{address} was drawn otherwise"
    number = "1 input is" if len(common) == 1 else f"{len(common)} inputs are"
    words = f"{number} the same in each run"
    alone = len(inputs[0] ^ inputs[1])
    return True, words + (f", {alone} are of one of them alone" if alone else "")


def common_runs(first: "xarray.Dataset", second: "xarray.Dataset") -> np.ndarray:
    """Numbers of the runs that both campaigns have."""
    return np.intersect1d(first["run"].values, second["run"].values)


def _difference(
    first: "xarray.Dataset", second: "xarray.Dataset", name: str, paired: bool
) -> Difference:
    values = [np.asarray(x[name].values, dtype=float) for x in (first, second)]
    if is_error(name):
        values = [np.abs(x) for x in values]
    one, other = values
    unit = first[name].attrs.get("units", "1")
    shown_unit, size = edge_of(first[name], np.concatenate(values))
    numbers = zip(_changes(one, other), *_bounds(one, other, paired), strict=True)
    found = [Interval(*map(float, each)) for each in numbers]
    return Difference(
        name=name,
        unit=unit,
        shown_unit=shown_unit,
        shown_size=size,
        first=float(one.mean()),
        second=float(other.mean()),
        mean=found[0],
        standard_deviation=found[1],
        percentile=found[2],
        smaller=_smaller(one, other) if paired else None,
    )


def _changes(one: np.ndarray, other: np.ndarray, axis: int = -1) -> np.ndarray:
    """Differences of mean, standard deviation and percentile, (3, ...)."""
    statistics = (
        np.mean,
        functools.partial(np.std, ddof=1),
        functools.partial(np.percentile, q=PERCENTILE),
    )
    return np.stack(
        [each(other, axis=axis) - each(one, axis=axis) for each in statistics]
    )


def _bounds(one: np.ndarray, other: np.ndarray, paired: bool) -> np.ndarray:
    """Bounds of the differences by a percentile bootstrap, (2, 3)."""
    if min(one.size, other.size) < FEWEST:
        return np.full((2, 3), np.nan)
    from scipy.stats import bootstrap  # takes a while

    drawn = bootstrap(
        (one, other),
        _changes,
        n_resamples=RESAMPLES,
        batch=max(1, MOST_AT_ONCE // max(one.size, other.size)),
        paired=paired,
        axis=-1,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    return np.array(drawn.confidence_interval)


def _smaller(one: np.ndarray, other: np.ndarray) -> Interval:
    """Share of the pairs in which the second is smaller, with Clopper-Pearson bounds."""
    runs = one.size
    smaller = float(np.sum(other < one) + 0.5 * np.sum(other == one))
    missed = 0.5 * (1.0 - CONFIDENCE)
    lower = 1.0 - share_bound(runs - smaller, runs, missed)
    return Interval(smaller / runs, lower, share_bound(smaller, runs, missed))
