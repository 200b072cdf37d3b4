"""The two protocols of a guidance law: continuous and sampled.

Only this file tests which of the two a law is.
"""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from .._dependence import Traced
from ..fields import Scalar, optional_scalar, scalar
from ..motion.constraints import AbstractPathConstraint
from ..motion.state import Controls, EntryState
from ..onboard.measurement import Measurement
from .cycle import AbstractCycle, FixedCycle
from .lateral import AbstractLateralLogic, turned


Memory = TypeVar("Memory")
Held = TypeVar("Held")


class AbstractLaw(eqx.Module):
    """A guidance law: its gains, limits, reference and onboard model.

    A law reads a `Measurement`, never the true state. It stores nothing itself: its memory
    is carried beside the state of the vehicle. A law is either continuous
    (`AbstractContinuousLaw`) or sampled (`AbstractSampledLaw`).

    The forces are sensed at the actual attitude. With an ideal attitude response that is
    the command of the same instant, so the commanded angle of attack must not depend on
    the sensed forces: a flight with such an algebraic loop is refused. `Sampled` breaks
    the loop, since the forces are then those at the held angle of attack. An attitude
    response with a lag also breaks it.

    A law that commands the bank alone commands `measurement.trim_angle_of_attack` with it.
    A law that commands the angle of attack alone returns an `AngleOfAttackCommand` and is
    composed with a bank law: see `compose`.
    """

    keeps: ClassVar[tuple[type[AbstractPathConstraint], ...]] = ()
    """Path constraints whose limits the law respects. If a scenario has such constraints
    and none of them has a limit, a warning is issued"""

    def tracked(
        self, time: Scalar, measurement: Measurement, held: Any
    ) -> "Tracked | None":
        """Outputs that the law makes track a reference, and the controls that it uses.

        None for a law that has no such outputs or does not report them. `linearize`
        expresses deviations in these errors and computes the transmission zeros of the
        vehicle from these controls to them. `held` is what a sampled law holds, else None.
        """
        return None


class Tracked(eqx.Module):
    """Outputs that a law makes track its reference."""

    errors: tuple[tuple[Scalar, ...], ...]
    """For each output, its error and those derivatives of it along the flight that the law
    feeds back, as the law estimates them. The derivatives are over any variable, such as
    time or energy"""
    by: tuple[str, ...] = eqx.field(static=True)
    """Controls that track them: "angle_of_attack", "bank_angle" or both"""

    def __check_init__(self):
        known = "angle_of_attack", "bank_angle"
        if not set(self.by) <= set(known) or len(set(self.by)) < len(self.by):
            raise ValueError(
                f"errors are tracked by {self.by}: they must be controls from {known}, "
                "each once"
            )


class AngleOfAttackCommand(eqx.Module):
    """Command of an angle-of-attack law; `compose` combines it with a bank law."""

    angle_of_attack: Scalar = scalar(unit="rad")
    bank_increment: Scalar | None = optional_scalar(unit="rad")
    """Increment of the bank over the command of the bank law, rad; None for no increment.
    A law that modulates the angle of attack about a schedule uses it to bring the mean
    angle of attack back to the schedule, with feedback of the deviation and of its rate"""


Command = Controls | AngleOfAttackCommand


class AbstractContinuousLaw(AbstractLaw, Generic[Memory]):
    """A law that computes its command at every instant.

    Its memory, if any, is a pytree of floats that obeys a differential equation. The same
    solver integrates the memory and the motion.
    """

    @abstractmethod
    def init(self, measurement: Measurement) -> Memory:
        """Memory at the start of guidance."""

    @abstractmethod
    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory
    ) -> tuple[Command, Memory]:
        """Command, and the time derivative of the memory."""


if TYPE_CHECKING:  # as a field it would be the first argument of every subclass

    class _Turning:
        lateral: AbstractLateralLogic
else:

    class _Turning(eqx.Module):
        lateral: eqx.AbstractVar[AbstractLateralLogic]


