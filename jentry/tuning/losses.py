"""Losses: what is to be made small, as plain functions of the outputs of many flights.

    def loss(misses):
        return mean_square(misses.downrange / km) + 10.0 * mean_square(misses.altitude / km)

Each of these takes values of shape (flights,), in units that make them of order one, and
gives one number. All are differentiable; their gradient with respect to a flight is zero
where that flight does not matter.
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

    Between the root mean square, of power 2, and the largest: the higher the power, the
    more the tail counts, and yet each flight does.
    """
    if not power >= 1.0:
        raise ValueError(f"power is {power}: it must be at least 1")
    mean = jnp.mean(jnp.abs(values) ** power)
    off = mean > 0.0
    return jnp.where(off, jnp.where(off, mean, 1.0) ** (1.0 / power), 0.0)


def smooth_maximum(values: Values, width: Scalar | float) -> Scalar:
    """Worst case: the largest value, rounded over a width in the same unit.

    Above the largest by `width * log(flights)` at most. For misses give their magnitude.
    """
    return width * jax.nn.logsumexp(values / width)


def conditional_value_at_risk(values: Values, share: float = 0.05) -> Scalar:
    """Mean of the largest share of the values (CVaR). For misses give their magnitude.

    Reference: R. T. Rockafellar, S. Uryasev, "Optimization of conditional value-at-risk",
    Journal of Risk 2(3), 2000; here for equally likely values, of which the last one of
    the share counts in part.
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"share is {share}: it must be above 0 and at most 1")
    among = round(share * values.size, 9)  # 0.07 of 100 is 7, not a little more
    weights = np.clip(among - np.arange(values.size), 0.0, 1.0) / among
    return jnp.sum(jnp.sort(values, descending=True) * weights)


def probability_outside(
    values: Any, half_widths: Any, softness: Scalar | float = 0.1
) -> Scalar:
    """Soft probability of leaving a box: of any value beyond its half-width.

    **Arguments:**

    - `values`: one or several arrays of shape (flights,), as in `(downrange, crossrange)`.
    - `half_widths`: as many numbers, in the same units.
    - `softness`: share of the half-width over which a flight goes from in to out. As it
        goes to zero this becomes the share of flights outside.
    """
    within = jax.tree.map(
        lambda x, half: jax.nn.sigmoid((half - jnp.abs(x)) / (softness * half)),
        values,
        half_widths,
    )
    leaves = jax.tree.leaves(within)
    return 1.0 - jnp.mean(jnp.prod(jnp.stack(leaves), axis=0))


def excess(values: Values, limit: Scalar | float) -> Scalar:
    """Penalty of a path constraint: mean square of what exceeds the limit, over the limit.

    Of peaks, such as `excess(peaks.load_factor, 12.0)`.
    """
    return jnp.mean(jax.nn.relu(values / limit - 1.0) ** 2)


def penalty(excesses: Mapping[str, Any]) -> Scalar:
    """Penalty of all path constraints with a limit: their mean squares, summed.

    Of what each flight exceeds each limit by, so take that in the outputs:

        outputs = lambda scenario, flight: (
            misses(scenario, flight), excesses(scenario.constraints, flight.peaks)
        )
        loss = lambda out: mean_square(out[0].downrange / km) + penalty(out[1])

    Raises `ValueError` where no constraint has a limit, so that nothing is a penalty.
    """
    if not excesses:
        raise ValueError(
            "no path constraint of the scenario has a limit: give one, such as "
            'constraints={**scenario.constraints, "heat_rate": HeatRate(1e6)}'
        )
    return sum(map(mean_square, excesses.values()), jnp.zeros(()))


def control_effort(history: History) -> Scalar:
    """Mean square rate at which a flight turns its lift, 1/s2.

    Of the cosine of the bank and of the angle of attack, between the entries of its
    history; bank reversals are discrete and not counted. Of one flight, so take it in the
    outputs:

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


class MeanSquare(eqx.Module):
    """Mean square of residuals: the loss of a law that is to come near its target.

    MeanSquare(lambda misses: misses.downrange / km)
    """

    residuals: Callable[[Any], Any] = eqx.field(static=True)
    """Of the outputs of many flights: arrays of shape (flights,)"""

    def __call__(self, outputs: Any) -> Scalar:
        return sum(map(mean_square, jax.tree.leaves(self.residuals(outputs))))


class OfDistance(eqx.Module):
    """A statistic of the distance by which flights miss: the root of summed squares."""

    statistic: Callable[[Values], Scalar] = eqx.field(static=True)
    residuals: Callable[[Any], Any] = eqx.field(static=True)
    """Of the outputs of many flights: arrays of shape (flights,)"""

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
    """Residuals: some of the misses, each over what counts as one (m or m/s).

    Of the outputs of `MissesAndPeaks`, some of the peaks likewise.
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
"""Of scaled misses, for the command line: mean square, root of the mean fourth power of
the distance, mean of the worst twentieth, worst case, and soft probability of a distance
above one"""
