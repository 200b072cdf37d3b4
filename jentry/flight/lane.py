"""A flight in progress: all that the loop carries from one step to the next."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ..fields import Count, Flag, Scalar
from ..motion.constraints import (
    ConstraintValues,
)
from ..motion.state import EntryState
from ..motion.vectors import VectorState
from ..onboard.inertial import Directions, Navigated
from ..world.tabulated import Excursion


class Bracket(eqx.Module):
    """Next step of the fixed-step solver, and the bracket about the end of the flight."""

    trial: Scalar
    """Length of the next step, s"""
    margin: Scalar
    """Smallest margin of the end conditions now"""
    far: Scalar
    """Length of a step that is known to cross the end, s; infinite if none is known"""
    far_margin: Scalar
    """Smallest margin of the end conditions at `far`"""
    allowed: Scalar
    """Largest value that `far` may have after the next step, s"""


class Moving(eqx.Module):
    """Integrated quantities of a flight, or their time derivatives."""

    motion: EntryState | VectorState
    """Position and velocity, in the coordinates that the dynamics integrates"""
    attitude: Any
    """State of the attitude; None if the vehicle follows commands at once"""
    memory: Any
    """Memory of the law"""
    integrals: Mapping[str, Scalar] = eqx.field(default_factory=dict)
    """Values of the path constraints that are integrals, by name"""
    off_a_bank: Scalar | None = None
    """Integral of the error of sin^2 + cos^2 of the commanded bank: zero if every command
    was a bank. It is None during the flight, where an invalid bank is replaced by NaN:
    this costs less, and stops the flight"""
    navigated: Navigated | None = None
    """State of the navigation; None if it is perfect"""
    directions: Directions | None = None
    """Sines and cosines that the navigation needs, within a step; None between steps"""

    @property
    def state(self) -> EntryState:
        """Position and velocity as all but the dynamics read them."""
        motion = self.motion
        return motion if isinstance(motion, EntryState) else motion.entry_state

    def in_step(self) -> "Moving":
        """These quantities at the start of a step, with all that it integrates."""
        if self.navigated is None:
            return self
        directions = Directions.of(self.state, self.navigated.state)
        return dataclasses.replace(self, directions=directions)

    def renewed(self) -> "Moving":
        """These quantities after a step: see `VectorState.renewed`."""
        motion = self.motion
        if isinstance(motion, VectorState):
            motion = motion.renewed()
        return dataclasses.replace(self, motion=motion, directions=None)

    @property
    def believed(self) -> EntryState:
        """What the vehicle believes of its position and velocity."""
        return self.state if self.navigated is None else self.navigated.state


class Instant(eqx.Module):
    """Time and state of a flight at one instant."""

    time: Scalar = eqx.field(metadata={"unit": "s"})
    """Time since the start, s"""
    state: EntryState


class Noted(eqx.Module):
    """Quantities that are recorded of a flight up to a step."""

    peaks: ConstraintValues
    at_peaks: dict[str, Instant]
    """Time and state at the located peaks, by name"""
    beyond: dict[str, Excursion]
    """Excursions beyond the edges of tables, by the name of the caveat"""


class Lane(eqx.Module):
    """A flight in progress: everything that the loop carries."""

    flown: Scalar
    """Time since the start, s"""
    moving: Moving
    held: Any
    noted: "Noted"
    bracket: Bracket
    running: Flag
    stopped: Count
    """Code of the `Outcome` that stopped the flight before an end; -1 if none has"""
    aiding: Any = None
    """What the navigation holds from one update to the next; None if nothing"""

    @property
    def state(self) -> EntryState:
        return self.moving.state

    @property
    def memory(self) -> Any:
        return self.moving.memory

    @property
    def on_schedule(self) -> Flag:
        """Whether the flight is running and not yet in the step that contains the end."""
        return self.running & jnp.isinf(self.bracket.far)
