"""Compares a tuned scenario with the original one, on the same held-out draws."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Key

from .._programs import cached
from ..addresses import field_metadata, leaves_by_address
from ..analysis.sensitivities import named
from ..campaign.batch import LANES
from ..campaign.campaign import drawn_inputs
from ..campaign.dispersions import Dispersion
from ..flight.scenario import Scenario
from .batch_gradients import Loss, Simulation, batch_outputs, where_finite


_RESAMPLES = 1000
_CONFIDENCE = (2.5, 97.5)
"""Percentiles of the bounds of a confidence interval"""

_NUDGE = 1.0 + 4.0 * np.finfo(float).eps
"""Factor on draws and entry velocity that shows the effect of rounding on a statistic"""

_ROUNDINGS = 10.0
"""Factor on the measured effect of rounding, since it is measured on a few flights only"""


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
    """After minus before, with paired runs. Its interval is therefore narrower than the two
    intervals suggest. It is the bootstrap interval, widened on both sides by ten times the
    effect of rounding, so that a difference by rounding is not significant"""

    @property
    def lower(self) -> bool:
        """Whether the whole confidence interval of the change is negative."""
        return self.change.high < 0.0


@dataclasses.dataclass(frozen=True)
class Judgement:
    """Comparison of two scenarios on held-out draws."""

    runs: int
    """Number of runs that are finite with both scenarios"""
    not_finite_before: int
    not_finite_after: int
    comparisons: tuple[Comparison, ...]
    """Empty if fewer than two runs are finite"""

    def __getitem__(self, name: tuple[str, str]) -> Comparison:
        """The comparison of a quantity and a statistic, such as `"downrange", "std"`.

        The comparison of the loss is `"loss", ""`. It comes first.
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
    """Fly both scenarios with the same draws, and compare their losses and outputs.

    The confidence intervals (95 %) follow from a bootstrap over the runs. The effect of
    rounding is measured on the first flights. They are flown again with draws and an entry
    velocity that differ in their last digits.
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
    """The scenario, and the inputs of the first flights, with changed last digits.

    Inputs that choose, such as one profile of an ensemble, do not change: another choice is
    another flight.
    """
    chooses = {a: bool(field_metadata(scenario, a).get("choice")) for a in inputs}
    nudged = {
        a: x[:LANES] if chooses[a] else _NUDGE * x[:LANES] for a, x in inputs.items()
    }
    velocity = lambda scenario: scenario.initial_state.velocity
    return eqx.tree_at(velocity, scenario, _NUDGE * velocity(scenario)), nudged


def _rounding(pair: tuple[Any, Any], loss: Loss, some: bool) -> dict[str, float]:
    """Effect of rounding on the loss, and the largest effect on each scalar output."""
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
    """Estimate from the value of the sample (first) and the values of its resamples."""
    low, high = np.percentile(values[1:], _CONFIDENCE)
    return Estimate(float(values[0]), float(low), float(high))


@cached
def _resampled(pair: tuple[Any, Any], loss: Loss, count: int) -> tuple[Any, Any]:
    """Losses, and statistics by quantity: of the sample first, then of its resamples."""

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
    """The outputs that are one number for each flight, by name."""
    return {
        named(name): values
        for name, values in leaves_by_address(outputs).items()
        if values.ndim == 1 and jnp.issubdtype(values.dtype, jnp.inexact)
    }
