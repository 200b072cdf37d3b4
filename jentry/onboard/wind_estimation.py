"""Estimation of the wind as a function of the altitude, from the sensed flow.

Navigation gives the velocity over the ground, and flow sensors that over the air; the wind
is the difference. Each sample contains the following information:

- Across the flow, by its direction. An angle with the standard deviation s corresponds to
  s V in m/s, at an airspeed V.
- Along the flow, by its speed, whose error is also a share of V. The forces alone do not
  reveal this component: lift and drag are proportional to the density times V^2, so a head
  wind w is equivalent to a factor (1 + w/V)^2 on the density. The direction alone reveals a
  head wind where the vehicle descends: a horizontal wind along the track turns the flow up
  or down by w sin(gamma) / V, at a path angle gamma.

The wind is therefore poorly observable at the start of an entry and well observable at its
end. The correlation length of the wind determines how far down a sample has an influence.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, optional_scalar, scalar
from ..motion.forces import velocity_over_air
from ..motion.state import EntryState
from ..world.wind import AbstractWind
from .flow_sensing import AirVelocity
from .profile_estimation import Learnt


class WindPrior(eqx.Module):
    """Prior of a horizontal wind: a Gauss-Markov process over the altitude.

    Its components to the east and to the north depart from their means independently, with
    one standard deviation. Two departures are normal with the correlation
    exp(-distance / correlation_length), as those of `RandomAltitudeProfile`. The wind
    below therefore depends on the last departure alone.
    """

    deviation: Scalar = scalar(unit="m/s", positive=True)
    """Standard deviation of each component"""
    correlation_length: Scalar = scalar(unit="m", positive=True)

    def carried(self, learnt: Learnt, distance: Scalar) -> Learnt:
        """Estimate at a distance (m) from the altitude of an estimate.

        The mean decays to both sides and has zero slope at the altitude of the estimate.
        Until the vehicle has moved on, a derivative over the altitude sees no wind shear.
        """
        likeness = jnp.exp(-jnp.abs(distance) / self.correlation_length)
        square = likeness * likeness
        fresh = self.deviation * self.deviation * (1.0 - square)
        return Learnt(
            likeness * learnt.weights, square * learnt.covariance + fresh * jnp.eye(2)
        )


class WindEstimate(eqx.Module):
    """Estimate of the wind at the altitude of the last sample."""

    altitude: Scalar
    """Altitude of the sample, m"""
    learnt: Learnt
    """Departures towards east and north (m/s), with their covariance"""


class EstimatedWind(AbstractWind):
    """A mean wind, plus an estimated horizontal departure."""

    mean: AbstractWind
    prior: WindPrior
    estimate: WindEstimate

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        mean_east, mean_north, up = self.mean.velocity(altitude)
        east, north = self._at(altitude).weights
        return mean_east + east, mean_north + north, up

    def deviations(self, altitude: Scalar) -> tuple[Scalar, Scalar]:
        """Standard deviations to the east and north (m/s), by the estimate."""
        east, north = jnp.sqrt(jnp.diag(self._at(altitude).covariance))
        return east, north

    def _at(self, altitude: Scalar) -> Learnt:
        known = self.estimate
        return self.prior.carried(known.learnt, altitude - known.altitude)


class WindEstimator(eqx.Module):
    """A Kalman filter of the horizontal wind over the altitude, from the sensed flow.

    The wind of the onboard model is the mean. Persistent errors, such as a misaligned
    sensor, are interpreted as wind. Include them in the deviations, which are those of
    independent samples. If the vehicle climbs again, the estimate is as uncertain for the
    air below as for the air above.
    """

    prior: WindPrior
    angle_deviation: Scalar = scalar(unit="rad", positive=True)
    """Standard deviation of a sample of the flow direction, along each of two axes"""
    speed_deviation: Scalar | None = optional_scalar(range=NOT_NEGATIVE)
    """Standard deviation of a sample of the airspeed, as a share of it; None if only the
    direction is used"""

    def start(self, like: Scalar) -> WindEstimate:
        """Estimate before the first sample."""
        nothing = 0.0 * like
        variance = self.prior.deviation * self.prior.deviation
        known = Learnt(nothing + jnp.zeros(2), (nothing + variance) * jnp.eye(2))
        return WindEstimate(nothing, known)

    def wind(self, mean: AbstractWind, estimate: WindEstimate) -> EstimatedWind:
        """Estimated wind over the altitude; `mean` is the wind of the model."""
        return EstimatedWind(mean, self.prior, estimate)

    def update(
        self,
        before: WindEstimate,
        mean: AbstractWind,
        state: EntryState,
        sensed: AirVelocity,
    ) -> WindEstimate:
        """Estimate after one more sample of the velocity over the air, in a state.

        If nothing is sensed the estimate is unchanged.
        """
        # Velocity over the air in the wind of the model, from which the estimate departs.
        expected = velocity_over_air(mean, state)
        along, right, above = sensed.axes()
        across = self.angle_deviation * sensed.speed
        axes = [(right, across), (above, across)]
        if self.speed_deviation is not None:
            axes.append((along, self.speed_deviation * sensed.speed))
        off_east = expected[0] - sensed.east
        off_north = expected[1] - sensed.north
        off_up = expected[2] - sensed.up
        learnt = self.prior.carried(before.learnt, state.altitude - before.altitude)
        for (east, north, up), deviation in axes:
            row = jnp.stack([east, north])
            departed = east * off_east + north * off_north + up * off_up
            learnt, _ = learnt.refined(row, departed, deviation * deviation)
        after = WindEstimate(state.altitude, learnt)
        # An exactly vertical flow has no lateral axes.
        tells = sensed.is_sensed & (sensed.east**2 + sensed.north**2 > 0.0)
        return jax.tree.map(lambda a, b: jnp.where(tells, a, b), after, before)
