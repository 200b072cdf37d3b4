"""Two campaigns beside each other: differences of statistics, paired where draws agree."""

import dataclasses
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._printed import in_words
from ..addresses import nearest
from ..campaign.outputs import edge_of, is_error, is_output
from ..campaign.populations import finite_flights
from .intervals import CONFIDENCE, FEWEST, MOST_AT_ONCE, RESAMPLES, Interval
from .summary import END_STATE


if TYPE_CHECKING:
    import xarray


PERCENTILE = 95.0
"""That is compared, beside mean and standard deviation"""


class TooFewFlights(ValueError):
    """There are no two finite flights to compare."""


def words(name: str) -> str:
    """What people call an output that is compared; the magnitude between bars."""
    return f"|{in_words(name)}|" if is_error(name) else in_words(name)


def quantity(name: str) -> str:
    """An output that is compared in files, where names stay as they are."""
    return f"|{name}|" if is_error(name) else name


@dataclasses.dataclass(frozen=True)
class Difference:
    """One output of the second campaign less that of the first; SI."""

    name: str
    """Of the output; of what is an error the magnitude is compared"""
    unit: str
    shown_unit: str
    shown_size: float
    first: float
    """Mean of the first campaign"""
    second: float
    mean: Interval
    """Difference of the means, with its interval; the others likewise"""
    standard_deviation: Interval
    percentile: Interval
    smaller: Interval | None
    """Share of the runs in which the second has the smaller value, equal ones by half;
    None where the runs are no pairs"""

    @property
    def words(self) -> str:
        """What people call it; the magnitude between bars."""
        return words(self.name)

    def plain(self) -> dict[str, Any]:
        """As plain values, SI."""
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
    """The second of two campaigns beside the first."""

    paired: bool
    """Whether run i of one has the draws of run i of the other"""
    why: str
    """Why the runs are pairs, or why not"""
    flights: tuple[int, int]
    """Finite flights that are compared, of each"""
    left_out: int
    """Pairs of which a flight is not finite; or flights"""
    differences: list[Difference]
    only_one: list[str]
    """Outputs that one of them has and the other has not"""
    beyond: int
    """Runs of either campaign that have no partner; 0 without pairs"""
    spread: bool
    """Whether a sampler has spread the runs of one of them: the intervals are too wide"""

    @property
    def runs(self) -> int:
        """Pairs of finite flights; or the smaller number of finite flights."""
        return min(self.flights)

    def plain(self) -> dict[str, Any]:
        """As plain values, SI."""
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
    """The outputs of one campaign beside those of another.

    Where run i of one has the same inputs as run i of the other, to the last bit, the
    flights are pairs: what the draws have in common falls out of the differences. Inputs
    that only one of them has, as a law's own, do not count; there must be a common one.
    Intervals are percentiles of a bootstrap that draws pairs, or, without pairs, the runs
    of each campaign by themselves; without bounds where there are fewer than `FEWEST`.

    **Arguments:**

    - `outputs`: which of those that both have; all if not given.

    **Raises:** `TooFewFlights`, a `ValueError`, for campaigns of which one has no two
    finite flights; `ValueError` for an output that neither has.
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
    """Whether run i of both has the same draws, and why or why not.

    Runs are known by their number, wherever they stand.
    """
    inputs = [
        {str(n) for n, x in runs.data_vars.items() if "." in str(n)}
        for runs in (first, second)
    ]
    both = common_runs(first, second)
    if not both.size:
        return False, "they have no run in common"
    first, second = first.sel(run=both), second.sel(run=both)
    # What is the same in all runs makes no pairs.
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
    """Numbers of the runs that both have."""
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
    drawn = _resampled(one, other, paired)
    here = _statistics(other[None]) - _statistics(one[None])
    tails = 50.0 * (1.0 - CONFIDENCE), 50.0 * (1.0 + CONFIDENCE)
    bounds = np.percentile(drawn, tails, axis=1)
    if min(one.size, other.size) < FEWEST:
        bounds[:] = np.nan
    found = [
        Interval(float(value), float(low), float(high))
        for value, low, high in zip(here[:, 0], *bounds, strict=True)
    ]
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


def _statistics(values: np.ndarray) -> np.ndarray:
    """Mean, standard deviation and percentile of samples (samples, runs): (3, samples)."""
    return np.stack(
        [
            values.mean(axis=1),
            values.std(axis=1, ddof=1),
            np.percentile(values, PERCENTILE, axis=1),
        ]
    )


def _resampled(one: np.ndarray, other: np.ndarray, paired: bool) -> np.ndarray:
    """Differences of the statistics of resamples, (3, resamples)."""
    generator = np.random.default_rng(0)
    most = max(1, MOST_AT_ONCE // max(one.size, other.size))
    found = []
    for begin in range(0, RESAMPLES, most):
        many = min(most, RESAMPLES - begin)
        places = generator.integers(one.size, size=(many, one.size))
        others = (
            places
            if paired
            else generator.integers(other.size, size=(many, other.size))
        )
        found.append(_statistics(other[others]) - _statistics(one[places]))
    return np.concatenate(found, axis=1)


def _smaller(one: np.ndarray, other: np.ndarray) -> Interval:
    """Share of the pairs in which the second is smaller: Clopper and Pearson's interval."""
    from scipy.special import betaincinv

    runs = one.size
    smaller = float(np.sum(other < one) + 0.5 * np.sum(other == one))
    missed = 0.5 * (1.0 - CONFIDENCE)
    lower = betaincinv(smaller, runs - smaller + 1.0, missed) if smaller > 0.0 else 0.0
    upper = (
        betaincinv(smaller + 1.0, runs - smaller, 1.0 - missed)
        if smaller < runs
        else 1.0
    )
    return Interval(smaller / runs, float(lower), float(upper))
