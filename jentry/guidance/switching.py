"""Where a law switches: the limits of its command and the gate of its reference.

A sharp switch is what flies. A smooth one is a surrogate for tuning: behind a sharp limit
the command no longer moves with the gains, and no gradient tells what a gate is worth.
"""

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp

from .._interpolation import clamp
from .._types import Scalar, scalar


_NEGLIGIBLE = 1e-16
"""Of a share of one"""


class AbstractSwitching(eqx.Module):
    """How a law limits its command and how it begins."""

    @abstractmethod
    def limited(self, command: Scalar) -> Scalar:
        """A wish for a cosine, within [-1, 1]."""

    @abstractmethod
    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        """`chosen` where the drag exceeds its gate (by m/s2), else `otherwise`."""


class Sharp(AbstractSwitching):
    """Clipped at the limits, and begun at once: the exact law."""

    def limited(self, command: Scalar) -> Scalar:
        return jnp.clip(command, -1.0, 1.0)

    def beyond(self, excess: Scalar, chosen: Scalar, otherwise: Scalar) -> Scalar:
        return jnp.where(excess >= 0.0, chosen, otherwise)


class Smooth(AbstractSwitching):
    """The same with rounded corners, for gradients; never what is reported.

    The command bends over `command` before and behind its limits, and the gate opens
    over `gate` on both of its sides. As these go to zero the law becomes the sharp one.
    """

    command: Scalar = scalar(0.05, positive=True)
    """Of the cosine of the bank"""
    gate: Scalar = scalar(0.2, unit="m/s2", positive=True)

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
