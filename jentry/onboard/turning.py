"""How a bank is turned, as a law believes it: at a rate, which takes a time to reach."""

import math

import equinox as eqx
import jax.numpy as jnp

from ..fields import Scalar, scalar
from ..motion.attitude import Swing


class BankTurning(eqx.Module):
    """Turns a bank at the largest rate, which it reaches by the largest acceleration.

    The bank after a time is a closed form, with no state to be integrated, so that a
    prediction may step over it as coarsely as over the motion. How the turn ends is left
    out: the bank stops where it is to be. Half a minute of a reversal ends so some tenths
    of a second early beside that of a `Response`.
    """

    rate: Scalar = scalar(unit="rad/s", positive=True)
    acceleration: Scalar = scalar(unit="rad/s2", positive=True)

    def flown(
        self,
        bank: Swing,
        wanted: Scalar,
        elapsed: Scalar,
        reverses_in: Scalar | float = math.inf,
    ) -> Scalar:
        """Bank some time after a given one, rad, positive to the right.

        **Arguments:**

        - `bank`: at the start, and its rate.
        - `wanted`: what is commanded since then, as it is commanded at the time, rad.
        - `elapsed`: time since the start, s.
        - `reverses_in`: time from the start to when the other side is commanded, s. What
          is turned until then is kept, and the turn to the other side begins at rest.
        """
        way = jnp.where(wanted < bank.angle, -1.0, 1.0)
        until = jnp.minimum(elapsed, reverses_in)
        angle = _nearer(bank.angle, wanted, self._turned(way * bank.rate, until))
        since = jnp.maximum(elapsed - reverses_in, 0.0)
        return _nearer(angle, -wanted, self._turned(0.0, since))

    def _turned(self, rate: Scalar | float, elapsed: Scalar) -> Scalar:
        """Angle that is turned in a time, rad, from any rate on, a larger one too."""
        a, lacks = self.acceleration, self.rate - rate
        left = jnp.maximum(jnp.abs(lacks) / a - elapsed, 0.0)
        late = 0.5 * (lacks * lacks / a - a * left * left)
        return self.rate * elapsed - jnp.sign(lacks) * late


def _nearer(angle: Scalar, target: Scalar, turned: Scalar) -> Scalar:
    """An angle after so much of a turn to another one, and not beyond."""
    away = angle - target
    left = jnp.maximum(jnp.abs(away) - turned, 0.0)
    return target + jnp.where(away < 0.0, -left, left)
