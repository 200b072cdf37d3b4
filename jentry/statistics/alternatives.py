"""Several campaigns beside one another: a row of statistics each, and their differences."""

import csv
import dataclasses
import functools
import io
import itertools
import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..addresses import nearest
from ..campaign.outputs import MISS_DISTANCE, edge_of, is_error, is_output
from ..campaign.populations import finite_flights
from ..flight.termination import Outcome
from .comparison import Comparison, TooFewFlights, are_pairs, compared, quantity, words
from .intervals import CONFIDENCE, RESAMPLES
from .summary import END_STATE, without_nan


if TYPE_CHECKING:
    import xarray


PERCENTILES = (50.0, 95.0, 99.0)

_ROUNDING = 1e-6
"""SI: an error that is nowhere larger says nothing"""


@dataclasses.dataclass(frozen=True)
class Output:
    """What a column is of; of an error the magnitude counts."""

    name: str
    unit: str
    shown_unit: str
    shown_size: float
    """SI value of the unit in which people read it, the same for all campaigns"""

    @property
    def words(self) -> str:
        """What people call it; the magnitude between bars."""
        return words(self.name)


@dataclasses.dataclass(frozen=True)
class Levels:
    """How large one output of a campaign becomes, SI."""

    percentiles: dict[float, float]
    """Over all runs. One without a finite flight counts as larger than any number:
    infinite where the percentile is beyond the finite ones"""
    maximum: float
    """Of the finite flights; NaN where there is none"""


@dataclasses.dataclass(frozen=True)
class Alternative:
    """One campaign among several."""

    name: str
    runs: int
    failures: int
    """Runs that did not reach the end, or of which an output is not finite"""
    not_finite: int
    """Those of them that have no finite flight, see `finite_flights`"""
    outcomes: dict[Outcome, int]
    levels: dict[str, Levels]
    """By the names of the outputs"""


@dataclasses.dataclass(frozen=True)
class Alternatives:
    """Several campaigns, each as one row, and the differences between them."""

    outputs: list[Output]
    rows: list[Alternative]
    """In the order in which they were given: the first is what others are compared with"""
    same_draws: bool
    """Whether run i of each has the draws of run i of the first"""
    why: str
    """Why they have, or which of them has not and why"""
    beyond: int
    """Runs that not all of them have, and that are left out"""
    differences: dict[tuple[str, str], Comparison]
    """By the names of two campaigns: the second less the first"""
    untold: dict[tuple[str, str], str]
    """Pairs that have no differences, and why"""

    def plain(self) -> dict[str, Any]:
        """As plain values, SI; what is not finite is None."""
        return without_nan(
            {
                "same_draws": self.same_draws,
                "why": self.why,
                "runs_left_out": self.beyond,
                "alternatives": [self._plain_row(row) for row in self.rows],
                "intervals": {
                    "confidence": CONFIDENCE,
                    "method": f"percentiles of a bootstrap of {RESAMPLES} resamples",
                },
                "differences": [
                    {"first": one, "second": other, **found.plain()}
                    for (one, other), found in self.differences.items()
                ],
                "without_differences": [
                    {"first": one, "second": other, "why": why}
                    for (one, other), why in self.untold.items()
                ],
            }
        )

    def _plain_row(self, row: Alternative) -> dict[str, Any]:
        outcomes = {each.name.lower(): runs for each, runs in row.outcomes.items()}
        return {
            "name": row.name,
            "runs": row.runs,
            "failures": row.failures,
            "without_finite_flight": row.not_finite,
            "outcomes": outcomes,
            "statistics": [
                {
                    "quantity": quantity(output.name),
                    "unit": output.unit,
                    "percentiles": {
                        f"{p:.10g}": value
                        for p, value in row.levels[output.name].percentiles.items()
                    },
                    "maximum": row.levels[output.name].maximum,
                }
                for output in self.outputs
            ],
        }

    def as_json(self) -> str:
        """All of it, SI; null for a percentile beyond the finite flights."""
        return json.dumps(self.plain(), indent=2, allow_nan=False) + "\n"

    def as_csv(self) -> str:
        """The rows, SI, all digits: one line for each, a column for each statistic.

        A percentile beyond the finite flights is inf.
        """
        written = io.StringIO()
        table = csv.writer(written, lineterminator="\n")
        percentages = list(self.rows[0].levels[self.outputs[0].name].percentiles)
        statistics = [*(f"percentile_{p:.10g}" for p in percentages), "maximum"]
        heads = [
            f"{quantity(output.name)} {statistic} ({output.unit})"
            for output in self.outputs
            for statistic in statistics
        ]
        table.writerow(("alternative", "runs", "failures", "not_finite", *heads))
        for row in self.rows:
            levels = [row.levels[output.name] for output in self.outputs]
            numbers = [x for y in levels for x in (*y.percentiles.values(), y.maximum)]
            counts = row.runs, row.failures, row.not_finite
            table.writerow((row.name, *counts, *(repr(float(x)) for x in numbers)))
        return written.getvalue()


