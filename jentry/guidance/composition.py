"""Composition of an angle-of-attack law and a bank law into one law."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._dependence import Traced
from .._interpolation import clamp
from .._math import safe_arccos, safe_sqrt, sincos
from ..fields import Scalar, scalar
from ..motion.state import Controls
from ..onboard.measurement import Measurement
from .cycle import AbstractCycle, FixedCycle
from .law import (
    AbstractContinuousLaw,
    AbstractLaw,
    AbstractSampledLaw,
    AngleOfAttackCommand,
    Tracked,
    begun,
    commanded,
    decided,
)


HALF_TURN = 3.141592653589793
"""rad; the largest bank"""


class BankLimits(eqx.Module):
    """How far an angle-of-attack law may change the bank that a bank law commands."""

    increment: Scalar = scalar(HALF_TURN, unit="rad", positive=True)
    """Largest change of the magnitude of the bank, up or down"""
    largest: Scalar = scalar(HALF_TURN, unit="rad", positive=True)
    """Largest magnitude of the bank after the change"""


class Parts(eqx.Module):
    """Memories, or held decisions, of the two laws."""

    angle_of_attack: Any
    bank: Any


def compose(
    angle_of_attack: AbstractLaw, bank: AbstractLaw, limits: BankLimits | None = None
) -> "ContinuousComposition | SampledComposition":
    """Compose a law that commands the angle of attack and one that commands the bank.

    The angle-of-attack law acts first. The bank law then reads the commanded angle of
    attack as `trim_angle_of_attack` and commands the bank as it does alone, lateral logic
    included. Last, the magnitude of the bank is changed by the increment that the
    angle-of-attack law requests, within the limits; the side is unchanged.

    Each of the two laws is continuous or sampled. If one of them is sampled the
    composition is sampled, and a continuous law in it still acts at every instant.
    `Sampled(compose(...), period)` holds the commands of two continuous laws together.

    **Arguments:**

    - `angle_of_attack`: a law whose command is an `AngleOfAttackCommand`.
    - `bank`: a law whose command is `Controls`, at the trim angle of attack.
    - `limits`: limits of the change of the bank and of the bank after the change; none by
      default.

    **Raises:** `ValueError` if the guidance cycles of the two laws differ; also in flight,
    if the bank law commands another angle of attack than the trim angle.

        law = compose(AngleOfAttackProfile(schedule), ObserverDragTracking(...))
    """
    limits = BankLimits() if limits is None else limits
    laws = angle_of_attack, bank
    cycles = [law.cycle for law in laws if isinstance(law, AbstractSampledLaw)]
    if not cycles:
        return ContinuousComposition(angle_of_attack, bank, limits)
    for cycle in cycles:
        if not isinstance(cycle, FixedCycle):
            raise ValueError(
                f"a law with a {type(cycle).__name__} cannot be composed: its guidance "
                "cycle must be a FixedCycle"
            )
        if cycle.period != cycles[0].period:
            raise ValueError(
                f"the guidance cycle of the angle-of-attack law is {cycles[0].period} s "
                f"and that of the bank law {cycle.period} s: they must be equal"
            )
    return SampledComposition(
        angle_of_attack=angle_of_attack, bank=bank, limits=limits, cycle=cycles[0]
    )


class ContinuousComposition(AbstractContinuousLaw[Parts]):
    """A composition of two continuous laws; see `compose`."""

    angle_of_attack: AbstractLaw
    bank: AbstractLaw
    limits: BankLimits

    def init(self, measurement: Measurement) -> Parts:
        return _begun(self, measurement)[0]

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Parts
    ) -> tuple[Controls, Parts]:
        return _commanded(self, time, measurement, memory, Parts(None, None))

    def tracked(
        self, time: Scalar, measurement: Measurement, held: None
    ) -> Tracked | None:
        return _tracked(self, time, measurement, Parts(None, None))


class SampledComposition(AbstractSampledLaw[Parts, Parts]):
    """A composition of two laws, at least one of them sampled; see `compose`."""

    angle_of_attack: AbstractLaw
    bank: AbstractLaw
    limits: BankLimits
    cycle: AbstractCycle

    def caveats(self, held: Parts) -> dict[str, Scalar]:
        found = {}
        for law, part in (
            (self.angle_of_attack, held.angle_of_attack),
            (self.bank, held.bank),
        ):
            if isinstance(law, AbstractSampledLaw):
                found |= law.caveats(part)
        return found

    def init(self, measurement: Measurement) -> tuple[Parts, Parts]:
        return _begun(self, measurement)

    def update(
        self, time: Scalar, measurement: Measurement, memory: Parts, held: Parts
    ) -> tuple[Parts, Parts]:
        first, second = self.angle_of_attack, self.bank
        angle = memory.angle_of_attack, held.angle_of_attack
        bank = memory.bank, held.bank
        if isinstance(first, AbstractSampledLaw):
            angle = decided(first, time, measurement, *angle)
        wish, _ = commanded(first, time, measurement, *angle, AngleOfAttackCommand)
        if isinstance(second, AbstractSampledLaw):
            bank = decided(second, time, _at(measurement, wish), *bank)
        return Parts(angle[0], bank[0]), Parts(angle[1], bank[1])

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: Parts, held: Parts
    ) -> tuple[Controls, Parts]:
        return _commanded(self, time, measurement, memory, held)

    def tracked(
        self, time: Scalar, measurement: Measurement, held: Parts
    ) -> Tracked | None:
        return _tracked(self, time, measurement, held)


Composition = ContinuousComposition | SampledComposition


def _at(measurement: Measurement, wish: AngleOfAttackCommand) -> Measurement:
    """Measurement of the bank law: it trims at the commanded angle of attack."""
    return eqx.tree_at(
        lambda m: m.trim_angle_of_attack, measurement, wish.angle_of_attack
    )


def _tracked(
    law: Composition, time: Scalar, measurement: Measurement, held: Parts
) -> Tracked | None:
    """Outputs that both laws track, and the controls of both."""
    both = (
        law.angle_of_attack.tracked(time, measurement, held.angle_of_attack),
        law.bank.tracked(time, measurement, held.bank),
    )
    found = [each for each in both if each is not None]
    if not found:
        return None
    errors = (error for each in found for error in each.errors)
    return Tracked(tuple(errors), tuple(name for each in found for name in each.by))


def _begun(law: Composition, measurement: Measurement) -> tuple[Parts, Parts]:
    time = 0.0 * measurement.drag
    angle = begun(law.angle_of_attack, measurement)
    wish, _ = commanded(
        law.angle_of_attack, time, measurement, *angle, AngleOfAttackCommand
    )
    _require_trim(law.bank, time, measurement)
    bank = begun(law.bank, _at(measurement, wish))
    return Parts(angle[0], bank[0]), Parts(angle[1], bank[1])


def _commanded(
    law: Composition,
    time: Scalar,
    measurement: Measurement,
    memory: Parts,
    held: Parts,
) -> tuple[Controls, Parts]:
    wish, angle_rate = commanded(
        law.angle_of_attack,
        time,
        measurement,
        memory.angle_of_attack,
        held.angle_of_attack,
        AngleOfAttackCommand,
    )
    measurement = _at(measurement, wish)
    controls, bank_rate = commanded(law.bank, time, measurement, memory.bank, held.bank)
    cosine, sine = controls.cos_bank, controls.sin_bank
    if wish.bank_increment is not None:
        most = law.limits.increment
        increment = clamp(wish.bank_increment, -most, most)
        cosine, sine = _banked_more(cosine, sine, increment, law.limits.largest)
    controls = Controls(wish.angle_of_attack, cosine, sine)
    return controls, Parts(angle_rate, bank_rate)


def _banked_more(
    cosine: Scalar, sine: Scalar, increment: Scalar, largest: Scalar
) -> tuple[Scalar, Scalar]:
    """Cosine and sine of a bank with a changed magnitude, to the same side.

    For a level bank the side is the sign of its zero, which `turned` sets. If a smooth
    switching shares out a reversal, the lateral lift is less than that of the bank; this
    share is unchanged.
    """
    magnitude = clamp(safe_arccos(cosine) + increment, 0.0, largest)
    whole = safe_sqrt(1.0 - cosine * cosine)
    there = whole > 0.0
    share = jnp.where(there, sine / jnp.where(there, whole, 1.0), 1.0)
    side = jnp.where(there, share, jnp.where(jnp.signbit(sine), -1.0, 1.0))
    sine, cosine = sincos(magnitude)
    return cosine, side * sine


def _require_trim(law: AbstractLaw, time: Scalar, measurement: Measurement) -> None:
    """Refuse a bank law whose angle of attack would be overruled silently."""
    if not flies_at_trim(law, time, measurement):
        raise ValueError(
            f"{type(law).__name__} commands an angle of attack of its own: beside an "
            "angle-of-attack law it must command measurement.trim_angle_of_attack"
        )


def flies_at_trim(law: AbstractLaw, time: Scalar, measurement: Measurement) -> bool:
    """Whether a law commands the trim angle of attack of the vehicle."""

    def act(angle: Scalar) -> Controls:
        turned = eqx.tree_at(lambda m: m.trim_angle_of_attack, measurement, angle)
        return commanded(law, time, turned, *begun(law, turned))[0]

    acting = Traced(act, measurement.trim_angle_of_attack)
    return acting.independent(lambda controls: controls.angle_of_attack) is None
