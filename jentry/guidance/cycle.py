"""Guidance cycles: when a sampled law decides. The cycle is a field of the law."""

import math
from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..fields import Scalar


class AbstractCycle(eqx.Module):
    """How long a sampled law holds a decision."""

    period: eqx.AbstractVar[float]
    """The longest guidance cycle, s; static"""

    @abstractmethod
    def seconds(self, held: Any) -> Scalar | float:
        """How long a decision is held, s."""

    @abstractmethod
    def most_cycles(self, time_limit: float) -> int:
        """The largest number of cycles in a flight up to a time limit (s)."""


class FixedCycle(AbstractCycle):
    """Guidance cycles of equal length."""

    period: float = eqx.field(static=True)

    def __check_init__(self):
        _check_period(self.period)

    def seconds(self, held: Any) -> float:
        return self.period

    def most_cycles(self, time_limit: float) -> int:
        return math.ceil(time_limit / self.period - 1e-9)


class AbstractTimedDecision(eqx.Module):
    """A held decision that includes its duration, for a cycle that becomes shorter."""

    duration: eqx.AbstractVar[Scalar]
    """Time for which the decision is held, s"""


class ShorteningCycle(AbstractCycle):
    """Guidance cycles that become shorter towards the target, and a freeze at the end.

    The law estimates the time to go and holds an `AbstractTimedDecision`.
    """

    period: float = eqx.field(default=1.0, static=True)
    shorter: tuple[tuple[float, float], ...] = eqx.field(
        default=((120.0, 0.1), (15.0, 0.02)), static=True
    )
    """Pairs of a time to go and the shorter cycle that applies inside it, s. Each cycle
    must divide the longer one, so that all cycles share one clock"""
    freeze: float = eqx.field(default=0.1, static=True)
    """Time to go inside which the last command is frozen, s"""

    def __check_init__(self):
        _check_period(self.period)
        inside = [limit for limit, _ in self.shorter]
        if sorted(inside, reverse=True) != inside:
            raise ValueError(f"times to go {inside} s of the cycles must be decreasing")
        cycles = [self.period, *(cycle for _, cycle in self.shorter)]
        for longer, shorter in zip(cycles, cycles[1:], strict=False):
            ratio = longer / shorter if shorter > 0.0 else 0.0
            if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9:
                raise ValueError(
                    f"guidance cycles {cycles} s: each must divide the one before"
                )

    def duration(self, seconds_to_go: Scalar, before: Scalar) -> Scalar:
        """Length of the cycle that begins, s; never longer than the previous one."""
        duration = before
        for limit, cycle in self.shorter:
            inside = seconds_to_go < limit
            duration = jnp.where(inside, jnp.minimum(duration, cycle), duration)
        return duration

    def seconds(self, held: Any) -> Scalar:
        if not isinstance(held, AbstractTimedDecision):
            raise ValueError(
                f"the law has a ShorteningCycle and holds a {type(held).__name__}: what "
                "it holds must be an AbstractTimedDecision, which tells its duration"
            )
        return held.duration

    def most_cycles(self, time_limit: float) -> int:
        # The times to go are estimates: allow for twice as many of the shorter cycles.
        count = math.ceil(time_limit / self.period)
        return count + sum(math.ceil(2.0 * to_go / c) for to_go, c in self.shorter)


def _check_period(period: float) -> None:
    if not 0.0 < period < math.inf:
        raise ValueError(f"period is {period} s: it must be positive and finite")