def alternatives_of(
    campaigns: "Mapping[str, xarray.Dataset]",
    outputs: Sequence[str] | None = None,
    percentiles: Sequence[float] = PERCENTILES,
    *,
    all_pairs: bool = False,
) -> Alternatives:
    """Campaigns beside one another: statistics of each, and their differences.

    Where all are of the same draws, the runs that all of them have are compared. A run
    without a finite flight counts as larger than any number in the percentiles, so that a
    law does not gain by the runs that it fails in.

    **Arguments:**

    - `campaigns`: results by what they are called; the first is what the others are
      compared with.
    - `outputs`: which; if not given, the miss distance and the errors that all have and
      that are more than rounding, or all outputs where there is no error. The differences
      are of all outputs then.
    - `percentiles`: above 0 and below 100.
    - `all_pairs`: whether each campaign is compared with each before it.

    **Raises:** `ValueError` for less than two campaigns, for a percentile that is none and
    for an output that one of them does not have.

        found = alternatives_of({"r5": open_campaign("r5"), "a8": open_campaign("a8")})
        print(found.as_csv())
    """
    if len(campaigns) < 2:
        raise ValueError(
            f"a comparison takes two campaigns: there are {len(campaigns)}"
        )
    for wrong in [p for p in percentiles if not 0.0 < p < 100.0][:1]:
        raise ValueError(
            f"the percentile is {wrong:g}: it must be above 0 and below 100"
        )
    results = {
        name: x.drop_dims("time", errors="ignore") for name, x in campaigns.items()
    }
    chosen = usual_outputs(results) if outputs is None else list(dict.fromkeys(outputs))
    if not chosen:
        raise ValueError("no output is to be compared: name one, or leave outputs out")
    for name, output in itertools.product(results, chosen):
        _require(results, name, output)
    first, *others = results
    found = {other: are_pairs(results[first], results[other]) for other in others}
    drawn_otherwise = [
        f"{name}: {why}" for name, (same, why) in found.items() if not same
    ]
    beyond, shared = 0, shared_runs(results)
    if not drawn_otherwise and not shared.size:
        drawn_otherwise = ["no run is in all of them"]
    if not drawn_otherwise:
        beyond = sum(x.sizes["run"] - shared.size for x in results.values())
        results = {name: x.sel(run=shared) for name, x in results.items()}
    differences, untold = {}, {}
    for one, other in itertools.combinations(results, 2):
        if one != first and not all_pairs:
            continue
        try:
            differences[one, other] = compared(results[one], results[other], outputs)
        except TooFewFlights as error:
            untold[one, other] = str(error)
    flown = {name: finite_flights(x) for name, x in results.items()}
    return Alternatives(
        outputs=[_output(list(flown.values()), name) for name in chosen],
        rows=[
            _row(name, results[name], flown[name], chosen, percentiles)
            for name in results
        ],
        same_draws=not drawn_otherwise,
        why="; ".join(drawn_otherwise) or found[others[0]][1],
        beyond=beyond,
        differences=differences,
        untold=untold,
    )


def shared_runs(campaigns: "Mapping[str, xarray.Dataset]") -> np.ndarray:
    """Numbers of the runs that all of them have."""
    return functools.reduce(
        np.intersect1d, (x["run"].values for x in campaigns.values())
    )


def usual_outputs(campaigns: "Mapping[str, xarray.Dataset]") -> list[str]:
    """Outputs by which campaigns are compared unless told otherwise.

    The miss distance and the errors that all have, if they are more than rounding in one
    of them; all outputs where there is none.
    """
    every = [set(map(str, results.data_vars)) for results in campaigns.values()]
    common = set.intersection(*every) - END_STATE
    order = map(str, next(iter(campaigns.values())).data_vars)
    names = [name for name in order if name in common and is_output(name)]
    spread = [
        name
        for name in names
        if any(float(abs(x[name]).max()) > _ROUNDING for x in campaigns.values())
    ]
    found = [name for name in spread if name == MISS_DISTANCE]
    found += [name for name in spread if is_error(name)]
    found = found or names
    if not found:
        raise ValueError("the campaigns have no output in common")
    return found


def _require(
    results: "Mapping[str, xarray.Dataset]", campaign: str, output: str
) -> None:
    known = [str(n) for n in results[campaign].data_vars if is_output(str(n))]
    if output not in known:
        raise ValueError(no_output(campaign, output, known))


def no_output(campaign: str, output: str, known: Sequence[str]) -> str:
    """Sentence about an output that a campaign does not have."""
    return f"{campaign} has no output {output}; {nearest(output, known)}"


def _sizes(results: "xarray.Dataset", name: str) -> np.ndarray:
    """Of an output; of an error the magnitudes."""
    values = np.asarray(results[name].values, dtype=float)
    return np.abs(values) if is_error(name) else values


def _output(flown: "Sequence[xarray.Dataset]", name: str) -> Output:
    variable = flown[0][name]
    together = np.concatenate([_sizes(x, name) for x in flown])
    return Output(name, variable.attrs.get("units", "1"), *edge_of(variable, together))


def _row(
    name: str,
    results: "xarray.Dataset",
    flown: "xarray.Dataset",
    outputs: Sequence[str],
    percentiles: Sequence[float],
) -> Alternative:
    codes, counts = np.unique(results["outcome"].values, return_counts=True)
    runs, finite = results.sizes["run"], flown.sizes["run"]
    reached = int(np.sum(flown["outcome"].values == Outcome.REACHED))
    levels = {}
    for output in outputs:
        ordered = np.sort(_sizes(flown, output))
        levels[output] = Levels(
            {p: _percentile(ordered, runs, p) for p in percentiles},
            float(ordered[-1]) if finite else np.nan,
        )
    return Alternative(
        name=name,
        runs=runs,
        failures=runs - reached,
        not_finite=runs - finite,
        outcomes={
            Outcome(int(code)): int(count)
            for code, count in zip(codes, counts, strict=True)
        },
        levels=levels,
    )


def _percentile(ordered: np.ndarray, runs: int, percentile: float) -> float:
    """Of so many runs, of which those that are not in rising order here lie above.

    Between two runs linearly, as numpy has it.
    """
    place = (runs - 1) * percentile / 100.0
    if not place <= ordered.size - 1:
        return np.inf
    return float(np.interp(place, np.arange(ordered.size), ordered))
