"""Linear covariance analysis: standard deviations of outputs from derivatives of a flight.

The outputs are assumed to be linear in the draws, so that their standard deviations follow
from the Jacobian. A flight that ends at the first of several end conditions is linear for
each condition, with a corner where two conditions are met at once. A nominal flight that is
planned for its target meets two conditions at once, and so lies on such a corner. So does
its law, which plans each flight for the end that it expects. Each condition has its linear
model about the mean of the draws that end by it, where the law plans for this end.
"""

import dataclasses
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._setup import needs_float64
from ..campaign.batch import LANES
from ..campaign.campaign import check_draws
from ..campaign.dispersions import Dispersion, check_dispersions
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..flight.scenario_checks import checked
from ..flight.solver import AbstractSolver, FixedStep
from ..tuning.batch_gradients import Outputs
from .linear_models import (
    LinearModel,
    Pairs,
    choosing_of,
    columns_of,
    draw_many,
    ending_by,
    fly_draws,
    in_deviations,
    linear_model,
    mean_model,
)


_FIRST = 4 * LANES
"""Number of flights that show by which conditions flights end, and with which draws"""
_SAMPLED = 100_000
"""Number of draws for which the linear models are evaluated, without flights"""


@dataclasses.dataclass(frozen=True)
class Spread:
    """Mean and standard deviation of one output, by linear models and by Monte Carlo."""

    nominal: float
    """Value of the nominal flight, at the mean of all dispersions"""
    mean: float
    """Predicted mean; `standard_deviation` is predicted as well"""
    standard_deviation: float
    flown_mean: float
    """Mean of the Monte Carlo. `flown_mean`, `flown_standard_deviation` and `ratio` are NaN
    without a Monte Carlo"""
    flown_standard_deviation: float
    ratio: float
    """Predicted standard deviation over that of the Monte Carlo, for the same draws, so
    that its difference from one is not a sampling error"""


@dataclasses.dataclass(frozen=True)
class Effect:
    """Effect of one standard deviation of one dispersion on one output."""

    linear: float
    """Predicted effect: half of the difference of the output between one standard deviation
    above and one below the mean"""
    error: float
    """Standard error of `linear`, the largest of all end conditions; zero for exact
    derivatives"""
    flown: float
    """Effect in two flights: half of the difference of their outputs"""
    bend: float
    """Nonlinearity: the mean output of these two flights minus the nominal output"""


@dataclasses.dataclass(frozen=True)
class LinearCovariance:
    """Predicted means and standard deviations of outputs, and tests of linearity."""

    models: dict[str, LinearModel]
    """Linear models for the end conditions that end dispersed flights, by end condition"""
    spreads: dict[str, Spread]
    """Means and standard deviations by output"""
    effects: dict[str, dict[str, Effect]]
    """Effects by output and dispersion"""
    runs: int
    """Number of finite flights of the Monte Carlo"""
    failed: int
    """Number of flights of the Monte Carlo that are not finite"""
    without_model: dict[str, float]
    """Share of the flights that end by a condition without a linear model, by end
    condition. The flight at the mean of the draws that end by it does not meet such a
    condition, or too few pairs of flights do with `mode="difference"`"""
    choosing: tuple[str, ...] = ()
    """Dispersions of numbers that only choose, such as the seed of noise. No output is
    linear in them: the prediction leaves their effect out, and their slopes are zero"""


