"""What a guidance law is: the two protocols that the closed loop knows."""

import math
from abc import abstractmethod
from typing import ClassVar, Generic, TypeVar

import equinox as eqx

from .._types import Scalar
from ..motion.state import Controls, EntryState
from ..onboard.navigation import Measurement


Memory = TypeVar("Memory")
Held = TypeVar("Held")


class AbstractLaw(eqx.Module):
    """A guidance law: gains, limits, reference and its own idea of the world.

    A law reads a `Measurement`, never the truth, and remembers nothing itself: its
    memory travels beside the state of the vehicle. It is one of two kinds, below.
    """

    reads_sensors_between_cycles: ClassVar[bool] = True
    """Whether it needs its measured forces at other times than its guidance cycles"""


class AbstractContinuousLaw(AbstractLaw, Generic[Memory]):
    """A law that acts at every instant; its memory, if any, obeys a differential equation.

    Memory is a pytree of floats, integrated with the motion by the same solver.
    """

    @abstractmethod
    def init(self, measurement: Measurement) -> Memory:
        """Memory at the start of guidance."""

    @abstractmethod
    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory
    ) -> tuple[Controls, Memory]:
        """Command, and the time derivative of the memory."""


class AbstractSampledLaw(AbstractLaw, Generic[Memory, Held]):
    """A law with a guidance cycle: once a period it decides, and holds the decision.

    What was decided (a command, a bank sign, a scale factor) is `held`; between the
    decisions the law may still act on it continuously, with a memory of its own as a
    continuous law has.
    """

    period: eqx.AbstractVar[float]
    """Guidance cycle, s; static. The longest one of a law whose cycle varies"""

    def cycle(self, held: Held) -> Scalar | float:
        """How long what was just decided is held, s."""
        return self.period

    def most_cycles(self, time_limit: float) -> int:
        """That a flight up to the time limit (s) can take."""
        return math.ceil(time_limit / self.period - 1e-9)

    def angle_of_attack(
        self, state: EntryState, memory: Memory, held: Held
    ) -> Scalar | None:
        """At which the vehicle flies now, and its sensed forces are measured, rad.

        None for a law that leaves the angle of attack at trim.
        """
        return None

    def caveats(self, held: Held) -> dict[str, Scalar]:
        """What a reader of the results must know of how the law decided; by name.

        Each is a share from 0 to 1, such as of the decisions that lacked what the law
        decides by. They stand in `Flight.caveats` and in the results of a campaign, and
        it is said where one is not zero.
        """
        return {}

    @abstractmethod
    def init(self, measurement: Measurement) -> tuple[Memory, Held]:
        """Memory, and what is held before the first cycle."""

    @abstractmethod
    def update(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: Held
    ) -> tuple[Memory, Held]:
        """The decision at the start of a cycle; the memory may jump with it."""

    @abstractmethod
    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: Held
    ) -> tuple[Controls, Memory]:
        """Command within the cycle, and the time derivative of the memory."""


class Sampled(AbstractSampledLaw[Memory, Controls]):
    """A continuous law whose command is held through each guidance cycle.

    Its memory (an observer, a filter) goes on continuously. As the period tends to zero
    the flight tends to that of the continuous law, at first order.
    """

    law: AbstractContinuousLaw[Memory]
    period: float = eqx.field(static=True)

    def __check_init__(self):
        if not self.period > 0.0:
            raise ValueError(f"period is {self.period} s: it must be positive")

    def init(self, measurement: Measurement) -> tuple[Memory, Controls]:
        memory = self.law.init(measurement)
        time = 0.0 * measurement.drag
        command, _ = self.law(time, measurement, memory)
        return memory, command

    def update(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: Controls
    ) -> tuple[Memory, Controls]:
        command, _ = self.law(time, measurement, memory)
        return memory, command

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: Controls
    ) -> tuple[Controls, Memory]:
        _, rate = self.law(time, measurement, memory)
        return held, rate
