"""Standard deviations of the misses from one flight and its derivatives.

Linear covariance analysis: the outputs are linear in the draws, so their standard
deviations follow from the Jacobian. A flight that ends at the first of several conditions
is linear for each of them, and bent where they change places: a nominal flight that meets
two at once, as one that is planned for its target does, is on that bend.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from .._addresses import leaves_by_address
from ..campaign.dispersions import Dispersion, check_dispersions, disperse, draw
from ..campaign.monte_carlo import LANES, filled_up, fly_run, over_runs
from ..flight.misses import misses
from ..flight.scenario import Scenario, check
from ..flight.solver import AbstractSolver, FixedStep
from ..flight.termination import Termination, has_end
from .batch_gradient import Outputs
from .sensitivity import named


_SAMPLED = 100_000
"""Draws that are put through the linear models; no flights"""


Draws = Mapping[str, Any]
"""By the name of the dispersion"""


@dataclasses.dataclass(frozen=True)
class LinearModel:
    """Time and outputs of the flight that ends by one condition, about the mean draws."""

    time: float
    """s"""
    time_slope: dict[str, float]
    """Per standard deviation of a dispersion"""
    values: dict[str, float]
    slopes: dict[str, dict[str, float]]
    """By output and dispersion, per standard deviation"""


@dataclasses.dataclass(frozen=True)
class Spread:
    """Of one output."""

    nominal: float
    """At the mean of all draws"""
    mean: float
    """Predicted, like the next"""
    standard_deviation: float
    flown_mean: float
    """Of the Monte Carlo; NaN if none was flown, like the next two"""
    flown_standard_deviation: float
    ratio: float
    """Predicted standard deviation over the flown one, for the same draws: what is left
    is not the luck of the draws"""


@dataclasses.dataclass(frozen=True)
class Effect:
    """Of one dispersion on one output, for one standard deviation of the dispersion."""

    linear: float
    """Half of the difference from one below to one above, as predicted"""
    flown: float
    """The same, flown"""
    bend: float
    """How far the mean of the two is from the nominal, flown: what is not linear"""


@dataclasses.dataclass(frozen=True)
class LinearCovariance:
    """Predicted spread of the outputs, and how linear the flight is."""

    models: dict[str, LinearModel]
    """By the end condition: those that end flights of these dispersions"""
    spreads: dict[str, Spread]
    """By output"""
    effects: dict[str, dict[str, Effect]]
    """By output and dispersion"""
    runs: int
    """Of the Monte Carlo beside it, finite ones"""
    failed: int
    """And those that are not finite"""
    without_model: dict[str, float]
    """Share of the flights by end conditions that the nominal flight does not meet, and
    of which nothing is predicted"""


def linear_covariance(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    outputs: Outputs = misses,
    *,
    key: Key[Array, ""] | None = None,
    runs: int = 0,
    solver: AbstractSolver = FixedStep(),
) -> LinearCovariance:
    """Predict the standard deviations of outputs, with a Monte Carlo beside it on request.

    Each dispersion is independent and enters by its mean and standard deviation. One
    more batch, a standard deviation above and below for each, shows how linear the
    flight is and which conditions end it.

    **Arguments:**

    - `outputs`: a function of scenario and flight, such as `misses`, to numbers.
    - `key`, `runs`: of the Monte Carlo; none is flown if `runs` is 0.

    **Raises:** `ValueError` as `monte_carlo` does, and for a nominal flight that is not
    finite.

        analysis = linear_covariance(scenario, dispersions)
        analysis.spreads["downrange"].standard_deviation
    """
    check(scenario)
    if not dispersions:
        raise ValueError("nothing is dispersed: give dispersions")
    check_dispersions(scenario, dispersions)
    if runs and (runs < 2 or key is None):
        raise ValueError(f"runs is {runs}: give 2 or more with a key, or 0 for none")
    devices = len(jax.devices())
    key = jax.random.key(0) if key is None else key
    pairs = tuple(dispersions.items())

    axes = _along_axes(pairs)
    drawn = _draws(pairs, key, jnp.arange(max(runs, LANES)))
    points = {
        name: np.concatenate([[point[name] for point in axes], np.asarray(values)])
        for name, values in drawn.items()
    }
    count = len(axes) + max(runs, LANES)
    filled = filled_up(np.arange(count), devices)
    given = {name: jnp.asarray(values[filled]) for name, values in points.items()}
    flown = _fly_draws(scenario, pairs, given, outputs, solver, devices)
    values, codes, finite = jax.tree.map(lambda x: x[:count], flown)
    columns = {name: np.asarray(x) for name, x in _columns(values).items()}
    codes, finite = np.asarray(codes), np.asarray(finite)
    if not finite[0]:
        raise ValueError(
            "the flight at the mean of all draws is not finite or has no end: it has no "
            "derivatives"
        )

    models, without_model = {}, {}
    for code in np.unique(codes[finite]):
        name = scenario.termination.names[int(code)]
        model = _linear_model(scenario, pairs, outputs, solver, name)
        if model is None:
            without_model[name] = float(np.mean(codes[finite] == code))
        else:
            models[name] = model
    if not models:
        raise ValueError("the nominal flight meets none of the end conditions alone")

    of_runs = np.arange(len(axes), len(axes) + runs)
    kept = of_runs[finite[of_runs]]
    sampled = _through(
        models,
        _standard(
            pairs, _draws(pairs, jax.random.fold_in(key, 1), jnp.arange(_SAMPLED))
        ),
    )
    same = _through(models, _standard(pairs, {n: x[kept] for n, x in points.items()}))
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
                flown=float(0.5 * (above - below)),
                bend=float(0.5 * (above + below) - column[0]),
            )
    failed = int(of_runs.size - kept.size)
    return LinearCovariance(
        models, spreads, effects, int(kept.size), failed, without_model
    )


Pairs = tuple[tuple[str, Dispersion], ...]
"""Dispersions in their order, which a dictionary loses under `jit`"""


def _along_axes(pairs: Pairs) -> list[dict[str, float]]:
    """The mean draws, then one standard deviation above and below for each dispersion."""
    moments = {
        name: tuple(float(x) for x in d.distribution.moments()) for name, d in pairs
    }
    mean = {name: m for name, (m, _) in moments.items()}
    points = [mean]
    for name, (m, deviation) in moments.items():
        points += [mean | {name: m + deviation}, mean | {name: m - deviation}]
    return points


@eqx.filter_jit
def _draws(pairs: Pairs, key: Key[Array, ""], runs: Array) -> Draws:
    return jax.vmap(lambda run: draw(dict(pairs), key, run))(runs)


@eqx.filter_jit
def _fly_draws(scenario, pairs: Pairs, draws: Draws, outputs, solver, devices: int):
    """Outputs, code of the end condition and whether it has one, for all draws."""

    def one(shared, draws):
        scenario, pairs = shared
        inputs = disperse(scenario, dict(pairs), draws)
        flight, aimed = fly_run(scenario, inputs, solver)
        return outputs(aimed, flight), flight.ended_by, has_end(flight.outcome)

    return over_runs(one, (scenario, pairs), draws, devices)


def _columns(values: Any) -> dict[str, Array]:
    columns = {
        named(name): column for name, column in leaves_by_address(values).items()
    }
    for name, column in columns.items():
        if column.ndim != 1:
            raise ValueError(
                f"output {name} has shape {column.shape[1:]}: give single numbers"
            )
    return columns


def _linear_model(
    scenario: Scenario, pairs: Pairs, outputs: Outputs, solver, name: str
) -> LinearModel | None:
    """Of the flight that only this condition ends; none if it never meets it."""
    termination = scenario.termination
    conditions = {n: c for n, c in termination.conditions.items() if n == name}
    alone = dataclasses.replace(
        scenario, termination=Termination(conditions, termination.time_limit)
    )
    slopes, values, outcome, ended_by = _linearize(alone, pairs, outputs, solver)
    met = alone.termination.names[int(ended_by)] == name
    if not met or not has_end(int(outcome)):
        return None
    time, columns = values
    time_slope, slope_columns = slopes
    by_output = {named(n): leaf for n, leaf in leaves_by_address(columns).items()}
    flat = jax.tree.structure(columns).flatten_up_to(slope_columns)
    return LinearModel(
        time=float(time),
        time_slope={d: float(s) for d, s in time_slope.items()},
        values={n: float(value) for n, value in by_output.items()},
        slopes={
            n: {d: float(s) for d, s in by_dispersion.items()}
            for n, by_dispersion in zip(by_output, flat, strict=True)
        },
    )


@eqx.filter_jit
def _linearize(scenario, pairs: Pairs, outputs, solver):
    moments = {name: d.distribution.moments() for name, d in pairs}

    def at(standard):
        draws = {n: mean + standard[n] * std for n, (mean, std) in moments.items()}
        inputs = disperse(scenario, dict(pairs), draws)
        flight, aimed = fly_run(scenario, inputs, solver)
        looked_at = jax.tree.map(
            lambda x: jnp.asarray(x, float), outputs(aimed, flight)
        )
        values = flight.time, looked_at
        return values, (values, flight.outcome, flight.ended_by)

    mean = {name: jnp.zeros(()) for name in moments}
    slopes, others = jax.jacfwd(at, has_aux=True)(mean)
    return slopes, *others


def _standard(pairs: Pairs, draws: Draws) -> dict[str, np.ndarray]:
    """Draws in standard deviations from their mean."""
    standard = {}
    for name, dispersion in pairs:
        mean, deviation = (float(x) for x in dispersion.distribution.moments())
        standard[name] = (np.asarray(draws[name]) - mean) / deviation
    return standard


def _through(
    models: dict[str, LinearModel], standard: Mapping[str, Float[np.ndarray, " n"]]
) -> dict[str, np.ndarray]:
    """Outputs for draws in standard deviations from their mean: by the first to end."""

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
