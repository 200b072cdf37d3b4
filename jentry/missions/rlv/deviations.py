"""Measures of the laws of the RLV mission: peaks of the errors of drag and attitude."""

import jax.numpy as jnp

from ...fields import Scalar, optional_scalar, scalar
from ...motion.constraints import AbstractConstraint, PathPoint
from ...onboard.reference import Reference
from ...units import standard_gravity


class DragDeviation(AbstractConstraint):
    """Magnitude of the drag error below a velocity, in units of 9.80665 m/s2."""

    reference: Reference
    below: Scalar = scalar(unit="m/s", positive=True)
    limit: Scalar | None = optional_scalar()
    unit = "1"
    shown_unit = "g"

    def value(self, point: PathPoint) -> Scalar:
        velocity = point.state.velocity
        drag = self.reference.over_index(velocity)["drag"][0]
        error = jnp.abs(point.air.drag - drag) / standard_gravity
        return jnp.where(velocity < self.below, error, 0.0)


class AngleOfAttackDeviation(AbstractConstraint):
    """Deviation of the angle of attack from the reference below a velocity."""

    reference: Reference
    below: Scalar = scalar(unit="m/s", positive=True)
    limit: Scalar | None = optional_scalar(unit="rad")
    unit = "rad"

    def value(self, point: PathPoint) -> Scalar:
        velocity = point.state.velocity
        angle = self.reference.over_index(velocity)["angle_of_attack"][0]
        away = jnp.abs(point.controls.angle_of_attack - angle)
        return jnp.where(velocity < self.below, away, 0.0)
