"""Judge a tuned scenario against the one before: the exact law, on the same new draws."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Key

from .._programs import kept
from ..addresses import field_metadata, leaves_by_address
from ..analysis.sensitivities import named
from ..campaign.batch import LANES
from ..campaign.campaign import drawn_inputs
from ..campaign.dispersions import Dispersion
from ..flight.scenario import Scenario
from .batch_gradients import Loss, Simulation, batch_outputs, where_finite


_RESAMPLES = 1000
_CONFIDENCE = (2.5, 97.5)
"""Percent"""

_NUDGE = 1.0 + 4.0 * np.finfo(float).eps
"""Factor on draws and entry velocity, to see what rounding does to a statistic"""

_ROUNDINGS = 10.0
"""Of a statistic, as far as it is seen in a few flights"""


class Estimate(eqx.Module):
    """A statistic of a sample with its 95 % confidence interval."""

    value: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One statistic before and after, over the same draws."""

    quantity: str
    statistic: str
    before: Estimate
    after: Estimate
    change: Estimate
    """After minus before, run by run: narrower than the two intervals let expect. The
    interval is that of the bootstrap, wider on both sides by ten times what rounding
    does to the statistic: a difference of rounding is none"""

    @property
    def lower(self) -> bool:
        """Whether it became smaller, beyond the confidence interval."""
        return self.change.high < 0.0


@dataclasses.dataclass(frozen=True)
class Judgement:
    """How two scenarios compare on draws that neither has seen."""

    runs: int
    """Finite ones, with both"""
    not_finite_before: int
    not_finite_after: int
    comparisons: tuple[Comparison, ...]
    """None if fewer than two runs are finite"""

    def __getitem__(self, name: tuple[str, str]) -> Comparison:
        """The comparison of a quantity and a statistic, such as `"downrange", "std"`.

        That of the loss is `"loss", ""`, and comes first.
        """
        for comparison in self.comparisons:
            if (comparison.quantity, comparison.statistic) == name:
                return comparison
        known = [f"{c.quantity}, {c.statistic}" for c in self.comparisons]
        raise KeyError(f"no comparison {name}: there are {'; '.join(known)}")


_STATISTICS: Mapping[str, Callable[[Array], Array]] = {
    "std": lambda x: jnp.std(x, ddof=1),
    "95 % of |.|": lambda x: jnp.percentile(jnp.abs(x), 95.0),
    "mean": jnp.mean,
}


def judge(
    before: Scenario,
    after: Scenario,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: int,
    loss: Loss,
    simulation: Simulation,
) -> Judgement:
    """Fly both with the same draws, and compare loss and outputs with intervals.

    The intervals are those of a bootstrap over the runs, 95 %. What rounding does is seen
    in the first flights, flown again with draws and an entry velocity that differ in their
    last digits.
    """
    flown: list[tuple[Any, np.ndarray]] = []
    rounding: dict[str, float] = {}
    for scenario in (before, after):
        inputs = drawn_inputs(scenario, dispersions, key, np.arange(runs))
        values, finite = batch_outputs(simulation, scenario, inputs)
        flown.append((values, finite))
        again, finite_again = batch_outputs(simulation, *_nudged(scenario, inputs))
        both = finite[:LANES] & finite_again
        first = jax.tree.map(lambda x: x[:LANES], values)
        pair = where_finite(first, both), where_finite(again, both)
        for name, size in _rounding(pair, loss, bool(both.any())).items():
            rounding[name] = max(size, rounding.get(name, 0.0))
    (values_before, finite_before), (values_after, finite_after) = flown
    both = finite_before & finite_after
    comparisons = []
    if both.sum() >= 2:
        pair = where_finite(values_before, both), where_finite(values_after, both)
        losses, resampled = _resampled(pair, loss, int(both.sum()))
        comparisons.append(_comparison("loss", "", losses, rounding.get("loss", 0.0)))
        for quantity in _columns(pair[0]):
            for statistic in _STATISTICS:
                found = resampled[quantity][statistic]
                size = rounding.get(quantity, 0.0)
                comparisons.append(_comparison(quantity, statistic, found, size))
    return Judgement(
        runs=int(both.sum()),
        not_finite_before=int(runs - finite_before.sum()),
        not_finite_after=int(runs - finite_after.sum()),
        comparisons=tuple(comparisons),
    )


def _nudged(
    scenario: Scenario, inputs: Mapping[str, np.ndarray]
) -> tuple[Scenario, dict[str, np.ndarray]]:
    """The scenario, and the inputs of the first flights, in other last digits.

    What only chooses, as one profile of an ensemble, stays: another is another flight.
    """
    chooses = {a: bool(field_metadata(scenario, a).get("choice")) for a in inputs}
    nudged = {
        a: x[:LANES] if chooses[a] else _NUDGE * x[:LANES] for a, x in inputs.items()
    }
    velocity = lambda scenario: scenario.initial_state.velocity
    return eqx.tree_at(velocity, scenario, _NUDGE * velocity(scenario)), nudged


def _rounding(pair: tuple[Any, Any], loss: Loss, some: bool) -> dict[str, float]:
    """Of the loss, and of the outputs that are one number: the largest of a flight."""
    if not some:
        return {}
    found = {"loss": abs(float(loss(pair[0]) - loss(pair[1])))}
    columns = [_columns(outputs) for outputs in pair]
    for name, values in columns[0].items():
        found[name] = float(jnp.max(jnp.abs(values - columns[1][name])))
    return found


def _comparison(
    quantity: str, statistic: str, found: tuple[Any, Any], rounding: float
) -> Comparison:
    before, after = (np.asarray(x) for x in found)
    change = _estimate(after - before)
    wider = _ROUNDINGS * rounding
    change = Estimate(change.value, change.low - wider, change.high + wider)
    return Comparison(quantity, statistic, _estimate(before), _estimate(after), change)


def _estimate(values: np.ndarray) -> Estimate:
    """The first is of the sample itself, the others of what is drawn from it."""
    low, high = np.percentile(values[1:], _CONFIDENCE)
    return Estimate(float(values[0]), float(low), float(high))


@kept
def _resampled(pair: tuple[Any, Any], loss: Loss, count: int) -> tuple[Any, Any]:
    """Losses, and statistics by quantity: of the sample, then of draws from it."""

    def of_sample(key):
        drawn = jax.random.randint(key, (count,), 0, count)
        return statistics(drawn)

    def statistics(chosen):
        sample = jax.tree.map(lambda x: x[chosen], pair)
        columns = [_columns(outputs) for outputs in sample]
        found = {
            name: {
                label: tuple(statistic(column[name]) for column in columns)
                for label, statistic in _STATISTICS.items()
            }
            for name in columns[0]
        }
        return tuple(loss(outputs) for outputs in sample), found

    first = statistics(jnp.arange(count))
    keys = jax.random.split(jax.random.key(0), _RESAMPLES)
    others = lax.map(of_sample, keys)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, others)


def _columns(outputs: Any) -> dict[str, Array]:
    """The outputs that are one number a flight, by name."""
    return {
        named(name): values
        for name, values in leaves_by_address(outputs).items()
        if values.ndim == 1 and jnp.issubdtype(values.dtype, jnp.inexact)
    }
