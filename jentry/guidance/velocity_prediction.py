"""The velocity at the target, predicted on board by flying the model along the curve."""

from abc import abstractmethod

import equinox as eqx

from .._types import Scalar
from ..onboard.bezier import PathPoint
from ..onboard.estimation import Factors
from ..onboard.model import OnboardModel
from .anchoring import AbstractAnchoring, Shape
from .attitude import FlightLimits, attitude
from .inverse_dynamics import directions, required_acceleration, seconds_per_radian


class Situation(eqx.Module):
    """What a prediction starts from: the vehicle on its curve, as it knows itself."""

    point: PathPoint
    velocity: Scalar
    """m/s"""
    shape: Shape
    target: PathPoint
    factors: Factors


class Glide(eqx.Module):
    """What flies the curve: the model on board, the limits and the rule of anchoring."""

    model: OnboardModel
    limits: FlightLimits
    anchoring: AbstractAnchoring


class AbstractVelocityPredictor(eqx.Module):
    """Predicts the velocity at the target."""

    @abstractmethod
    def predict(self, glide: Glide, situation: Situation) -> Scalar:
        """m/s; differentiable in the shape."""


class FlownModel(AbstractVelocityPredictor):
    """Integrates the motion of the model from the vehicle to the target.

    Over the curve, anchored anew at every instant, with the commanded specific force
    achieved: without the hold of a guidance cycle. The path is the curve also where the
    angle of attack is at a limit, which then counts for the drag alone.
    """

    steps: int = eqx.field(default=32, static=True)
    """Of the classical Runge-Kutta method"""

    def predict(self, glide: Glide, situation: Situation) -> Scalar:
        planet, vehicle = glide.model.planet, glide.model.vehicle
        factors = situation.factors

        def rate(point, second_slopes, velocity):
            altitude = point.altitude
            radius = planet.radius + altitude
            wanted = required_acceleration(planet, point, second_slopes, velocity)
            controls = attitude(
                planet,
                vehicle,
                glide.limits,
                altitude,
                velocity,
                wanted,
                factors.lift,
            )
            mach = velocity / planet.atmosphere.speed_of_sound(altitude)
            _, drag_coefficient = vehicle.coefficients(
                controls.angle_of_attack, mach, velocity
            )
            pressure = 0.5 * planet.density(altitude) * velocity * velocity
            loading = pressure * vehicle.reference_area / vehicle.mass
            towards = directions(planet, point)
            braking = factors.drag * loading * drag_coefficient + (
                planet.gravity.acceleration(radius)
                * towards.tan_path
                * towards.cos_path
            )
            return -braking * seconds_per_radian(radius, velocity, towards)

        return glide.anchoring.integrated(
            rate,
            situation.velocity,
            situation.shape,
            situation.point,
            situation.target,
            self.steps,
        )
