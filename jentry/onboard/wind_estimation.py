"""The wind as a function of the altitude, learnt on the way down from the sensed flow.

Navigation knows the velocity over the ground, flow sensors that over the air; the wind is
the difference. What each sample can tell of it:

- Across the flow, by its direction. An angle of standard deviation s is one of s V in m/s,
  at an airspeed V.
- Along the flow, by its speed, and so by a share of V as well. From the forces alone it
  cannot be seen: lift and drag go with the density times V^2, so that a head wind w is one
  with a factor (1 + w/V)^2 on the density. Direction alone sees a head wind where the
  vehicle descends: a horizontal wind along the track turns the flow up or down by
  w sin(gamma) / V, at a path angle gamma.

So the wind is hidden at the start of an entry and plain at its end. How far down a sample
counts is told by the correlation length of the wind.
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
    """A horizontal wind before anything is sensed: a Gauss-Markov process of the altitude.

    Towards east and towards north it departs from its mean independently and with one
    standard deviation. Two departures are normal with the correlation
    exp(-distance / correlation_length), as those of `RandomAltitudeProfile`: what is below
    hangs on the last departure alone.
    """

    deviation: Scalar = scalar(unit="m/s", positive=True)
    """Standard deviation of each component"""
    correlation_length: Scalar = scalar(unit="m", positive=True)

    def carried(self, learnt: Learnt, distance: Scalar) -> Learnt:
        """What is known at a distance (m) from where something is known.

        The mean falls off to both sides, so that it has no slope just there: until the
        vehicle has gone on, a derivative by the altitude sees no shear of the wind.
        """
        likeness = jnp.exp(-jnp.abs(distance) / self.correlation_length)
        square = likeness * likeness
        fresh = self.deviation * self.deviation * (1.0 - square)
        return Learnt(
            likeness * learnt.weights, square * learnt.covariance + fresh * jnp.eye(2)
        )


class WindEstimate(eqx.Module):
    """What is known of the wind where it was last sensed."""

    altitude: Scalar
    """Of the sample, m"""
    learnt: Learnt
    """Departures towards east and north (m/s), with their covariance"""


class EstimatedWind(AbstractWind):
    """A wind, and what is known of a horizontal departure from it."""

    mean: AbstractWind
    prior: WindPrior
    estimate: WindEstimate

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        mean_east, mean_north, up = self.mean.velocity(altitude)
        east, north = self._at(altitude).weights
        return mean_east + east, mean_north + north, up

    def deviations(self, altitude: Scalar) -> tuple[Scalar, Scalar]:
        """Standard deviations towards east and north (m/s), as the estimate has it."""
        east, north = jnp.sqrt(jnp.diag(self._at(altitude).covariance))
        return east, north

    def _at(self, altitude: Scalar) -> Learnt:
        known = self.estimate
        return self.prior.carried(known.learnt, altitude - known.altitude)


class WindEstimator(eqx.Module):
    """A Kalman filter of the horizontal wind, over the altitude, by the sensed flow.

    A wind of the onboard model is the mean. Errors that last, such as a misaligned sensor,
    are taken for wind: state them in the deviations, which are those of independent
    samples. A vehicle that climbs again knows of the air below as much as of that above.
    """

    prior: WindPrior
    angle_deviation: Scalar = scalar(unit="rad", positive=True)
    """Standard deviation of a sample of the flow's direction, along each of two axes"""
    speed_deviation: Scalar | None = optional_scalar(range=NOT_NEGATIVE)
    """Of a sample of the airspeed, as a share of it; None where the direction alone is
    read"""

    def start(self, like: Scalar) -> WindEstimate:
        """Before the first sample."""
        nothing = 0.0 * like
        variance = self.prior.deviation * self.prior.deviation
        known = Learnt(nothing + jnp.zeros(2), (nothing + variance) * jnp.eye(2))
        return WindEstimate(nothing, known)

    def wind(self, mean: AbstractWind, estimate: WindEstimate) -> EstimatedWind:
        """As it is believed to be over the altitude; `mean` is that of the model."""
        return EstimatedWind(mean, self.prior, estimate)

    def update(
        self,
        before: WindEstimate,
        mean: AbstractWind,
        state: EntryState,
        sensed: AirVelocity,
    ) -> WindEstimate:
        """After one more sample of the velocity over the air, in a state.

        Where nothing is sensed it is what it was.
        """
        # In the wind of the model, from which the estimate departs.
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
        # A flow that is exactly vertical has no sides.
        tells = sensed.is_sensed & (sensed.east**2 + sensed.north**2 > 0.0)
        return jax.tree.map(lambda a, b: jnp.where(tells, a, b), after, before)
