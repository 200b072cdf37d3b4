"""Linear models of a flight in its draws, by exact derivatives or by mean differences.

With a guidance cycle the errors at the end are a sawtooth function of the draws, because
the phase of the last cycle depends on them. The exact derivative is that of one tooth, and
may exceed the slope of the whole function by orders of magnitude. A mean slope is half the
difference between one standard deviation above and one below the mean, averaged over
flights in which all other inputs are drawn,

    E[f(+1, z) - f(-1, z)] / 2  =  the mean of df/dz1 over -1 < z1 < 1 and over z,

with jumps included. It has a standard error. It does not contain the teeth: only a Monte
Carlo shows the dispersion that they cause.

If several end conditions end the flights, each has a model of its own, about the mean of
the draws that end by it. The mean of all draws would be the wrong place: there a law may
plan its flight for another end than the one of the model.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from .._programs import cached
from ..addresses import field_metadata, leaves_by_address
from ..campaign.batch import over_runs
from ..campaign.campaign import fly_run
from ..campaign.dispersions import (
    Dispersion,
    addresses_of_dispersion,
    disperse,
    draw,
)
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..flight.termination import has_end
from ..tuning.batch_gradients import Outputs
from .sensitivities import named


Draws = Mapping[str, Any]
"""Draws by the name of the dispersion"""


@dataclasses.dataclass(frozen=True)
class LinearModel:
    """Linear model of time and outputs of flights that end by one condition."""

    time: float
    """Time at the end with the mean of all draws, by this model, s"""
    time_slope: dict[str, float]
    """Change of the time for one standard deviation, by dispersion, s"""
    values: dict[str, float]
    """Outputs with the mean of all draws, by this model"""
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


def in_deviations(pairs: Pairs, draws: Draws) -> dict[str, np.ndarray]:
    """Draws in standard deviations from their mean."""
    standard = {}
    for name, dispersion in pairs:
        mean, deviation = (float(x) for x in dispersion.distribution.moments())
        # All draws of a constant equal its mean.
        away = np.asarray(draws[name]) - mean
        standard[name] = away / deviation if deviation > 0.0 else 0.0 * away
    return standard


def choosing_of(scenario: Scenario, pairs: Pairs) -> tuple[str, ...]:
    """Names of the dispersions of numbers that only choose, such as the seed of noise."""
    return tuple(
        name
        for name, dispersion in pairs
        if any(
            field_metadata(scenario, address).get("choice")
            for address in addresses_of_dispersion(scenario, name, dispersion)
        )
    )


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
    scenario: Scenario,
    name: str,
    pairs: Pairs,
    outputs: Outputs,
    solver: AbstractSolver,
    others: Draws,
    about: Mapping[str, tuple[float, float]],
) -> LinearModel | None:
    """Linear model by differences, averaged over other draws, for one end condition.

    None if for some dispersion the condition ends both flights of fewer than two pairs.

    **Arguments:**

    - `name`: the end condition.
    - `others`: draws of the inputs that are not moved, of flights that end by `name`.
    - `about`: centre and half width of the differences by dispersion, in standard
        deviations from the mean.
    """
    moments = {n: tuple(float(x) for x in d.distribution.moments()) for n, d in pairs}
    chooses = choosing_of(scenario, pairs)
    moving = [n for n, (_, size) in moments.items() if size > 0.0 and n not in chooses]
    if not moving:
        raise ValueError(
            "all dispersions are constant, or choose: nothing moves the flight"
        )
    count = next(iter(others.values())).size
    if count < 2:
        return None
    points = []
    for n in moving:
        mean, deviation = moments[n]
        centre, width = about[n]
        for standard in (centre + width, centre - width):
            value = mean + standard * deviation
            points.append({**others, n: np.full(count, value)})
    draws = {n: np.concatenate([point[n] for point in points]) for n in others}
    flown = fly_draws(scenario, pairs, draws, outputs, solver)
    shape = len(moving), 2, count
    values, time, code, finite = jax.tree.map(
        lambda x: x.reshape(*shape, *x.shape[1:]), flown
    )
    by_name = code == scenario.termination.names.index(name)
    both = np.all(by_name & finite, axis=1)
    if np.any(np.sum(both, axis=1) < 2):
        return None
    columns = {named(n): np.asarray(x) for n, x in leaves_by_address(values).items()}
    columns[""] = time
    slopes = {n: dict.fromkeys(moments, 0.0) for n in columns}
    errors = {n: dict.fromkeys(moments, 0.0) for n in columns}
    for place, dispersion in enumerate(moving):
        kept, (_, width) = both[place], about[dispersion]
        for column, x in columns.items():
            each = 0.5 * (x[place, 0, kept] - x[place, 1, kept]) / width
            slopes[column][dispersion] = float(np.mean(each))
            error = np.std(each, ddof=1) / np.sqrt(len(each))
            errors[column][dispersion] = float(error)
    there = np.broadcast_to(both[:, None], shape)
    means = {}
    for column, x in columns.items():
        away = sum(
            slopes[column][n] * np.mean(x_of[there.ravel()])
            for n, x_of in in_deviations(pairs, draws).items()
        )
        means[column] = float(np.mean(x[there]) - away)
    return LinearModel(
        time=means.pop(""),
        time_slope=slopes.pop(""),
        values=means,
        slopes=slopes,
        errors={n: error for n, error in errors.items() if n},
    )


def linear_model(
    alone: Scenario,
    pairs: Pairs,
    outputs: Outputs,
    solver: AbstractSolver,
    name: str,
    centre: Mapping[str, float],
) -> LinearModel | None:
    """Linear model from exact derivatives; None if the flight at `centre` never ends.

    **Arguments:**

    - `alone`: scenario whose only end condition is `name`.
    - `centre`: draws of the flight with the derivatives, in standard deviations from the
        mean.
    """
    standard = {n: jnp.asarray(x, float) for n, x in centre.items()}
    found = _linearize(alone, pairs, outputs, solver, standard)
    slopes, values, outcome, ended_by = found
    met = alone.termination.names[int(ended_by)] == name
    if not met or not has_end(int(outcome)):
        return None
    time, columns = values
    time_slope, slope_columns = slopes
    by_output = {named(n): leaf for n, leaf in leaves_by_address(columns).items()}
    flat = jax.tree.structure(columns).flatten_up_to(slope_columns)
    slopes_of = {
        n: {d: float(s) for d, s in by_dispersion.items()}
        for n, by_dispersion in zip(by_output, flat, strict=True)
    }
    time_slopes = {d: float(s) for d, s in time_slope.items()}

    def at_mean(value, slope: Mapping[str, float]) -> float:
        return float(value) - sum(slope[d] * x for d, x in centre.items())

    return LinearModel(
        time=at_mean(time, time_slopes),
        time_slope=time_slopes,
        values={n: at_mean(value, slopes_of[n]) for n, value in by_output.items()},
        slopes=slopes_of,
        errors={n: dict.fromkeys(dict(pairs), 0.0) for n in by_output},
    )


@cached
def _linearize(scenario, pairs: Pairs, outputs, solver, centre):
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

    slopes, others = jax.jacfwd(at, has_aux=True)(centre)
    return slopes, *others
