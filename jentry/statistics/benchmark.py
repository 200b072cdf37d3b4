"""Statistics of the laws of one case of a benchmark, on the same draws."""

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..fields import units_of
from ..flight.miss import Misses
from .comparison import are_pairs
from .control_effort import ANGLE_OF_ATTACK, BANK, mean_rates, reversals
from .intervals import (
    CONFIDENCE,
    Interval,
    moment_intervals,
    percentile_interval,
    share_bound,
)
from .lost_flights import (
    MISS_OVER_GROUND,
    magnitudes,
    percentile_with_lost,
    runs_needed,
)
from .ranking import inputs_of
from .ranks import rank_intervals


if TYPE_CHECKING:
    import xarray


PERCENTILES = (50.0, 95.0, 99.0, 99.9)
"""Percentiles of the errors"""

RANKED = 95.0
"""Percentile by which the laws are ranked"""

FACTORS = np.geomspace(1.0, 100.0, 41)
"""Factors of the profiles of performance"""

FAILURES, BROKEN, NOMINAL = "failures", "limits_exceeded", "nominal"
BANK_RATE, ANGLE_RATE, REVERSALS = (
    "mean_bank_rate",
    "mean_angle_of_attack_rate",
    "bank_reversals",
)


def percentile_name(measure: str, percentile: float) -> str:
    """Name of a percentile of an error among the statistics."""
    return f"{measure}_percentile_{percentile:.10g}"


@dataclasses.dataclass(frozen=True)
class Statistic:
    """A statistic of all runs of a law and of each set, SI."""

    unit: str
    all_runs: Interval
    """Value for all runs, with its interval. Infinite if it is that of a lost flight"""
    sets: tuple[float, ...] = ()
    """Value for each set; empty if a set has too few runs for it"""
    needs: int | None = None
    """Least number of runs for this statistic if there are fewer. The value is then NaN"""

    @property
    def mean(self) -> float:
        """Mean over the sets: infinite if a set is, and NaN without sets."""
        return float(np.mean(self.sets)) if self.sets else np.nan

    @property
    def deviation(self) -> float:
        """Standard deviation over the sets; NaN for one set, or if a value is infinite."""
        if len(self.sets) < 2 or not np.all(np.isfinite(self.sets)):
            return np.nan
        return float(np.std(self.sets, ddof=1))


class Flown(NamedTuple):
    """Results of one law in a case."""

    results: "xarray.Dataset"
    histories: "xarray.Dataset"
    """Flights with histories; the last is the nominal flight"""


@dataclasses.dataclass(frozen=True)
class LawStatistics:
    """Statistics of one law in a case."""

    name: str
    statistics: dict[str, Statistic]
    rank: Interval
    """Rank by the percentile `RANKED` of the measure, with its interval"""
    shares: tuple[float, ...]
    """Share of the runs whose error is within each of `FACTORS` of the best law's error in
    that run"""
    draws: str
    """Digest of the inputs of all runs"""
    other_draws: str = ""
    """Why the draws are not those of the first law; empty if they are"""


def statistics_of_case(
    flown: Mapping[str, Flown], measure: str, resolution: float, sets: int
) -> list[LawStatistics]:
    """Statistics of all laws of a case, in the order of the mapping.

    A flight that did not reach the end of guided flight counts as worse than any other.

    **Arguments:**

    - `flown`: results by law, with equal numbers of runs: whole sets.
    - `measure`: the error by which the laws are ranked.
    - `resolution`: errors below it, SI, are equally good in `LawStatistics.shares`.
    - `sets`: number of sets of consecutive runs.
    """
    sizes = np.stack([magnitudes(each.results, measure) for each in flown.values()])
    shares = shares_within(sizes, resolution)
    first = next(iter(flown.values())).results
    found = []
    for i, (name, rank) in enumerate(
        zip(flown, rank_intervals(sizes, RANKED), strict=True)
    ):
        same, why = (True, "") if i == 0 else are_pairs(first, flown[name].results)
        found.append(
            LawStatistics(
                name=name,
                statistics=_statistics(flown[name], measure, sets),
                rank=rank,
                shares=tuple(map(float, shares[i])),
                draws=_digest_of_draws(flown[name].results),
                other_draws="" if same else why,
            )
        )
    return found


def shares_within(
    sizes: Float[np.ndarray, "laws runs"], resolution: float
) -> Float[np.ndarray, "laws factors"]:
    """Share of the runs in which a law is within each of `FACTORS` of the best law.

    This is the profile of performance of E. D. Dolan and J. J. More, "Benchmarking
    optimization software with performance profiles", Mathematical Programming 91, 2002.
    A lost flight is within no factor.

    **Arguments:**

    - `sizes`: errors by law and run, infinite for lost flights.
    - `resolution`: smaller errors count as equal to it.
    """
    floored = np.maximum(sizes, resolution)
    best = np.min(floored, axis=0)
    within = floored[..., None] <= best[:, None] * FACTORS * (1.0 + 1e-12)
    return np.mean(within & np.isfinite(floored)[..., None], axis=1)


