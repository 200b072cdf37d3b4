"""Objective of the gain schedule of SX-2: small misses, and distance from the zero pair."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...analysis.frozen_loop import linearize
from ...fields import Scalar, Vector, table
from ...flight.flight import Flight
from ...flight.miss import misses
from ...flight.scenario import Scenario
from ...guidance.feedback_linearization import GroundTrackTracking
from ...guidance.tracking_gains import ScheduledEigenvalues
from ...motion.index import EnergyIndex
from ...tuning.losses import OfDistance, Values, power_mean
from ...units import nautical_mile


class Ends(eqx.Module):
    """End errors of a flight, and the eigenvalues of its law."""

    downrange: Scalar
    """Downrange error, n mile"""
    crossrange: Scalar
    eigenvalues: Float[Array, "n 7"]
    """Eigenvalues of (50) and (51) at the energies of the schedule"""


def ends(scenario: Scenario, flight: Flight) -> Ends:
    """The `Ends` of one flight: the `outputs` of `tune`."""
    law = scenario.guidance
    assert isinstance(law, GroundTrackTracking)
    assert isinstance(law.gains, ScheduledEigenvalues)
    missed = misses(scenario, flight)
    assert missed.crossrange is not None
    both = jnp.concatenate([law.gains.downrange, law.gains.crossrange], axis=1)
    return Ends(
        missed.downrange / nautical_mile, missed.crossrange / nautical_mile, both
    )


def _lengths(flown: Any) -> tuple[Values, Values]:
    return flown.downrange, flown.crossrange


class MissAndZeros(eqx.Module):
    """Power mean of the radial miss (n mile), and a penalty on eigenvalues near the zeros.

    The angle of attack changes the drag, which the law neglects: this gives a pair of
    transmission zeros. High gains drive eigenvalues of the loop towards them. Where the
    zeros are real, one of them is in the right half plane. The penalty is the mean square
    of the logarithm of an eigenvalue over a share of the pair's magnitude, where this
    logarithm is positive.
    """

    magnitude: Vector = table(positive=True)
    """Magnitude of the zero pair at the energies of the schedule, in units of one over the
    span"""
    share: float = eqx.field(default=1.0, static=True)
    """Share of the magnitude above which an eigenvalue is penalised"""
    weight: float = eqx.field(default=0.1, static=True)
    """Penalty, n mile, if all eigenvalues exceed this share by a factor of e"""

    def __call__(self, flown: Ends) -> Scalar:
        miss = OfDistance(power_mean, _lengths)(flown)
        # The magnitudes are equal for all flights.
        limit = self.share * self.magnitude[None, :, None]
        near = jnp.log(flown.eigenvalues / limit)
        return miss + self.weight * jnp.mean(jax.nn.relu(near) ** 2)


def zero_pair(scenario: Scenario, points: int = 24) -> Float[np.ndarray, " n"]:
    """Magnitude of the zero pair along the reference, at the energies of the schedule.

    It is in units of one over the energy span, and interpolated linearly between the points
    of `linearize`.

    **Raises:** `ValueError` for a law without a schedule, or a flight without zeros.
    """
    law = scenario.guidance
    if not isinstance(law, GroundTrackTracking) or not isinstance(
        law.gains, ScheduledEigenvalues
    ):
        raise ValueError(
            f"{type(law).__name__} has no schedule of eigenvalues: take the law "
            "scheduled"
        )
    loop = linearize(scenario, EnergyIndex(), points)
    if loop.zeros is None:
        raise ValueError(f"the vehicle has no zeros here: {loop.without_zeros}")
    size = np.nanmin(np.where(loop.zeros == 0.0, np.nan, np.abs(loop.zeros)), axis=1)
    rising = np.argsort(loop.index)
    return np.interp(law.gains.energy, loop.index[rising], size[rising] * loop.span)
