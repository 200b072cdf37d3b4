"""Guidance along a Bézier curve by inverse dynamics.

Source: H. Zhou, T. Rahman, W. Chen, "Neural Network Assisted Inverse Dynamic Guidance for
Terminally Constrained Entry Flight", Mathematical Problems in Engineering, 2014; its
equations as corrected in `curve`, `inverse_dynamics` and `allocation`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from ...fields import QUARTER, Scalar, scalar
from ...motion.constraints import Constraints, DynamicPressure, HeatRate, LoadFactor
from ...motion.forces import air_data
from ...motion.state import Controls, EntryState
from ...onboard.estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    FactorEstimator,
)
from ...onboard.measurement import Measurement
from ...onboard.model import OnboardModel
from ...onboard.track import Track
from ...world.aerodynamics import AbstractInvertibleAerodynamics
from ..cycle import AbstractTimedDecision, ShorteningCycle
from ..law import AbstractSampledLaw
from .allocation import FlightLimits, attitude
from .anchoring import AbstractAnchoring, Shape, StoredParameters
from .curve import BezierParameters, BezierPath, PathPoint
from .inverse_dynamics import path_point, required_acceleration
from .prediction import Glide, Situation
from .velocity_control import AbstractVelocityControl, NoVelocityControl, Predictions


class Arrival(eqx.Module):
    """Required altitude, flight-path angle and heading at the target."""

    altitude: Scalar = scalar(unit="m")
    flight_path_angle: Scalar = scalar(unit="rad", range=QUARTER)
    heading: Scalar = scalar(unit="rad")


class HeldCurve(AbstractTimedDecision):
    """Decision of the law that is held through a guidance cycle."""

    controls: Controls
    shape: Shape
    along: Scalar
    """Angle along the track at which the curve is anchored, rad"""
    estimate: AbstractFactorEstimate
    duration: Scalar
    """Length of this cycle, s"""
    count: Scalar
    """Number of cycles decided so far"""
    predictions: Predictions
    """Number of predictions of the velocity at the target so far"""


class BezierGuidance(AbstractSampledLaw[tuple[()], HeldCurve]):
    """Flies a cubic Bézier curve to a target, anchored again at every guidance cycle.

    The curve meets position, flight-path angle and heading at the target.
    `velocity_control` adjusts the curve to meet the velocity there.

    **Arguments:**

    - `parameters`: k1 and k2 of the curve at the start.
    - `track`, `arrival`: the target, and the conditions on arrival.
    - `limits`: limits of the command. The limits of load factor, dynamic pressure and heat
      rate that the law respects are those of `Scenario.constraints`; without any of them
      a warning is issued.
    - `cycle`: the guidance cycles.
    - `anchoring`: `StoredParameters` (the paper's) or `Subdivision`.
    - `acceleration_loop`: whether the estimated lift factor is used to achieve the
      commanded specific force. Without it the model is inverted as printed, equation (34):
      with an unknown factor of 10 % on the lift a third of the flights are then lost.
    """

    keeps = (LoadFactor, DynamicPressure, HeatRate)

    parameters: BezierParameters
    track: Track
    arrival: Arrival
    model: OnboardModel
    limits: FlightLimits
    estimator: AbstractFactorEstimator = eqx.field(default_factory=FactorEstimator)
    anchoring: AbstractAnchoring = StoredParameters()
    velocity_control: AbstractVelocityControl = NoVelocityControl()
    cycle: ShorteningCycle = ShorteningCycle()
    acceleration_loop: bool = eqx.field(default=True, static=True)

    def __check_init__(self):
        aerodynamics = self.model.vehicle.aerodynamics
        if not isinstance(aerodynamics, AbstractInvertibleAerodynamics):
            raise ValueError(
                f"the onboard model has {type(aerodynamics).__name__}: the law needs "
                "aerodynamics whose lift tells the angle of attack"
            )
        self.velocity_control.check(self.glide({}))

    def glide(self, constraints: Constraints) -> Glide:
        """The model with its limits and anchoring, under the path constraints."""
        return Glide(self.model, self.limits, constraints, self.anchoring)

    def target(self) -> PathPoint:
        """The end of the curve."""
        track, arrival = self.track, self.arrival
        like = EntryState(
            altitude=arrival.altitude,
            longitude=track.target_longitude,
            latitude=track.target_latitude,
            velocity=1.0,
            flight_path_angle=arrival.flight_path_angle,
            heading=arrival.heading,
        )
        place = track.position(like)
        return path_point(self.model.planet, place, like)

    def init(self, measurement: Measurement) -> tuple[tuple[()], HeldCurve]:
        start = self._point(measurement.state)
        shape = self.anchoring.shape(self.parameters, start, self.target())
        nothing = 0.0 * start.along
        trim = self.model.vehicle.trim_angle_of_attack + nothing
        before = HeldCurve(
            controls=Controls(trim, nothing + 1.0, nothing),
            shape=shape,
            along=start.along,
            estimate=self.estimator.start(nothing),
            duration=nothing + self.cycle.period,
            count=nothing,
            predictions=Predictions.none(nothing),
        )
        return (), before

    def update(
        self, time: Scalar, measurement: Measurement, memory: tuple[()], held: HeldCurve
    ) -> tuple[tuple[()], HeldCurve]:
        planet, vehicle = self.model.planet, self.model.vehicle
        state = measurement.state
        flown_at = held.controls.angle_of_attack
        expected = air_data(planet, vehicle, state, flown_at)
        estimate = self.estimator.update(
            held.estimate,
            state.altitude,
            (measurement.lift, measurement.drag),
            (expected.lift, expected.drag),
            held.duration,
        )
        start, target = self._point(state), self.target()
        distance = (target.along - start.along) * (planet.radius + state.altitude)
        seconds_to_go = distance / state.velocity
        factors = estimate.factors
        shape = self.anchoring.carried(held.shape, held.along, start, target)
        shape, predictions = self.velocity_control.adjusted(
            self.glide(measurement.constraints),
            Situation(start, state.velocity, shape, target, estimate.ahead),
            held.count,
            seconds_to_go,
        )
        inner = self.anchoring.inner(shape, start, target)
        path = BezierPath.between(start, target, inner)
        wanted = required_acceleration(
            planet, start, path.second_slopes(0.0 * start.along), state.velocity
        )
        one = jnp.ones_like(state.velocity)
        controls = attitude(
            planet,
            vehicle,
            self.limits,
            measurement.constraints,
            state.altitude,
            state.velocity,
            wanted,
            factors.lift if self.acceleration_loop else one,
        )
        frozen = seconds_to_go < self.cycle.freeze
        controls = _select(frozen, held.controls, controls)
        return memory, HeldCurve(
            controls=controls,
            shape=shape,
            along=start.along,
            estimate=estimate,
            duration=self.cycle.duration(seconds_to_go, held.duration),
            count=held.count + 1.0,
            predictions=jax.tree.map(jnp.add, held.predictions, predictions),
        )

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: tuple[()], held: HeldCurve
    ) -> tuple[Controls, tuple[()]]:
        return held.controls, ()

    def caveats(self, held: HeldCurve) -> dict[str, Scalar]:
        """Share of the predictions of the velocity at the target without an answer.

        The caveats of the estimate are included.
        """
        made = held.predictions
        share = made.unanswered / jnp.maximum(made.asked, 1.0)
        return {"unanswered_predictions": share} | held.estimate.caveats()

    def situation(self, state: EntryState, decision: HeldCurve) -> Situation:
        """Start of a prediction of the velocity at the target."""
        return Situation(
            point=self._point(state),
            velocity=state.velocity,
            shape=decision.shape,
            target=self.target(),
            factors=decision.estimate.ahead,
        )

    def _point(self, state: EntryState) -> PathPoint:
        return path_point(self.model.planet, self.track.position(state), state)


def _select(condition, chosen, otherwise):
    return Controls(
        jnp.where(condition, chosen.angle_of_attack, otherwise.angle_of_attack),
        jnp.where(condition, chosen.cos_bank, otherwise.cos_bank),
        jnp.where(condition, chosen.sin_bank, otherwise.sin_bank),
    )
