"""State and controls of the vehicle."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from .._math import safe_arccos, sincos
from .._printed import as_text
from ..fields import ABOVE_GROUND, QUARTER, Flag, Scalar, in_unit, scalar


_ROUNDING = 1e-9
"""Rounding of a sum of squares that is one; it is larger in single precision"""


class EntryState(eqx.Module):
    """Position and planet-relative velocity of a point mass, or their time derivative.

    Conventions of the whole package: altitude above the sphere; longitude positive east;
    velocity relative to the rotating planet; flight-path angle positive up; heading
    clockwise from north, so that 90 degrees is east. These coordinates are singular in
    vertical flight, over the poles and at rest: `Outcome.SINGULAR`. `VectorDynamics` flies
    through these points.
    """

    altitude: Scalar = scalar(unit="m", range=ABOVE_GROUND)
    longitude: Scalar = scalar(unit="rad")
    latitude: Scalar = scalar(unit="rad", range=QUARTER)
    velocity: Scalar = scalar(unit="m/s", positive=True)
    flight_path_angle: Scalar = scalar(unit="rad", range=QUARTER)
    heading: Scalar = scalar(unit="rad")

    __str__ = as_text


class Controls(eqx.Module):
    """Angle of attack and bank: the command of a law, or the controls of the vehicle.

    The bank is stored as its cosine and sine, which are all that the dynamics needs. It
    turns the lift about the velocity; a positive bank turns right. The squares of cosine
    and sine must add up to one: a flight whose law commands another sum is stopped with
    `Outcome.NOT_A_BANK`. Only a law with a surrogate switching, which distributes
    reversals over time, may have a smaller sum.
    """

    angle_of_attack: Scalar = scalar(unit="rad")
    cos_bank: Scalar = scalar()
    sin_bank: Scalar = scalar()

    __str__ = as_text

    @classmethod
    def from_bank(cls, bank_angle: Scalar, angle_of_attack: Scalar) -> "Controls":
        """Controls with a bank angle in radians."""
        sine, cosine = sincos(bank_angle)
        return cls(angle_of_attack, cosine, sine)

    def off_a_bank(self, shares_reversals: bool = False) -> Scalar:
        """Difference of the sum of the squares of cosine and sine from one.

        It is zero within rounding of one and, if `shares_reversals`, for any sum of one or
        less. It is never negative, and has no derivative. Numbers that are not finite are
        not checked here.
        """
        excess = self.cos_bank * self.cos_bank + self.sin_bank * self.sin_bank - 1.0
        rounding = max(_ROUNDING, 32.0 * float(jnp.finfo(jnp.result_type(excess)).eps))
        off = excess if shares_reversals else jnp.abs(excess)
        return lax.stop_gradient(jnp.where(off > rounding, off, 0.0))

    def unless(self, wrong: Flag) -> "Controls":
        """These controls; the cosine of the bank is NaN where they are `wrong`.

        Every motion and every attitude uses the cosine.
        """
        cosine = jnp.where(wrong, jnp.nan, self.cos_bank)
        return Controls(self.angle_of_attack, cosine, self.sin_bank)

    @property
    @in_unit("rad")
    def bank_angle(self) -> Scalar:
        """Bank angle in [-pi, pi], rad; positive to the right."""
        return jnp.where(self.sin_bank < 0.0, -1.0, 1.0) * safe_arccos(self.cos_bank)