def _statistics(flown: Flown, measure: str, sets: int) -> dict[str, Statistic]:
    results, histories = flown
    nominal = histories.isel(run=[-1])
    errors = [measure, *(n for n in _errors(results) if n != measure)]
    units = {name: _unit_of(results, name) for name in errors}
    found = {
        FAILURES: _share(~np.isfinite(magnitudes(results, measure)), sets),
        NOMINAL: Statistic(
            units[measure], _alone(float(magnitudes(nominal, measure)[0]))
        ),
    }
    for name in errors:
        sizes = magnitudes(results, name)
        for percentile in PERCENTILES:
            statistic = _percentile(sizes, percentile, sets, units[name])
            found[percentile_name(name, percentile)] = statistic
    found |= _limits(results, sets)
    dispersed = histories.isel(run=slice(0, -1))
    per_flight = {
        BANK_RATE: (mean_rates(dispersed, BANK), "rad/s"),
        ANGLE_RATE: (mean_rates(dispersed, ANGLE_OF_ATTACK), "rad/s"),
        REVERSALS: (reversals(dispersed), "1"),
    }
    found |= {
        name: Statistic(unit, _mean(values))
        for name, (values, unit) in per_flight.items()
    }
    return found


def _errors(results: "xarray.Dataset") -> list[str]:
    """Actual errors among the results, and the miss distance."""
    names = ["miss_distance", *(f"{each}_error" for each in units_of(Misses))]
    return [name for name in dict.fromkeys(names) if name in results]


def _unit_of(results: "xarray.Dataset", measure: str) -> str:
    name = "downrange_error" if measure == MISS_OVER_GROUND else measure
    return results[name].attrs.get("units", "1")


def _alone(value: float) -> Interval:
    return Interval(value, np.nan, np.nan)


def _in_sets(values: np.ndarray, sets: int) -> np.ndarray:
    """Values by set and run."""
    return values.reshape(sets, -1)


def _share(events: Bool[np.ndarray, " runs"], sets: int) -> Statistic:
    """Share of the runs with an event, with Clopper and Pearson's bounds."""
    runs, count = events.size, int(np.sum(events))
    missed = 0.5 * (1.0 - CONFIDENCE)
    lower = 1.0 - share_bound(runs - count, runs, missed)
    interval = Interval(count / runs, lower, share_bound(count, runs, missed))
    return Statistic(
        "1", interval, tuple(map(float, np.mean(_in_sets(events, sets), axis=1)))
    )


def _percentile(
    sizes: Float[np.ndarray, " runs"], percentile: float, sets: int, unit: str
) -> Statistic:
    needs = runs_needed(percentile)
    if sizes.size < needs:
        return Statistic(unit, _alone(np.nan), (), needs)
    ordered = np.sort(sizes)
    with np.errstate(invalid="ignore"):  # its value is not used, only the bounds
        bounds = percentile_interval(ordered, percentile)
    value = float(percentile_with_lost(ordered, percentile))
    of_sets = np.sort(_in_sets(sizes, sets), axis=1)
    each = ()
    if of_sets.shape[1] >= needs:
        each = tuple(map(float, percentile_with_lost(of_sets, percentile)))
    return Statistic(unit, Interval(value, bounds.lower, bounds.upper), each)


def limits_of(results: "xarray.Dataset") -> dict[str, float]:
    """Limits of the path constraints by the names of their peaks in results."""
    return {
        str(name): float(peak.attrs["limit"])
        for name, peak in results.data_vars.items()
        if str(name).startswith("peak_")
        and "limit" in peak.attrs
        and peak.dims == ("run",)
    }


def _limits(results: "xarray.Dataset", sets: int) -> dict[str, Statistic]:
    """Share of the runs beyond each limit and beyond any. A peak that is not finite is."""
    beyond = {
        name: ~(np.asarray(results[name].values) <= limit)
        for name, limit in limits_of(results).items()
    }
    if not beyond:
        return {}
    found = {BROKEN: _share(np.any(list(beyond.values()), axis=0), sets)}
    for name, events in beyond.items():
        found[f"{BROKEN}_{name.removeprefix('peak_')}"] = _share(events, sets)
    return found


def _mean(values: Float[np.ndarray, " runs"]) -> Interval:
    """Mean of the flights that have a value, with its interval."""
    known = values[np.isfinite(values)]
    if not known.size:
        return _alone(np.nan)
    return moment_intervals(known[None])[0][0]


def _digest_of_draws(results: "xarray.Dataset") -> str:
    digest = hashlib.sha256()
    for address, values in sorted(inputs_of(results).items()):
        digest.update(address.encode())
        digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()[:16]
