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
counts is told by the prior of the wind over the altitude.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Scalar, optional_scalar, scalar
from ..motion.forces import velocity_over_air
from ..motion.state import EntryState
from ..world.wind import AbstractWind
from .flow_sensing import AirVelocity
from .profile_estimation import Departure, Learnt, deviation_of


class EstimatedWind(AbstractWind):
    """A wind, and a horizontal departure from it with weights."""

    mean: AbstractWind
    departure: Departure
    learnt: Learnt
    """Of the weights towards east, and of those towards north behind them"""

    def velocity(self, altitude: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        east, north, up = self.mean.velocity(altitude)
        basis = self.departure.basis(altitude)
        weights = self.learnt.weights.reshape(2, -1)
        return (
            east + jnp.sum(basis * weights[0]),
            north + jnp.sum(basis * weights[1]),
            up,
        )

    def deviations(self, altitude: Scalar) -> tuple[Scalar, Scalar]:
        """Standard deviations towards east and north (m/s), as the estimate has it."""
        basis = self.departure.basis(altitude)
        nothing = jnp.zeros_like(basis)
        return (
            deviation_of(jnp.concatenate([basis, nothing]), self.learnt),
            deviation_of(jnp.concatenate([nothing, basis]), self.learnt),
        )


class WindEstimator(eqx.Module):
    """Recursive least squares of a horizontal wind over the altitude, by its direction.

    `departure` says in m/s what the wind may be towards east, and independently towards
    north, before anything is sensed; a wind of the onboard model is its mean. Errors that
    last, such as a misaligned sensor, are taken for wind: state them in the deviations,
    which are those of independent samples.
    """

    departure: Departure
    angle_deviation: Scalar = scalar(unit="rad", range=NOT_NEGATIVE)
    """Standard deviation of a sample of the flow's direction, along each of two axes"""
    speed_deviation: Scalar | None = optional_scalar(range=NOT_NEGATIVE)
    """Of a sample of the airspeed, as a share of it; None where the direction alone is
    read"""
    misfit: Scalar = scalar(1.0, unit="m/s", positive=True)
    """Standard deviation of what the departure cannot be"""

    def start(self, like: Scalar) -> Learnt:
        """Before the first sample."""
        nothing = 0.0 * like
        count = 2 * self.departure.basis(nothing).shape[0]
        return Learnt(nothing + jnp.zeros(count), nothing + jnp.eye(count))

    def wind(self, mean: AbstractWind, learnt: Learnt) -> EstimatedWind:
        """As it is believed to be over the altitude; `mean` is that of the model."""
        return EstimatedWind(mean, self.departure, learnt)

    def update(
        self, before: Learnt, mean: AbstractWind, state: EntryState, sensed: AirVelocity
    ) -> Learnt:
        """After one more sample of the velocity over the air, in a state.

        Where nothing is sensed it is what it was.
        """
        # In the wind of the model, from which the estimate departs.
        expected = velocity_over_air(mean, state)
        basis = self.departure.basis(state.altitude)
        along, right, above = sensed.axes()
        across = self.angle_deviation * sensed.speed
        axes = [(right, across), (above, across)]
        if self.speed_deviation is not None:
            axes.append((along, self.speed_deviation * sensed.speed))
        off_east = expected[0] - sensed.east
        off_north = expected[1] - sensed.north
        off_up = expected[2] - sensed.up
        learnt = before
        for (east, north, up), deviation in axes:
            row = jnp.concatenate([east * basis, north * basis])
            departed = east * off_east + north * off_north + up * off_up
            variance = deviation * deviation + self.misfit * self.misfit
            learnt, _ = learnt.refined(row, departed, variance)
        return jax.tree.map(
            lambda a, b: jnp.where(sensed.is_sensed, a, b), learnt, before
        )
