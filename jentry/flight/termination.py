"""End conditions: a flight ends at the first of several."""

import enum
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar, scalar
from ..motion.state import EntryState
from ..onboard.track import Track


class Outcome(enum.IntEnum):
    """How a flight ended: the code in `Flight.outcome` and in result files."""

    REACHED = 0
    SKIPPED_OUT = 1
    CRASHED = 2
    TIMED_OUT = 3
    NOT_FINITE = 4

    @property
    def message(self) -> str:
        return _MESSAGES[self]


_MESSAGES = {
    Outcome.REACHED: "reached the end of guided flight",
    Outcome.SKIPPED_OUT: "skipped out of the atmosphere",
    Outcome.CRASHED: "met the surface",
    Outcome.TIMED_OUT: "was still flying at the time limit",
    Outcome.NOT_FINITE: "stopped where its state was no longer finite",
}


class AbstractEndCondition(eqx.Module):
    """Flight goes on while the margin is positive; zero is the end."""

    outcome: eqx.AbstractVar[Outcome]

    @abstractmethod
    def margin(self, state: EntryState) -> Scalar:
        """A smooth function of the state."""


class VelocityBelow(AbstractEndCondition):
    """Ends when the velocity has fallen to a value."""

    velocity: Scalar = scalar(unit="m/s", positive=True)
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState) -> Scalar:
        return state.velocity - self.velocity


class AltitudeBelow(AbstractEndCondition):
    """Ends when the altitude has fallen to a value."""

    altitude: Scalar = scalar(unit="m")
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState) -> Scalar:
        return state.altitude - self.altitude


class AltitudeAbove(AbstractEndCondition):
    """Ends when the altitude has risen to a value."""

    altitude: Scalar = scalar(unit="m")
    outcome: Outcome = eqx.field(default=Outcome.SKIPPED_OUT, static=True)

    def margin(self, state: EntryState) -> Scalar:
        return self.altitude - state.altitude


class TargetPassed(AbstractEndCondition):
    """Ends in the plane across a track through its target."""

    track: Track
    radius: Scalar = scalar(unit="m", positive=True)
    """Of the sphere on which the way to go is measured"""
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState) -> Scalar:
        return self.radius * self.track.to_go(state)


class Termination(eqx.Module):
    """The end conditions of a scenario, by name, and its time limit.

    Conditions are looked at after each step of the solver, so one that is met and left
    again within a step is not seen.
    """

    conditions: dict[str, AbstractEndCondition] = eqx.field(
        converter=lambda conditions: dict(sorted(conditions.items()))
    )
    time_limit: float = eqx.field(static=True)
    """s after the start; static, since it bounds the length of the loop"""

    def __check_init__(self):
        if not 0.0 < self.time_limit < float("inf"):
            raise ValueError(
                f"time_limit is {self.time_limit} s: it must be positive and finite"
            )

    def margins(self, flown: Scalar, state: EntryState) -> Float[Array, " conditions"]:
        """Of every condition, and last of the time limit; `flown` is in s."""
        values = [c.margin(state) for c in self.conditions.values()]
        return jnp.stack([*values, self.time_limit - flown])

    def smallest_margin(self, flown: Scalar, state: EntryState) -> Scalar:
        """Positive in flight; the flight ends where it is zero."""
        return jnp.min(self.margins(flown, state))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the margins, in their order."""
        return (*self.conditions, "time_limit")

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Of the margins, in their order."""
        ends = [condition.outcome for condition in self.conditions.values()]
        return (*ends, Outcome.TIMED_OUT)
