"""Gains for tracking a ground track: constant, or by eigenvalues over the energy."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._interpolation import clamp, interval
from ..fields import Scalar, Vector, table


class AbstractTrackingGains(eqx.Module):
    """Gains of equation (49), which may depend on the energy.

    The gains are for the energy in units of `GroundTrackModel.energy_span`.
    """

    @abstractmethod
    def at(self, energy: Scalar) -> tuple[Float[Array, " 4"], Float[Array, " 3"]]:
        """k11 to k14 and k21 to k23 at an energy (J/kg): shapes (4,) and (3,)."""


class TrackingGains(AbstractTrackingGains):
    """Constant gains of equation (49).

    Since the energy falls, errors decay with eigenvalues in the right half plane. The
    signs of the gains therefore alternate, beginning with a negative one.
    """

    downrange: Vector = table()
    """k11 to k14, shape (4,): gains on the second and first derivative of the error, the
    error and its integral"""
    crossrange: Vector = table()
    """k21 to k23, shape (3,): gains on the first derivative, the error and its integral"""

    def __check_init__(self):
        for name, count in (("downrange", 4), ("crossrange", 3)):
            shape = getattr(self, name).shape
            if shape != (count,):
                raise ValueError(f"{name} has shape {shape}: expected {count} gains")

    def at(self, energy: Scalar) -> tuple[Float[Array, " 4"], Float[Array, " 3"]]:
        return self.downrange, self.crossrange

    @classmethod
    def from_eigenvalues(
        cls, downrange: Sequence[Any], crossrange: Sequence[Any]
    ) -> "TrackingGains":
        """Gains for four real eigenvalues of (50) and three of (51), per energy span.

        The gains are differentiable in the eigenvalues. Positive eigenvalues are stable.

        **Raises:** `ValueError` for a wrong number of eigenvalues.
        """
        return cls(_polynomial(downrange), _polynomial(crossrange))


def _polynomial(roots: Sequence[Any]) -> Vector:
    """Coefficients of the polynomial with these roots, without the leading one."""
    coefficients = [jnp.asarray(1.0)]
    for root in roots:
        shifted = [*coefficients, jnp.zeros(())]
        below = [jnp.zeros(()), *coefficients]
        coefficients = [a - root * b for a, b in zip(shifted, below, strict=True)]
    return jnp.stack(coefficients[1:])


class ScheduledEigenvalues(AbstractTrackingGains):
    """Gains by real eigenvalues of (50) and (51) that vary with the energy.

    The eigenvalues are interpolated linearly between the energies of the table, and
    constant beyond. Their unit is one over the energy span, as in
    `TrackingGains.from_eigenvalues`. The loop frozen at any energy is stable.
    """

    energy: Vector = table(unit="J/kg", increasing=True)
    """Shape (n,)"""
    downrange: Float[Array, "n 4"] = table(positive=True)
    """Eigenvalues of (50) at these energies"""
    crossrange: Float[Array, "n 3"] = table(positive=True)
    """Eigenvalues of (51) at these energies"""

    def __check_init__(self):
        for name, count in (("downrange", 4), ("crossrange", 3)):
            shape = getattr(self, name).shape
            wanted = (*self.energy.shape, count)
            if shape != wanted or len(shape) != 2:
                raise ValueError(
                    f"{name} has shape {shape}: expected {count} eigenvalues at each of "
                    f"the energies, of which the shape is {self.energy.shape}"
                )

    def at(self, energy: Scalar) -> tuple[Float[Array, " 4"], Float[Array, " 3"]]:
        before = interval(self.energy, energy)
        low, high = self.energy[before], self.energy[before + 1]
        share = clamp((energy - low) / (high - low), 0.0, 1.0)

        def between(values):
            return values[before] + share * (values[before + 1] - values[before])

        down, cross = between(self.downrange), between(self.crossrange)
        return _polynomial(list(down)), _polynomial(list(cross))
