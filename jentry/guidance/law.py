"""What a guidance law is: two protocols. Only this file asks which of them a law is."""

from abc import abstractmethod
from typing import Any, Generic, TypeVar

import equinox as eqx

from .._dependence import Traced
from ..fields import Scalar
from ..motion.state import Controls, EntryState
from ..onboard.navigation import Measurement
from .cycle import AbstractCycle, FixedCycle


Memory = TypeVar("Memory")
Held = TypeVar("Held")


class AbstractLaw(eqx.Module):
    """A guidance law: gains, limits, reference and its own idea of the world.

    A law reads a `Measurement`, never the truth, and remembers nothing itself: its
    memory travels beside the state of the vehicle. It is one of two kinds, below.

    The forces are sensed at the attitude that is flown. With an ideal attitude that is the
    command of the same instant. Hence its angle of attack may not depend on the forces: a
    flight with such a law is refused. `Sampled` breaks the loop, since the forces are then
    those of the angle of attack that is held, and so does an attitude that takes its time.

    A law that turns the bank alone commands `measurement.trim_angle_of_attack`.
    """


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
    """A law with a guidance cycle: at its start it decides, and holds the decision.

    What was decided (a command, a bank sign, a scale factor) is `held`; between the
    decisions the law may still act on it continuously, with a memory of its own as a
    continuous law has.
    """

    cycle: eqx.AbstractVar[AbstractCycle]
    """`FixedCycle` or `ShorteningCycle`"""

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
    cycle: FixedCycle

    def __init__(self, law: AbstractContinuousLaw[Memory], period: float):
        """`period` of the guidance cycle in s."""
        self.law = law
        self.cycle = FixedCycle(period)

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


def begun(law: AbstractLaw, measurement: Measurement) -> tuple[Any, Any]:
    """Memory at the start of guidance, and what a sampled law holds; else None."""
    if isinstance(law, AbstractSampledLaw):
        return law.init(measurement)
    assert isinstance(law, AbstractContinuousLaw)
    return law.init(measurement), None


def commanded(
    law: AbstractLaw, time: Scalar, measurement: Measurement, memory: Any, held: Any
) -> tuple[Controls, Any]:
    """Command of a law of either kind, and the time derivative of its memory."""
    if isinstance(law, AbstractSampledLaw):
        return law(time, measurement, memory, held)
    assert isinstance(law, AbstractContinuousLaw)
    return law(time, measurement, memory)


def reads_forces_between_cycles(law: AbstractLaw, state: EntryState) -> bool:
    """Whether a law uses its sensed forces at other times than its guidance cycles.

    Taken from what the law computes; a continuous law has no cycles.
    """
    if isinstance(law, AbstractContinuousLaw):
        return True
    force = 0.0 * state.altitude
    before = begun(law, Measurement(state, force, force, force))

    def act(lift: Scalar, drag: Scalar) -> tuple[Controls, Any]:
        return commanded(law, force, Measurement(state, lift, drag, force), *before)

    return Traced(act, force, force).depends()
