"""A guidance law of a user's own, written against the public names alone."""

import jax.numpy as jnp

import jentry
from jentry import Controls, Measurement, Scalar, scalar


class GlideAndTurn(jentry.AbstractContinuousLaw[None]):
    """Angle of attack linear in the velocity; bank that turns to a heading."""

    angle_at_rest: Scalar = scalar(unit="rad")
    slope: Scalar = scalar(unit="rad s/m")
    heading: Scalar = scalar(unit="rad")
    gain: Scalar = scalar()
    largest_bank: Scalar = scalar(unit="rad", positive=True)

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        state = measurement.state
        angle_of_attack = self.angle_at_rest + self.slope * state.velocity
        bank = self.largest_bank * jnp.tanh(self.gain * (self.heading - state.heading))
        return Controls.from_bank(bank, angle_of_attack), None
