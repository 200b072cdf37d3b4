"""Model of the turning of a bank in a law: at a rate that takes time to build up."""

import math

import equinox as eqx
import jax.numpy as jnp

from ..fields import Scalar, scalar
from ..motion.attitude import Swing


class BankTurning(eqx.Module):
    """Turns a bank at the largest rate, which is reached at the largest acceleration.

    The bank after a time is a closed form without integrated states, so that the steps of
    a prediction may be as coarse as for the motion alone. The deceleration at the end of
    the turn is neglected: the bank stops at the commanded value. A reversal of half a
    minute then ends some tenths of a second earlier than that of a `Response`.
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
        """Bank at a time after an initial bank, rad, positive to the right.

        **Arguments:**

        - `bank`: initial bank and its rate.
        - second argument: bank that is commanded for the side at the start, at its value
          of the present time, rad.
        - `elapsed`: time since the start, s.
        - `reverses_in`: time from the start to the command of the other side, s. The turn
          to the other side begins at the bank that is reached by then, with zero rate.
        """
        way = jnp.where(wanted < bank.angle, -1.0, 1.0)
        until = jnp.minimum(elapsed, reverses_in)
        angle = _nearer(bank.angle, wanted, self._turned(way * bank.rate, until))
        since = jnp.maximum(elapsed - reverses_in, 0.0)
        return _nearer(angle, -wanted, self._turned(0.0, since))

    def _turned(self, rate: Scalar | float, elapsed: Scalar) -> Scalar:
        """Angle turned in a time, rad, from an initial rate that may exceed `rate`."""
        a, lacks = self.acceleration, self.rate - rate
        left = jnp.maximum(jnp.abs(lacks) / a - elapsed, 0.0)
        late = 0.5 * (lacks * lacks / a - a * left * left)
        return self.rate * elapsed - jnp.sign(lacks) * late


def _nearer(angle: Scalar, target: Scalar, turned: Scalar) -> Scalar:
    """Angle after a turn by `turned` towards a target, but not beyond it."""
    away = angle - target
    left = jnp.maximum(jnp.abs(away) - turned, 0.0)
    return target + jnp.where(away < 0.0, -left, left)