@needs_float64
def linear_covariance(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    outputs: Outputs = misses,
    *,
    key: Key[Array, ""] | None = None,
    runs: int = 0,
    solver: AbstractSolver = FixedStep(),
    mode: str | None = None,
) -> LinearCovariance:
    """Predict the standard deviations of outputs, with an optional Monte Carlo to compare.

    The prediction uses the mean and standard deviation of each dispersion, and the joint
    distribution of their draws. 256 flights show which conditions end them. Further
    flights, one standard deviation above and below the mean of each dispersion, show how
    linear the flight is.

    **Arguments:**

    - `outputs`: function of scenario and flight that returns numbers, such as `misses`.
    - `key`, `runs`: random key and size of the Monte Carlo; none is flown if `runs` is 0.
    - `mode`: "exact" (the default, also None) uses the derivatives of one flight for each
        end condition, in forward mode: that with the mean of the draws that end by it.
        "difference" uses mean slopes over two standard deviations of these draws, for
        flights whose outputs jump, see `linear_models`; it costs at most 128 flights for
        each dispersion and end condition.

    **Raises:** `ValueError` as `monte_carlo` does, and for a nominal flight that is not
    finite.

        analysis = linear_covariance(scenario, dispersions)
        analysis.spreads["downrange"].standard_deviation
    """
    scenario = checked(scenario)
    if not dispersions:
        raise ValueError("nothing is dispersed: give dispersions")
    check_dispersions(scenario, dispersions)
    if runs and (runs < 2 or key is None):
        raise ValueError(f"runs is {runs}: give 2 or more with a key, or 0 for none")
    if mode not in (None, "exact", "difference"):
        raise ValueError(f'mode is {mode!r}: it must be "exact" or "difference"')
    key = jax.random.key(0) if key is None else key
    pairs = tuple(dispersions.items())
    of_first = jax.random.fold_in(key, 2)
    axes = _along_axes(pairs)
    parts = [{name: np.array([point[name] for point in axes]) for name in dispersions}]
    for of_part, count in ((key, runs), (of_first, _FIRST)):
        if not count:
            continue
        check_draws(scenario, dispersions, of_part, np.arange(count))
        parts.append(dict(draw_many(pairs, of_part, jnp.arange(count))))
    points = {
        name: np.concatenate([np.asarray(part[name]) for part in parts])
        for name in dispersions
    }
    values, _, codes, finite = fly_draws(scenario, pairs, points, outputs, solver)
    columns = {
        name: np.where(finite, np.asarray(x, float), np.nan)
        for name, x in columns_of(values).items()
    }
    if not finite[0]:
        raise ValueError(
            "the flight at the mean of all draws is not finite or has no end: it has no "
            "derivatives"
        )

    models, without_model = {}, {}
    first = np.arange(finite.size) >= finite.size - _FIRST
    ends = np.unique(codes[finite])
    for code in ends:
        name = scenario.termination.names[int(code)]
        ended = finite & (codes == code)
        ended = ended & first if np.any(ended & first) else ended
        of_end = {n: x[ended] for n, x in points.items()}
        about = {n: (0.0, 1.0) for n in dispersions}
        if len(ends) > 1:
            standard = in_deviations(pairs, of_end)
            about = {
                n: (float(np.mean(x)), float(np.std(x))) for n, x in standard.items()
            }
        if mode == "difference":
            others = {n: x[:LANES] for n, x in of_end.items()}
            model = mean_model(scenario, name, pairs, outputs, solver, others, about)
        else:
            centre = {n: x for n, (x, _) in about.items()}
            alone = ending_by(scenario, name)
            model = linear_model(alone, pairs, outputs, solver, name, centre)
        if model is None:
            without_model[name] = float(np.mean(codes[finite] == code))
        else:
            models[name] = model
    if not models:
        raise ValueError(
            f"the end conditions {list(without_model)} end flights, and none of them has a "
            "linear model: give smaller dispersions"
        )

    of_runs = np.arange(len(axes), len(axes) + runs)
    kept = of_runs[finite[of_runs]]
    sampled = _through(
        models,
        in_deviations(
            pairs, draw_many(pairs, jax.random.fold_in(key, 1), jnp.arange(_SAMPLED))
        ),
    )
    same = _through(
        models, in_deviations(pairs, {n: x[kept] for n, x in points.items()})
    )
    spreads, effects = {}, {}
    for name, column in columns.items():
        enough = kept.size > 1
        spread = float(np.std(column[kept], ddof=1)) if enough else np.nan
        predicted = float(np.std(same[name], ddof=1)) if enough else np.nan
        spreads[name] = Spread(
            nominal=float(column[0]),
            mean=float(np.mean(sampled[name])),
            standard_deviation=float(np.std(sampled[name])),
            flown_mean=float(np.mean(column[kept])) if enough else np.nan,
            flown_standard_deviation=spread,
            ratio=predicted / spread if spread > 0.0 else np.nan,
        )
        effects[name] = {}
        for place, dispersion in enumerate(dispersions):
            above, below = column[1 + 2 * place], column[2 + 2 * place]
            unit = {d: np.zeros(2) for d in dispersions}
            unit[dispersion] = np.array([1.0, -1.0])
            up, down = _through(models, unit)[name]
            effects[name][dispersion] = Effect(
                linear=float(0.5 * (up - down)),
                error=max(m.errors[name][dispersion] for m in models.values()),
                flown=float(0.5 * (above - below)),
                bend=float(0.5 * (above + below) - column[0]),
            )
    failed = int(of_runs.size - kept.size)
    return LinearCovariance(
        models,
        spreads,
        effects,
        int(kept.size),
        failed,
        without_model,
        choosing_of(scenario, pairs),
    )


def _along_axes(pairs: Pairs) -> list[dict[str, float]]:
    """The mean of all draws, then one standard deviation above and below for each."""
    moments = {
        name: tuple(float(x) for x in d.distribution.moments()) for name, d in pairs
    }
    mean = {name: m for name, (m, _) in moments.items()}
    points = [mean]
    for name, (m, deviation) in moments.items():
        points += [mean | {name: m + deviation}, mean | {name: m - deviation}]
    return points


def _through(
    models: dict[str, LinearModel], standard: Mapping[str, Float[np.ndarray, " n"]]
) -> dict[str, np.ndarray]:
    """Outputs for draws in standard deviations, by the model that ends the flight first."""

    def linear(value, slope):
        return value + sum(slope[name] * x for name, x in standard.items())

    times = np.stack([linear(m.time, m.time_slope) for m in models.values()])
    first = np.argmin(times, axis=0)
    outputs = next(iter(models.values())).values
    return {
        name: np.choose(
            first, [linear(m.values[name], m.slopes[name]) for m in models.values()]
        )
        for name in outputs
    }
