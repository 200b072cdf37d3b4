"""Losses: plain functions of the outputs of many flights, which tuning minimises.

    def loss(misses):
        return mean_square(misses.downrange / km) + 10.0 * mean_square(misses.altitude / km)

Each function takes values of shape (flights,), in units that make them of order one, and
returns one number. All functions are differentiable. The gradient with respect to a flight
is zero if the loss does not depend on that flight.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..fields import Scalar
from ..flight.flight import Flight, History
from ..flight.miss import misses
from ..flight.scenario import Scenario


Values = Float[Array, " flights"]


def mean_square(values: Values) -> Scalar:
    """Mean of the squares."""
    return jnp.mean(values**2)


def power_mean(values: Values, power: float = 4.0) -> Scalar:
    """The root of the mean power of the magnitudes, in the unit of the values.

    With power 2 it is the root mean square, and with a large power it approaches the
    largest magnitude. A higher power gives more weight to the tail, but every flight
    still counts.
    """
    if not power >= 1.0:
        raise ValueError(f"power is {power}: it must be at least 1")
    mean = jnp.mean(jnp.abs(values) ** power)
    off = mean > 0.0
    return jnp.where(off, jnp.where(off, mean, 1.0) ** (1.0 / power), 0.0)


def smooth_maximum(values: Values, width: Scalar | float) -> Scalar:
    """Smooth worst case: the largest value, smoothed over a width in the same unit.

    It exceeds the largest value by `width * log(flights)` at most. For misses, pass their
    magnitudes.
    """
    return width * jax.nn.logsumexp(values / width)


def conditional_value_at_risk(values: Values, share: float = 0.05) -> Scalar:
    """Mean of the largest share of the values (CVaR). For misses, pass their magnitudes.

    Reference: R. T. Rockafellar, S. Uryasev, "Optimization of conditional value-at-risk",
    Journal of Risk 2(3), 2000; here for equally likely values. The last value within the
    share counts in part.
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"share is {share}: it must be above 0 and at most 1")
    among = round(share * values.size, 9)  # 0.07 of 100 is 7, not a little more
    weights = np.clip(among - np.arange(values.size), 0.0, 1.0) / among
    return jnp.sum(jnp.sort(values, descending=True) * weights)


def probability_outside(
    values: Any, half_widths: Any, softness: Scalar | float = 0.1
) -> Scalar:
    """Soft probability that a flight ends outside a box: any value beyond its half-width.

    **Arguments:**

    - `values`: one or several arrays of shape (flights,), such as
        `(downrange, crossrange)`.
    - `half_widths`: one number for each array, in the same units.
    - `softness`: share of the half-width over which a flight changes from inside to
        outside. As it goes to zero, the result becomes the share of flights outside.
    """
    within = jax.tree.map(
        lambda x, half: jax.nn.sigmoid((half - jnp.abs(x)) / (softness * half)),
        values,
        half_widths,
    )
    leaves = jax.tree.leaves(within)
    return 1.0 - jnp.mean(jnp.prod(jnp.stack(leaves), axis=0))


def excess(values: Values, limit: Scalar | float) -> Scalar:
    """Penalty of a path constraint: mean square of the excess as a share of the limit.

    The values are peaks, as in `excess(peaks.load_factor, 12.0)`.
    """
    return jnp.mean(jax.nn.relu(values / limit - 1.0) ** 2)


def penalty(excesses: Mapping[str, Any]) -> Scalar:
    """Penalty of all path constraints with a limit: the sum of their mean square excesses.

    It takes the excesses of each flight over each limit. Include these in the outputs:

        outputs = lambda scenario, flight: (
            misses(scenario, flight), excesses(scenario.constraints, flight.peaks)
        )
        loss = lambda out: mean_square(out[0].downrange / km) + penalty(out[1])

    **Raises:** `ValueError` if no constraint has a limit.
    """
    if not excesses:
        raise ValueError(
            "no path constraint of the scenario has a limit: give one, such as "
            'constraints={**scenario.constraints, "heat_rate": HeatRate(1e6)}'
        )
    return sum(map(mean_square, excesses.values()), jnp.zeros(()))


def control_effort(history: History) -> Scalar:
    """Mean square rate of the controls of one flight, 1/s2.

    It is the sum for the cosine of the bank and the angle of attack, computed from the
    differences between the entries of the history. Bank reversals are discrete and do not
    count. It is defined for one flight, so compute it in the outputs:

        outputs = lambda scenario, flight: (
            misses(scenario, flight), control_effort(flight.history)
        )
        tune(..., outputs=outputs, history=1.0)
    """
    if history.time.ndim != 1:
        raise ValueError(
            f"the history has times of shape {history.time.shape}: the control effort is "
            "of one flight, take it in the outputs"
        )
    flying = jnp.isfinite(history.time)
    between = flying[1:] & flying[:-1]
    interval = jnp.where(between, jnp.diff(history.time), 1.0)

    def turned(command):
        change = jnp.where(between, jnp.diff(command), 0.0)
        return jnp.sum(change**2 / interval)

    controls = history.controls
    total = turned(controls.cos_bank) + turned(controls.angle_of_attack)
    duration = jnp.sum(jnp.where(between, interval, 0.0))
    return total / jnp.where(duration > 0.0, duration, 1.0)


