"""Summary of a campaign: outcomes, limits, caveats, statistics, misses, requirements."""

import csv
import dataclasses
import io
import json
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._printed import in_words
from ..campaign.outputs import (
    at_end,
    is_error,
    is_of_navigation,
    is_output,
    navigated,
    shown,
    unit_size,
)
from ..campaign.populations import finite_flights
from ..fields import units_of
from ..flight.termination import Outcome
from ..motion.state import EntryState
from .acceptance import Requirement, Verdict, judged
from .filter_consistency import Consistency, consistency_of
from .intervals import (
    CONFIDENCE,
    METHODS,
    Interval,
    moment_intervals,
    percentile_interval,
)
from .miss_ellipse import MissEllipse, ellipse_of


if TYPE_CHECKING:
    import xarray


PERCENTILES = (1.0, 5.0, 50.0, 95.0, 99.0)
"""Default percentiles of each output"""

RADII = (50.0, 90.0, 99.0)
"""Percentages of the circular errors and of the ellipses"""

END_STATE = {
    at_end(name)
    for component in units_of(EntryState)
    for name in (component, navigated(component))
}
"""Outputs without statistics here: the errors of the end state replace them"""


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Statistics of one output over the finite flights, SI."""

    name: str
    magnitude: bool
    """Whether the statistics are those of the magnitude of an error"""
    unit: str
    shown_unit: str
    shown_size: float
    """SI value of the printed unit"""
    minimum: float
    maximum: float
    mean: Interval
    standard_deviation: Interval
    percentiles: dict[float, Interval]

    @property
    def words(self) -> str:
        """Printed name of the output, between bars if it is a magnitude."""
        words = in_words(self.name)
        return f"|{words}|" if self.magnitude else words

    def plain(self) -> dict[str, Any]:
        """Dictionary of plain values, SI."""
        return {
            "quantity": f"|{self.name}|" if self.magnitude else self.name,
            "unit": self.unit,
            "minimum": self.minimum,
            "maximum": self.maximum,
            "mean": self.mean._asdict(),
            "standard_deviation": self.standard_deviation._asdict(),
            "percentiles": {
                f"{p:.10g}": interval._asdict()
                for p, interval in self.percentiles.items()
            },
        }


@dataclasses.dataclass(frozen=True)
class Caveat:
    """Reason to doubt some of the runs: see `Flight.caveats`."""

    flights: int
    """Number of runs with the caveat"""
    largest_share: float
    """Largest share in a run"""
    largest_distance: float | None = None
    """Largest distance beyond the table in a run. None if the caveat is not of a table"""
    unit: str | None = None
    """Unit of the distance"""


@dataclasses.dataclass(frozen=True)
class Limit:
    """Limit of a path constraint, and the number of flights that exceed it."""

    name: str
    limit: float
    unit: str
    shown_unit: str | None
    """Printed unit of the same number, such as g"""
    beyond: int
    """Number of finite flights that exceed the limit"""


@dataclasses.dataclass(frozen=True)
class Summary:
    """Numbers of a campaign. Other modules print, write and draw them."""

    campaign: dict[str, Any]
    """Mission, law, case, worlds, seed and versions, as far as the results state them"""
    runs: int
    finite: int
    """Number of flights in the statistics: they have an end, and all outputs are finite"""
    outcomes: dict[Outcome, tuple[int, int]]
    """For each outcome: number of runs, and how many of them the statistics leave out"""
    limits: list[Limit]
    caveats: dict[str, Caveat]
    """Caveats of the decisions of the law and of time beyond tables, by name"""
    statistics: list[Statistics]
    ellipse: MissEllipse | None
    verdicts: list[Verdict]
    counted_from: str | None = None
    """Description of the origin of downrange and crossrange errors"""
    navigation_filter: Consistency | None = None
    """Consistency of the navigation filter at the ends; None without a filter"""

    @property
    def of_navigation(self) -> str | None:
        """Text that describes the errors of the navigation; None if it is perfect."""
        if any(is_of_navigation(each.name) for each in self.statistics):
            return (
                "believed: errors that the vehicle would report, believed minus desired; "
                "navigation: believed minus actual"
            )
        return None

    @property
    def caution(self) -> str | None:
        """Warning about the intervals if the runs were not drawn independently, or None."""
        sampler = self.campaign.get("sampler")
        if sampler is None:
            return None
        whole = sampler.get("runs", self.runs)
        if whole != self.runs:
            return (
                f"these are {self.runs} of the {whole} runs that the sampler spreads "
                "together: their statistics are neither those of independent draws nor "
                "those of all runs"
            )
        return (
            "the intervals are those of independent draws: runs of a sampler that spreads "
            "them evenly have statistics that vary less than these say"
        )

    def as_json(self) -> str:
        """The summary as JSON, SI. Numbers that are not finite are null."""
        contents = {
            "campaign": self.campaign,
            "runs": self.runs,
            "finite_flights": self.finite,
            "outcomes": {
                outcome.name.lower(): {"runs": runs, "left_out": left_out}
                for outcome, (runs, left_out) in self.outcomes.items()
            },
            "limits": [dataclasses.asdict(limit) for limit in self.limits],
            "caveats": {
                name: dataclasses.asdict(caveat)
                for name, caveat in self.caveats.items()
            },
            "intervals": {
                "confidence": CONFIDENCE,
                **METHODS,
                "caution": self.caution,
            },
            "statistics": [each.plain() for each in self.statistics],
            "miss_ellipse": None if self.ellipse is None else self.ellipse.plain(),
            "requirements": [verdict.plain() for verdict in self.verdicts],
            "navigation_filter": None
            if self.navigation_filter is None
            else self.navigation_filter.plain(),
        }
        return json.dumps(without_nan(contents), indent=2, allow_nan=False) + "\n"

    def as_csv(self) -> str:
        """The statistics as CSV, SI: a line for each statistic, with its bounds."""
        written = io.StringIO()
        table = csv.writer(written, lineterminator="\n")
        table.writerow(("quantity", "unit", "statistic", "value", "lower", "upper"))
        for each in self.statistics:
            told = each.plain()
            start = told["quantity"], told["unit"]
            rows: list[tuple[str, Interval]] = [
                ("minimum", Interval(each.minimum, np.nan, np.nan)),
                ("maximum", Interval(each.maximum, np.nan, np.nan)),
                ("mean", each.mean),
                ("standard_deviation", each.standard_deviation),
            ]
            rows += [(f"percentile_{p:.10g}", x) for p, x in each.percentiles.items()]
            for name, numbers in rows:
                cells = ("" if math.isnan(x) else repr(float(x)) for x in numbers)
                table.writerow((*start, name, *cells))
        return written.getvalue()


def summarize(
    results: "xarray.Dataset",
    percentiles: Sequence[float] = PERCENTILES,
    requirements: Iterable[Requirement] = (),
    *,
    sequential: bool = False,
) -> Summary:
    """Summarize the runs of a campaign.

    **Arguments:**

    - `results`: all runs, as returned by `open_campaign`.
    - `percentiles`: percentiles of each output, above 0 and below 100.
    - `requirements`, `sequential`: as for `judged`.

    **Raises:** `ValueError` for a percentile outside of these limits, and for a requirement
    that cannot be judged.

        summary = summarize(open_campaign("results/mars-drag-tracking"))
        print(summary.as_csv())
    """
    flown = finite_flights(results.drop_dims("time", errors="ignore"))
    outcomes = results["outcome"].values
    kept = np.isin(results["run"].values, flown["run"].values)
    counts = {
        Outcome(int(code)): (
            int(np.sum(outcomes == code)),
            int(np.sum((outcomes == code) & ~kept)),
        )
        for code in np.unique(outcomes)
    }
    return Summary(
        campaign=_described(results),
        runs=results.sizes["run"],
        finite=flown.sizes["run"],
        outcomes=counts,
        limits=_limits(flown),
        caveats={
            str(name): _caveat(str(name), results)
            for name, shares in results.data_vars.items()
            if shares.attrs.get("caveat") and np.any(shares > 0.0)
        },
        statistics=_statistics(flown, percentiles),
        ellipse=ellipse_of(flown, RADII),
        verdicts=[judged(results, r, sequential=sequential) for r in requirements],
        counted_from=_counted_from(results),
        navigation_filter=consistency_of(flown),
    )


def _described(results: "xarray.Dataset") -> dict[str, Any]:
    """Description of the campaign in the results, without the scenario."""
    described = json.loads(results.attrs.get("campaign", "{}"))
    told = (
        "mission",
        "law",
        "case",
        "world",
        "variant",  # the name in earlier versions
        "seed",
        "sampler",
        "solver",
        "xla_options",
        "dispersions",
    )
    return {name: described[name] for name in (*told, "versions") if name in described}


def _counted_from(results: "xarray.Dataset") -> str | None:
    for name in ("downrange_error", "crossrange_error"):
        if name in results:
            return results[name].attrs.get("counted_from")
    return None


def _caveat(name: str, results: "xarray.Dataset") -> Caveat:
    shares = results[name]
    told = int(np.sum(shares > 0.0)), float(np.nanmax(shares))
    for distances in results.data_vars.values():
        if distances.attrs.get("distance_of") == name:
            unit = distances.attrs["units"]
            return Caveat(*told, float(np.nanmax(distances)), unit)
    return Caveat(*told)


def _limits(flown: "xarray.Dataset") -> list[Limit]:
    return [
        Limit(
            str(name),
            float(peaks.attrs["limit"]),
            peaks.attrs["units"],
            peaks.attrs.get("shown_units"),
            int(np.sum(peaks.values > peaks.attrs["limit"])),
        )
        for name, peaks in flown.data_vars.items()
        if "limit" in peaks.attrs and peaks.dims == ("run",)
    ]


def _statistics(
    flown: "xarray.Dataset", percentiles: Sequence[float]
) -> list[Statistics]:
    if flown.sizes["run"] == 0:
        return []
    names = [name for name in map(str, flown.data_vars) if is_output(name)]
    asked: list[tuple[str, bool]] = []
    for name in names:
        if name not in END_STATE:
            asked.append((name, False))
            if is_error(name):
                asked.append((name, True))
    values = {
        (name, magnitude): np.abs(flown[name].values)
        if magnitude
        else flown[name].values
        for name, magnitude in asked
    }
    if not values:
        return []
    moments = moment_intervals(np.stack(list(values.values())).astype(float))
    found = []
    for (name, magnitude), (mean, deviation) in zip(asked, moments, strict=True):
        ordered = np.sort(values[name, magnitude])
        _, shown_unit = shown(flown[name])
        found.append(
            Statistics(
                name=name,
                magnitude=magnitude,
                unit=flown[name].attrs.get("units", "1"),
                shown_unit=shown_unit,
                shown_size=unit_size(flown[name]),
                minimum=float(ordered[0]),
                maximum=float(ordered[-1]),
                mean=mean,
                standard_deviation=deviation,
                percentiles={p: percentile_interval(ordered, p) for p in percentiles},
            )
        )
    return found


def without_nan(value: Any) -> Any:
    """Replace numbers that are not finite by None in plain values."""
    if isinstance(value, dict):
        return {key: without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
