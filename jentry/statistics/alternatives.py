"""Comparison of several campaigns: a row of statistics for each, and differences."""

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
from ..campaign.outputs import (
    MISS_DISTANCE,
    edge_of,
    is_error,
    is_of_navigation,
    is_output,
)
from ..campaign.populations import finite_flights
from ..flight.termination import Outcome
from .comparison import Comparison, TooFewFlights, are_pairs, compared, quantity, words
from .intervals import CONFIDENCE, RESAMPLES
from .lost_flights import percentile_with_lost
from .summary import END_STATE, without_nan


if TYPE_CHECKING:
    import xarray


PERCENTILES = (50.0, 95.0, 99.0)
"""Default percentiles of each output"""

_ROUNDING = 1e-6
"""Errors that are nowhere larger than this, SI, are not compared by default"""


@dataclasses.dataclass(frozen=True)
class Output:
    """Output of a column. Errors are compared by their magnitude."""

    name: str
    unit: str
    shown_unit: str
    shown_size: float
    """SI value of the printed unit, which is equal for all campaigns"""

    @property
    def words(self) -> str:
        """Printed name of the output, between bars if its magnitude is compared."""
        return words(self.name)


@dataclasses.dataclass(frozen=True)
class Levels:
    """Percentiles and maximum of one output of a campaign, SI."""

    percentiles: dict[float, float]
    """Percentiles over all runs. A run without a finite flight counts as larger than any
    number. A percentile among such runs is infinite"""
    maximum: float
    """Maximum of the finite flights. NaN if there is none"""


@dataclasses.dataclass(frozen=True)
class Alternative:
    """One campaign of several, with its statistics."""

    name: str
    runs: int
    failures: int
    """Runs that did not reach the end of guided flight, or with an output that is not
    finite"""
    not_finite: int
    """Failures that are not among the `finite_flights`"""
    outcomes: dict[Outcome, int]
    levels: dict[str, Levels]
    """Levels by the names of the outputs"""


@dataclasses.dataclass(frozen=True)
class Alternatives:
    """Comparison of several campaigns: a row for each, and differences between them."""

    outputs: list[Output]
    rows: list[Alternative]
    """Campaigns in the order of the call. The others are compared with the first"""
    same_draws: bool
    """Whether run i of each campaign has the draw of run i of the first"""
    why: str
    """Why they have the same draws, or which campaign has other draws and why"""
    beyond: int
    """Runs that are left out because not all campaigns have them"""
    differences: dict[tuple[str, str], Comparison]
    """Comparisons by the names of two campaigns, second minus first"""
    untold: dict[tuple[str, str], str]
    """Reasons, by the names of two campaigns, why there is no comparison"""

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values, SI. Numbers that are not finite are None."""
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
        """The comparison as JSON, SI. A percentile beyond the finite flights is null."""
        return json.dumps(self.plain(), indent=2, allow_nan=False) + "\n"

    def as_csv(self) -> str:
        """The rows as CSV, SI, with all digits: a column for each statistic.

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
    """Compare several campaigns: statistics of each, and differences.

    If all campaigns have the same draws, only the runs that all of them have are compared.
    A run without a finite flight counts as larger than any number in the percentiles: a law
    does not gain from runs in which it fails.

    **Arguments:**

    - `campaigns`: results by name. The others are compared with the first.
    - `outputs`: names of the outputs to compare. By default the rows have the miss distance
      and the errors, if all campaigns have them and they exceed rounding, or all outputs if
      there is no such error. The differences then have all outputs.
    - `percentiles`: percentiles of each output, above 0 and below 100.
    - `all_pairs`: whether each campaign is compared with every campaign before it, and not
      with the first only.

    **Raises:** `ValueError` for fewer than two campaigns, for a percentile outside of these
    limits, and for an output that one of them does not have.

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
    """Numbers of the runs that all campaigns have."""
    return functools.reduce(
        np.intersect1d, (x["run"].values for x in campaigns.values())
    )


def usual_outputs(campaigns: "Mapping[str, xarray.Dataset]") -> list[str]:
    """Outputs that are compared by default.

    They are the miss distance and the actual errors that all campaigns have and that exceed
    rounding in one of them. If there is none, they are all common outputs.

    **Raises:** `ValueError` if the campaigns have no output in common.
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
    found += [n for n in spread if is_error(n) and not is_of_navigation(n)]
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
    """Message about an output that a campaign does not have, with the nearest names."""
    return f"{campaign} has no output {output}; {nearest(output, known)}"


def _sizes(results: "xarray.Dataset", name: str) -> np.ndarray:
    """Values of an output, or the magnitudes of an error."""
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
        every = np.append(ordered, np.full(runs - finite, np.inf))
        levels[output] = Levels(
            {p: float(percentile_with_lost(every, p)) for p in percentiles},
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