class AbstractBankLaw(AbstractContinuousLaw[Memory], _Turning):
    """A continuous law that commands the bank, to the side that its lateral logic selects.

    The law computes the command for a bank to the right. A lateral logic that makes
    decisions needs a guidance cycle, which `Sampled(law, period)` provides.
    """

    @abstractmethod
    def to_the_right(
        self, time: Scalar, measurement: Measurement, memory: Memory
    ) -> tuple[Controls, Memory]:
        """Command if the bank is to the right, and the time derivative of the memory."""

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory
    ) -> tuple[Controls, Memory]:
        if self.lateral.init(measurement) is not None:
            name = type(self).__name__
            raise ValueError(
                f"{name} has a {type(self.lateral).__name__}, which decides at guidance "
                f"cycles, and {name} has none: take Sampled(law, period), or FixedSide()"
            )
        controls, rate = self.to_the_right(time, measurement, memory)
        return turned(controls, self.lateral.sign(None)), rate


class AbstractSampledLaw(AbstractLaw, Generic[Memory, Held]):
    """A law that decides at the start of each guidance cycle and holds the decision.

    The decision (a command, a bank sign, a scale factor) is `held`. Between decisions the
    law may still act on it continuously, with a memory like that of a continuous law.
    """

    cycle: eqx.AbstractVar[AbstractCycle]
    """`FixedCycle` or `ShorteningCycle`"""

    def caveats(self, held: Held) -> dict[str, Scalar]:
        """Reasons to doubt the decisions of the law, by name.

        Each is a share from 0 to 1, such as the share of decisions that lacked a
        prediction. The caveats appear in `Flight.caveats` and in the results of a
        campaign. Those that are not zero are reported.
        """
        return {}

    @abstractmethod
    def init(self, measurement: Measurement) -> tuple[Memory, Held]:
        """Memory, and the held decision before the first cycle."""

    @abstractmethod
    def update(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: Held
    ) -> tuple[Memory, Held]:
        """Decision at the start of a cycle; the memory may jump with it."""

    @abstractmethod
    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: Held
    ) -> tuple[Command, Memory]:
        """Command within the cycle, and the time derivative of the memory."""


class HeldCommand(eqx.Module):
    """A command that is held through a guidance cycle, with the side of the bank."""

    command: Command
    side: Any
    """Decision of the lateral logic of the law; None if it decides nothing"""


class Sampled(AbstractSampledLaw[Memory, HeldCommand]):
    """A continuous law whose command is held through each guidance cycle.

    The memory of the law (an observer, a filter) is still integrated continuously. As the
    period tends to zero, the flight converges to that of the continuous law, at first
    order. The lateral logic of an `AbstractBankLaw` decides at the guidance cycle.
    """

    law: AbstractContinuousLaw[Memory]
    cycle: FixedCycle

    def __init__(self, law: AbstractContinuousLaw[Memory], period: float):
        """`period` of the guidance cycle in s."""
        self.law = law
        self.cycle = FixedCycle(period)

    def init(self, measurement: Measurement) -> tuple[Memory, HeldCommand]:
        law = self.law
        memory = law.init(measurement)
        time = 0.0 * measurement.drag
        bank = isinstance(law, AbstractBankLaw)
        side = law.lateral.init(measurement) if bank else None
        command, _ = self._acting(time, measurement, memory, side)
        return memory, HeldCommand(command, side)

    def update(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: HeldCommand
    ) -> tuple[Memory, HeldCommand]:
        law, side = self.law, held.side
        if isinstance(law, AbstractBankLaw):
            side = law.lateral.update(time, measurement, side, None)
        command, _ = self._acting(time, measurement, memory, side)
        return memory, HeldCommand(command, side)

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Memory, held: HeldCommand
    ) -> tuple[Command, Memory]:
        _, rate = self._acting(time, measurement, memory, held.side)
        return held.command, rate

    def tracked(
        self, time: Scalar, measurement: Measurement, held: HeldCommand
    ) -> Tracked | None:
        return self.law.tracked(time, measurement, None)

    def _acting(
        self, time: Scalar, measurement: Measurement, memory: Memory, side: Any
    ) -> tuple[Command, Memory]:
        law = self.law
        if not isinstance(law, AbstractBankLaw):
            return law(time, measurement, memory)
        controls, rate = law.to_the_right(time, measurement, memory)
        return turned(controls, law.lateral.sign(side)), rate


