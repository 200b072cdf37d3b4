"""Where a law switches: limits of its command, its gate, reversals of its bank.

A sharp switch is what flies. A smooth one is a surrogate for tuning: behind a sharp limit
the command no longer moves with the gains, and no gradient tells what a gate is worth, or
what it does to a flight that its bank is reversed one guidance cycle later.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._interpolation import clamp
from ..fields import Scalar, scalar


_NEGLIGIBLE = 1e-16
"""Of a share of one"""


class AbstractSwitching(eqx.Module):
    """How a law limits its command and how it begins."""

    shares_reversals: eqx.AbstractClassVar[bool]
    """Whether the sign of the bank takes values between -1 and 1, so that there is less
    lift than a bank has; else a flight that has less is stopped (`Outcome.NOT_A_BANK`)"""

    @abstractmethod
    def limited(self, command: Scalar) -> Scalar:
        """A wish for a cosine, within [-1, 1]."""

    @abstractmethod
    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        """`chosen` where the drag exceeds its gate (by m/s2), else `otherwise`."""

    @abstractmethod
    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        """Sign of the bank: `wanted` where a limit is exceeded (by m), else as it was."""


class Sharp(AbstractSwitching):
    """Clipped at the limits, begun and reversed at once: the exact law."""

    shares_reversals: ClassVar[bool] = False

    def limited(self, command: Scalar) -> Scalar:
        return jnp.clip(command, -1.0, 1.0)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        return jnp.where(excess >= 0.0, chosen, otherwise)

    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        return lax.stop_gradient(jnp.where(excess > 0.0, wanted, sign))


class Smooth(AbstractSwitching):
    """Switching with rounded corners, for gradients; never what is reported.

    The command bends over `command` before and behind its limits, and the gate opens
    over `gate` on both of its sides. As these go to zero the law becomes the sharp one.

    Reversals are those of `SmoothReversals`. With the command bent as well, near its
    limits there is lateral lift that the sharp law has not: where reversals are what
    matters, leave the limits sharp.
    """

    shares_reversals: ClassVar[bool] = True

    command: Scalar = scalar(0.05, positive=True)
    """Width of the rounded corner of the cosine of the bank"""
    gate: Scalar = scalar(0.2, unit="m/s2", positive=True)
    reversal: Scalar = scalar(2000.0, unit="m", positive=True)
    """Width over the predicted crossrange"""

    def limited(self, command: Scalar) -> Scalar:
        # The integral of the difference of two logistic steps at the limits. Far behind
        # them its slope is below rounding, and the difference would lose digits.
        width = self.command
        command = clamp(command, -1.0 - 40.0 * width, 1.0 + 40.0 * width)
        rise = jax.nn.softplus((command + 1.0) / width)
        bent = width * (rise - jax.nn.softplus((command - 1.0) / width)) - 1.0
        return clamp(bent, -1.0, 1.0)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        # Where one of them does not count, it may not be finite either.
        share = jax.nn.sigmoid(excess / self.gate)
        chosen = jnp.where(share < _NEGLIGIBLE, 0.0, chosen)
        otherwise = jnp.where(share >= 1.0, 0.0, otherwise)
        return share * chosen + (1.0 - share) * otherwise

    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        return _shared_out(sign, wanted, excess, self.reversal)


class SmoothReversals(AbstractSwitching):
    """Sharp limits and a sharp gate, and reversals that are shared out between cycles.

    The sharp law reverses in the first guidance cycle that begins outside the corridor, so
    that the instant of a reversal is a staircase of whatever moves it: flat, with jumps of
    one period, of which a derivative sees nothing. Here a cycle that begins outside by the
    excess e turns the share e / `reversal` of the lateral lift over, and all of it from
    e = `reversal` on. Let the excess grow by r in a cycle, and the limit be crossed a share
    f of a period before the cycle begins, so that e = f r. With `reversal` = r that cycle
    turns the share f, and the next one the rest: the impulse of the lateral lift is that of
    a reversal one period after the crossing, whatever f is. It moves with the crossing, as
    the instant of the sharp law (half a period after the crossing) does in the mean over f.
    With another `reversal` the delay depends on f, but without a jump, so that the mean of
    the derivatives is still the derivative of the mean: of this law, which for a wide
    `reversal` is another one than the sharp law. With one below r the sign swings to and
    fro, and the derivatives grow beyond all use: r is up to 500 m on Mars, and 300 m are
    too few. With 2000 m the derivatives of the mean square of the crossrange are within
    two standard errors of differences of the sharp law for gains and the floor of the
    corridor, and three times as large for its widening.
    """

    shares_reversals: ClassVar[bool] = True

    reversal: Scalar = scalar(2000.0, unit="m", positive=True)
    """Width in predicted crossrange: more than it moves against its limit in a cycle"""

    def limited(self, command: Scalar) -> Scalar:
        return Sharp().limited(command)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        return Sharp().beyond(excess, chosen, otherwise)

    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        return _shared_out(sign, wanted, excess, self.reversal)


def shares_reversals(law: Any) -> bool:
    """Whether any switching of a law shares reversals out."""

    def is_switching(node: Any) -> bool:
        return isinstance(node, AbstractSwitching)

    nodes = jax.tree.leaves(law, is_leaf=is_switching)
    return any(node.shares_reversals for node in nodes if is_switching(node))


def _shared_out(sign: Scalar, wanted: Scalar, excess: Scalar, width: Scalar) -> Scalar:
    share = clamp(excess / width, 0.0, 1.0)
    return sign + share * (wanted - sign)
