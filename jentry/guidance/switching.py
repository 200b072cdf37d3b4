"""Switching of a law: limits of its command, its gate, and its bank reversals.

Sharp switching is the law itself. Smooth switching is a surrogate for tuning. Behind a
sharp limit the command does not depend on the gains, and no gradient shows the effect of a
gate or of a bank reversal that is delayed by one guidance cycle.
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
"""Share, out of one, below which a value has no effect"""


class AbstractSwitching(eqx.Module):
    """How a law limits its command, opens its gate and reverses its bank."""

    shares_reversals: eqx.AbstractClassVar[bool]
    """Whether the sign of the bank takes values between -1 and 1, so that the lift is less
    than that of the bank. Otherwise such a flight is stopped (`Outcome.NOT_A_BANK`)"""

    @abstractmethod
    def limited(self, command: Scalar) -> Scalar:
        """A requested cosine, limited to [-1, 1]."""

    @abstractmethod
    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        """`chosen` where the drag exceeds its gate (by m/s2), else `otherwise`."""

    @abstractmethod
    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        """Sign of the bank: the new one if a limit is exceeded (by m), else unchanged."""


class Sharp(AbstractSwitching):
    """Clipped at the limits, with instant gates and reversals: the exact law."""

    shares_reversals: ClassVar[bool] = False

    def limited(self, command: Scalar) -> Scalar:
        return jnp.clip(command, -1.0, 1.0)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        return jnp.where(excess >= 0.0, chosen, otherwise)

    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        return lax.stop_gradient(jnp.where(excess > 0.0, wanted, sign))


class Smooth(AbstractSwitching):
    """Smooth switching, for gradients; results are never reported with it.

    The command bends over a width `command` at its limits, and the gate opens over `gate`
    on both sides. As these widths go to zero the law becomes the sharp one.

    Reversals are those of `SmoothReversals`. Since the command is also smoothed, it has
    lateral lift near its limits that the sharp law does not have. If reversals are the
    subject, use sharp limits.
    """

    shares_reversals: ClassVar[bool] = True

    command: Scalar = scalar(0.05, positive=True)
    """Width of the rounded corner of the cosine of the bank"""
    gate: Scalar = scalar(0.2, unit="m/s2", positive=True)
    reversal: Scalar = scalar(2000.0, unit="m", positive=True)
    """Width in predicted crossrange over which a reversal is distributed"""

    def limited(self, command: Scalar) -> Scalar:
        # The integral of the difference of two logistic steps at the limits. Far behind
        # them its slope is below rounding, and the difference would lose digits.
        width = self.command
        command = clamp(command, -1.0 - 40.0 * width, 1.0 + 40.0 * width)
        rise = jax.nn.softplus((command + 1.0) / width)
        bent = width * (rise - jax.nn.softplus((command - 1.0) / width)) - 1.0
        return clamp(bent, -1.0, 1.0)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        # The branch that has no effect may not be finite.
        share = jax.nn.sigmoid(excess / self.gate)
        chosen = jnp.where(share < _NEGLIGIBLE, 0.0, chosen)
        otherwise = jnp.where(share >= 1.0, 0.0, otherwise)
        return share * chosen + (1.0 - share) * otherwise

    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        return _shared_out(sign, wanted, excess, self.reversal)


class SmoothReversals(AbstractSwitching):
    """Sharp limits and a sharp gate, with reversals that are distributed over cycles.

    The sharp law reverses in the first guidance cycle that begins outside the corridor. The
    time of a reversal is therefore a staircase function of every parameter: it is constant,
    with jumps of one period, and its derivative is zero. Here a cycle that begins outside
    the corridor by the excess e reverses the share e / `reversal` of the lateral lift, and
    all of it for an excess of `reversal` or more.

    Let the excess grow by r in a cycle, and let the limit be crossed a share f of a period
    before the cycle begins, so that e = f r. With `reversal` = r this cycle reverses the
    share f, and the next one the rest. The impulse of the lateral lift is that of a
    reversal one period after the crossing, for any f. It moves with the crossing. The time
    of the sharp reversal (half a period after the crossing) does so in the mean over f.

    With another `reversal` the delay depends on f, but without a jump, so that the mean of
    the derivatives is still the derivative of the mean. This is that of the smooth law,
    which differs from the sharp law for a wide `reversal`. With a `reversal` below r the
    sign oscillates, and the derivatives become useless: r is up to 500 m on Mars, and 300 m
    are too few. With 2000 m the derivatives of the mean square of the crossrange are within
    two standard errors of differences of the sharp law for gains and the floor of the
    corridor, and three times as large for its widening.
    """

    shares_reversals: ClassVar[bool] = True

    reversal: Scalar = scalar(2000.0, unit="m", positive=True)
    """Width in predicted crossrange; larger than the change of the excess in a cycle"""

    def limited(self, command: Scalar) -> Scalar:
        return Sharp().limited(command)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        return Sharp().beyond(excess, chosen, otherwise)

    def reversed(self, sign: Scalar, wanted: Scalar, excess: Scalar) -> Scalar:
        return _shared_out(sign, wanted, excess, self.reversal)


def shares_reversals(law: Any) -> bool:
    """Whether any switching of a law distributes reversals over cycles."""

    def is_switching(node: Any) -> bool:
        return isinstance(node, AbstractSwitching)

    nodes = jax.tree.leaves(law, is_leaf=is_switching)
    return any(node.shares_reversals for node in nodes if is_switching(node))


def _shared_out(sign: Scalar, wanted: Scalar, excess: Scalar, width: Scalar) -> Scalar:
    share = clamp(excess / width, 0.0, 1.0)
    return sign + share * (wanted - sign)