def kept_constraints(law: AbstractLaw) -> tuple[type[AbstractPathConstraint], ...]:
    """Path constraints whose limits a law, or a law that it contains, respects."""
    parts = [part for part in vars(law).values() if isinstance(part, AbstractLaw)]
    return (*law.keeps, *(kept for part in parts for kept in kept_constraints(part)))


def begun(law: AbstractLaw, measurement: Measurement) -> tuple[Any, Any]:
    """Memory and held decision at the start of guidance; the latter None if continuous."""
    if isinstance(law, AbstractSampledLaw):
        memory, held = _pair(law, "init", law.init(measurement))
        return memory, held
    assert isinstance(law, AbstractContinuousLaw)
    return law.init(measurement), None


def decided(
    law: AbstractSampledLaw,
    time: Scalar,
    measurement: Measurement,
    memory: Any,
    held: Any,
) -> tuple[Any, Any]:
    """Memory and held decision of a sampled law after its decision at a cycle start."""
    after = _pair(law, "update", law.update(time, measurement, memory, held))
    for what, given, before in zip(
        ("memory", "decision"), after, (memory, held), strict=True
    ):
        _require_like(law, what, given, before)
    return after


Kind = TypeVar("Kind", Controls, AngleOfAttackCommand)

_EXAMPLES = {
    Controls: "Controls, such as Controls.from_bank(bank_angle, angle_of_attack)",
    AngleOfAttackCommand: "an AngleOfAttackCommand",
}


def commanded(
    law: AbstractLaw,
    time: Scalar,
    measurement: Measurement,
    memory: Any,
    held: Any,
    kind: type[Kind] = Controls,
) -> tuple[Kind, Any]:
    """Command of a law of either kind, and the time derivative of its memory.

    **Raises:** `ValueError` if the command is not of the class `kind`.
    """
    if isinstance(law, AbstractSampledLaw):
        given = law(time, measurement, memory, held)
    else:
        assert isinstance(law, AbstractContinuousLaw)
        given = law(time, measurement, memory)
    command, rate = _pair(law, "__call__", given)
    if not isinstance(command, kind):
        beside = (
            "; an angle-of-attack law flies beside a bank law, compose(law, bank_law)"
            if isinstance(command, AngleOfAttackCommand)
            else ""
        )
        raise ValueError(
            f"{type(law).__name__} commands {command!r}: it must be {_EXAMPLES[kind]}"
            f"{beside}"
        )
    for name, value in vars(command).items():
        if value is not None and jnp.shape(value) != ():
            raise ValueError(
                f"{type(law).__name__} commands a {name} of shape {jnp.shape(value)}: "
                "it must be one number"
            )
    _require_like(law, "rate of its memory", rate, memory)
    return command, rate


def _pair(law: AbstractLaw, method: str, given: Any) -> tuple[Any, Any]:
    if isinstance(given, tuple) and len(given) == 2:
        return given
    expected = {
        "init": "its memory and what it holds",
        "update": "its memory and what it holds",
        "__call__": "its command and the time derivative of its memory",
    }
    raise ValueError(
        f"{type(law).__name__}.{method} gives {given!r}: it must give two things, "
        f"{expected[method]}"
    )


def _require_like(law: AbstractLaw, what: str, given: Any, memory: Any) -> None:
    """Refuse a pytree that differs in structure or shapes from the one before."""
    shapes = [jax.tree.map(jnp.shape, tree) for tree in (given, memory)]
    if jax.tree.structure(given) != jax.tree.structure(memory):
        shapes = [jax.tree.structure(tree) for tree in (given, memory)]
    if shapes[0] != shapes[1]:
        raise ValueError(
            f"the {what} of {type(law).__name__} is {shapes[0]}: it must be like the "
            f"one before, {shapes[1]}"
        )


def reads_forces_between_cycles(law: AbstractLaw, state: EntryState) -> bool:
    """Whether a law uses its sensed forces at other times than its guidance cycles.

    This follows from the computation of the law. A continuous law has no cycles: True.
    """
    if isinstance(law, AbstractContinuousLaw):
        return True
    force = 0.0 * state.altitude
    before = begun(law, Measurement(state, force, force, force, force))

    def act(lift: Scalar, drag: Scalar) -> tuple[Controls, Any]:
        return commanded(
            law, force, Measurement(state, lift, drag, force, force), *before
        )

    return Traced(act, force, force).depends()
