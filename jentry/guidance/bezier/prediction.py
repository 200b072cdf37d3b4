"""Onboard prediction of the velocity at the target, by flying the model along the curve."""

import enum
import warnings
from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from ...fields import Scalar, table
from ...motion.constraints import Constraints
from ...onboard.estimation import AbstractFactors
from ...onboard.model import OnboardModel
from ...onboard.network import Network
from .allocation import FlightLimits, attitude
from .anchoring import AbstractAnchoring, Shape
from .curve import PathPoint
from .inverse_dynamics import directions, required_acceleration, seconds_per_radian


class Situation(eqx.Module):
    """Start of a prediction: the vehicle on its curve, as the law estimates it."""

    point: PathPoint
    velocity: Scalar
    """m/s"""
    shape: Shape
    target: PathPoint
    factors: AbstractFactors


class Glide(eqx.Module):
    """What a prediction flies: the onboard model, its limits and the anchoring rule."""

    model: OnboardModel
    limits: FlightLimits
    constraints: Constraints
    """Path constraints, whose limits the command respects"""
    anchoring: AbstractAnchoring


class AbstractVelocityPredictor(eqx.Module):
    """Predicts the velocity at the target."""

    @abstractmethod
    def predict(self, glide: Glide, situation: Situation) -> Scalar:
        """Velocity at the target, m/s; differentiable in the shape. NaN if unknown."""


class FlownModel(AbstractVelocityPredictor):
    """Integrates the motion of the model from the vehicle to the target.

    The motion follows the curve, anchored again at every instant, and the commanded
    specific force is achieved: the hold of a guidance cycle is not modelled. The path is
    the curve also where the angle of attack is at a limit; the limit then only affects
    the drag.
    """

    steps: int = eqx.field(default=32, static=True)
    """Number of Runge-Kutta steps. 16 are enough for a subdivided curve. For stored
    parameters with k2 / k1^2 below 0.5, which converge very fast to the path, 32 are too
    few"""

    def predict(self, glide: Glide, situation: Situation) -> Scalar:
        planet, vehicle = glide.model.planet, glide.model.vehicle

        def rate(point, second_slopes, velocity):
            altitude = point.altitude
            factors = situation.factors.at(altitude)
            radius = planet.radius + altitude
            wanted = required_acceleration(planet, point, second_slopes, velocity)
            controls = attitude(
                planet,
                vehicle,
                glide.limits,
                glide.constraints,
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


STATE_FEATURES = (
    "angle to go, rad",
    "altitude, 10 km",
    "slope of the path along the track, 0.01",
    "cross-track angle, 1e-4",
    "cross-track slope, 1e-3",
    "velocity, km/s",
)
CURVE_FEATURES = "first number of the shape", "second number of the shape"
FACTOR_FEATURES = "lift factor", "drag factor"


class Inputs(enum.Enum):
    """Set of inputs of a network."""

    STATE = "the state, on one curve"
    ALL = "the state, the curve and the estimated factors"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features, with their units."""
        if self is Inputs.STATE:
            return STATE_FEATURES + CURVE_FEATURES
        return STATE_FEATURES + CURVE_FEATURES + FACTOR_FEATURES


def features(glide: Glide, situation: Situation, inputs: Inputs) -> Float[Array, " n"]:
    """Inputs of a network in a situation."""
    point, target = situation.point, situation.target
    numbers = [
        target.along - point.along,
        1e-4 * point.altitude,
        100.0 * point.altitude_slope / (glide.model.planet.radius + point.altitude),
        1e4 * point.cross,
        1e3 * point.cross_slope,
        1e-3 * situation.velocity,
    ]
    numbers += glide.anchoring.features(situation.shape, point, target)
    if inputs is Inputs.ALL:
        factors = situation.factors.at(point.altitude)
        numbers += [factors.lift, factors.drag]
    return jnp.stack(numbers)


VELOCITIES = "velocity at the target, m/s"
"""Entry of a network's model card: smallest and largest velocity in training"""


class NetworkPredictor(AbstractVelocityPredictor):
    """Prediction by a network that was trained on flights.

    The output of the network is ln(v / v_f) / X for the velocity v and the angle to go X,
    so that the error vanishes as the target comes near.

    The network answers only within the ranges of its training. If an input or the velocity
    at the target is outside of its range, the prediction is NaN, and the laws leave the
    curve unchanged. A warning is issued if the numbers are known at the call. Under `jit`
    they are not: see `Flight.caveats`.
    """

    network: Network
    velocities: Float[Array, "..."] = table(unit="m/s")
    """Smallest and largest velocity at the target in training, shape (2,)"""
    inputs: Inputs = eqx.field(default=Inputs.ALL, static=True)

    def __check_init__(self):
        expected, given = self.inputs.names, self.network.names
        if given != expected:
            raise ValueError(
                f"the network has {len(given)} inputs ({', '.join(given)}): "
                f"{self.inputs.value} are {len(expected)} ({', '.join(expected)})"
            )
        if self.velocities.shape != (2,):
            raise ValueError(
                f"velocities has shape {self.velocities.shape}: expected (2,)"
            )

    def predict(self, glide: Glide, situation: Situation) -> Scalar:
        read = features(glide, situation, self.inputs)
        known = self.network.knows(read)
        # On both sides of the `where`, so that the unused branch has no derivative.
        inside = jnp.where(known, read, self.network.input_mean)
        to_go = situation.target.along - situation.point.along
        velocity = situation.velocity * jnp.exp(-to_go * self.network(inside))
        slowest, fastest = self.velocities
        answers = known & (velocity >= slowest) & (velocity <= fastest)
        if not isinstance(answers, Tracer) and not answers:
            warnings.warn(self._refusal(read, velocity), stacklevel=2)
        return jnp.where(answers, velocity, jnp.nan)

    def _refusal(self, read: Array, velocity: Scalar) -> str:
        """Message that explains why there is no answer."""
        beyond = [
            f"{name} is {float(value):.6g}, trained from {low:.6g} to {high:.6g}"
            for name, value, (low, high), outside in zip(
                self.network.names,
                read,
                self.network.input_ranges.tolist(),
                self.network.outside(read),
                strict=True,
            )
            if outside
        ]
        if not beyond:
            slowest, fastest = self.velocities.tolist()
            beyond = [
                f"velocity at the target is {float(velocity):.6g} m/s, trained from "
                f"{slowest:.6g} to {fastest:.6g}"
            ]
        return "a network has no answer outside of its ranges: " + "; ".join(beyond)
