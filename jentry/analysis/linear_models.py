"""Linear models of a flight in its draws, by exact derivatives or by mean differences.

With a guidance cycle the errors at the end are a sawtooth function of the draws, because
the phase of the last cycle depends on them. The exact derivative is that of one tooth, and
may exceed the slope of the whole function by orders of magnitude. A mean slope is half the
difference between one standard deviation above and one below the mean, averaged over
flights in which all other inputs are drawn,

    E[f(+1, z) - f(-1, z)] / 2  =  the mean of df/dz1 over -1 < z1 < 1 and over z,

with jumps included. It has a standard error. It does not contain the teeth: only a Monte
Carlo shows the dispersion that they cause.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from .._programs import cached
from ..addresses import leaves_by_address
from ..campaign.batch import LANES, over_runs
from ..campaign.campaign import fly_run
from ..campaign.dispersions import Dispersion, disperse, draw
from ..flight.scenario import Scenario
from ..flight.termination import has_end
from ..tuning.batch_gradients import Outputs
from .sensitivities import named


Draws = Mapping[str, Any]
"""Draws by the name of the dispersion"""


@dataclasses.dataclass(frozen=True)
class LinearModel:
    """Linear model of time and outputs of flights that end by one condition."""

    time: float
    """Time at the end with the mean draws, s"""
    time_slope: dict[str, float]
    """Change of the time for one standard deviation, by dispersion, s"""
    values: dict[str, float]
    slopes: dict[str, dict[str, float]]
    """Change of an output for one standard deviation, by output and dispersion"""
    errors: dict[str, dict[str, float]]
    """Standard errors of the slopes; zero for exact derivatives"""


Pairs = tuple[tuple[str, Dispersion], ...]
"""Dispersions with their names in order; a dictionary loses its order under `jit`"""


@cached
def draw_many(pairs: Pairs, key: Key[Array, ""], runs: Array) -> Draws:
    return jax.vmap(lambda run: draw(dict(pairs), key, run))(runs)


def fly_draws(scenario, pairs: Pairs, draws: Draws, outputs, solver):
    """Outputs, time, code of the end condition, and whether it has an end, by draw."""
    return over_runs(_fly_draw, (scenario, pairs, outputs, solver), dict(draws))


def _fly_draw(shared, draws):
    scenario, pairs, outputs, solver = shared
    inputs = disperse(scenario, dict(pairs), draws)
    flight, dispersed = fly_run(scenario, inputs, solver)
    finite = has_end(flight.outcome)
    return outputs(dispersed, flight), flight.time, flight.ended_by, finite


def columns_of(values: Any) -> dict[str, np.ndarray]:
    columns = {
        named(n): np.asarray(column) for n, column in leaves_by_address(values).items()
    }
    for name, column in columns.items():
        if column.ndim != 1:
            raise ValueError(
                f"output {name} has shape {column.shape[1:]}: give single numbers"
            )
    return columns


def ending_by(scenario: Scenario, name: str) -> Scenario:
    """The scenario with only one of its end conditions."""
    termination = scenario.termination
    conditions = {n: c for n, c in termination.conditions.items() if n == name}
    alone = dataclasses.replace(termination, conditions=conditions)
    return dataclasses.replace(scenario, termination=alone)


def mean_model(
    alone: Scenario, pairs: Pairs, outputs: Outputs, solver, key
) -> LinearModel | None:
    """Linear model by differences over two standard deviations, averaged over other draws.

    None if for some dispersion the condition ends both flights of fewer than two pairs.
    """
    drawn = draw_many(pairs, key, jnp.arange(LANES))
    points, moving = [], []
    for name, dispersion in pairs:
        mean, deviation = dispersion.distribution.moments()
        if not deviation > 0.0:  # a constant
            continue
        moving.append(name)
        for value in (mean + deviation, mean - deviation):
            points.append({**drawn, name: jnp.full(LANES, value)})
    if not moving:
        raise ValueError("all dispersions are constant: nothing moves the flight")
    draws = jax.tree.map(lambda *x: np.concatenate(x), *points)
    flown = fly_draws(alone, pairs, draws, outputs, solver)
    shape = len(moving), 2, LANES
    values, time, code, finite = jax.tree.map(
        lambda x: x.reshape(*shape, *x.shape[1:]), flown
    )
    both = np.all((code == 0) & finite, axis=1)
    if np.any(np.sum(both, axis=1) < 2):
        return None
    columns = {named(n): np.asarray(x) for n, x in leaves_by_address(values).items()}
    columns[""] = time
    slopes = {n: dict.fromkeys(dict(pairs), 0.0) for n in columns}
    errors = {n: dict.fromkeys(dict(pairs), 0.0) for n in columns}
    for place, name in enumerate(moving):
        kept = both[place]
        for column, x in columns.items():
            each = 0.5 * (x[place, 0, kept] - x[place, 1, kept])
            slopes[column][name] = float(np.mean(each))
            errors[column][name] = float(np.std(each, ddof=1) / np.sqrt(len(each)))
    there = np.broadcast_to(both[:, None], shape)
    means = {n: float(np.mean(x[there])) for n, x in columns.items()}
    return LinearModel(
        time=means.pop(""),
        time_slope=slopes.pop(""),
        values=means,
        slopes=slopes,
        errors={n: error for n, error in errors.items() if n},
    )


def linear_model(
    alone: Scenario, pairs: Pairs, outputs: Outputs, solver, name: str
) -> LinearModel | None:
    """Linear model from exact derivatives; None if the nominal flight never meets the end.

    The flight ends by one condition only.
    """
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
        errors={n: dict.fromkeys(dict(pairs), 0.0) for n in by_output},
    )


@cached
def _linearize(scenario, pairs: Pairs, outputs, solver):
    moments = {name: d.distribution.moments() for name, d in pairs}

    def at(standard):
        draws = {n: mean + standard[n] * std for n, (mean, std) in moments.items()}
        inputs = disperse(scenario, dict(pairs), draws)
        flight, dispersed = fly_run(scenario, inputs, solver)
        looked_at = jax.tree.map(
            lambda x: jnp.asarray(x, float), outputs(dispersed, flight)
        )
        values = flight.time, looked_at
        return values, (values, flight.outcome, flight.ended_by)

    mean = {name: jnp.zeros(()) for name in moments}
    slopes, others = jax.jacfwd(at, has_aux=True)(mean)
    return slopes, *others