_LEAST_TURN = 1e-6
"""rad; a bank that never turns still has a derivative"""


def bank_turns(history: History) -> Scalar:
    """Root mean square turn of the commanded bank in a guidance cycle, of one flight, rad.

    It is that of a `NeuralLaw`, whose bank has a sign and turns through zero. The history
    must have the interval of the guidance cycle: with a shorter one the value is smaller.
    Beside another law it is of the bank of the network. It is defined for one flight, so
    compute it in the outputs, as `control_effort`.
    """
    if history.time.ndim != 1:
        raise ValueError(
            f"the history has times of shape {history.time.shape}: the turns are of one "
            "flight, take them in the outputs"
        )
    if not hasattr(history.decisions, "bank"):
        raise ValueError(
            f"the law holds a {type(history.decisions).__name__}: turns are of a NeuralLaw"
        )
    flying = jnp.isfinite(history.time)
    between = flying[1:] & flying[:-1]
    turns = jnp.where(between, jnp.diff(history.decisions.bank), 0.0)
    mean = jnp.sum(turns * turns) / jnp.maximum(jnp.sum(between), 1)
    return jnp.sqrt(mean + _LEAST_TURN**2)


class MeanSquare(eqx.Module):
    """Sum of the mean squares of residuals, such as the misses of a law.

    MeanSquare(lambda misses: misses.downrange / km)
    """

    residuals: Callable[[Any], Any] = eqx.field(static=True)
    """Function of the outputs of many flights that returns arrays of shape (flights,)"""

    def __call__(self, outputs: Any) -> Scalar:
        return sum(map(mean_square, jax.tree.leaves(self.residuals(outputs))))


class OfDistance(eqx.Module):
    """A statistic of the miss of each flight, the root of its summed squared residuals."""

    statistic: Callable[[Values], Scalar] = eqx.field(static=True)
    residuals: Callable[[Any], Any] = eqx.field(static=True)
    """Function of the outputs of many flights that returns arrays of shape (flights,)"""

    def __call__(self, outputs: Any) -> Scalar:
        squares = sum(x**2 for x in jax.tree.leaves(self.residuals(outputs)))
        off = squares > 0.0
        distance = jnp.sqrt(jnp.where(off, squares, 1.0))
        return self.statistic(jnp.where(off, distance, 0.0))


@dataclasses.dataclass(frozen=True)
class MissesAndPeaks:
    """Outputs of a flight by name: its misses, and the peaks of some path constraints."""

    peaks: tuple[str, ...]

    def __call__(self, scenario: Scenario, flight: Flight) -> dict[str, Scalar]:
        missed = {
            n: x for n, x in vars(misses(scenario, flight)).items() if x is not None
        }
        return missed | {n: flight.peaks[n] for n in self.peaks}


@dataclasses.dataclass(frozen=True)
class ScaledMisses:
    """Residuals: chosen misses, each divided by its scale (m or m/s).

    From the outputs of `MissesAndPeaks` it can also choose peaks.
    """

    scales: tuple[tuple[str, float], ...]

    def __call__(self, outputs: Any) -> tuple[Values, ...]:
        known = outputs if isinstance(outputs, dict) else vars(outputs)

        def value(name: str) -> Values:
            found = known.get(name)
            if found is None:
                raise ValueError(
                    f"the target has no {name}: give it one, or leave the miss out"
                )
            return found

        return tuple(value(name) / scale for name, scale in self.scales)


def _worst(distance: Values) -> Scalar:
    return smooth_maximum(distance, 0.1)


def _outside(distance: Values) -> Scalar:
    return probability_outside(distance, 1.0)


BY_NAME: Mapping[str, Callable[[ScaledMisses], Callable[[Any], Scalar]]] = {
    "mean-square": MeanSquare,
    "power-mean": functools.partial(OfDistance, power_mean),
    "cvar": functools.partial(OfDistance, conditional_value_at_risk),
    "worst-case": functools.partial(OfDistance, _worst),
    "outside": functools.partial(OfDistance, _outside),
}
"""Losses of scaled misses, by their names on the command line: mean square, root of the
mean fourth power of the distance, mean of the worst 5 %, worst case, and soft probability
of a distance above one"""
