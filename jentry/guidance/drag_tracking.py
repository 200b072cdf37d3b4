"""Drag tracking with and without measurement of the drag rate.

Reference: H. Yan, Y. He, "Drag-Tracking Guidance for Entry Vehicles Without Drag Rate
Measurement". The code uses the symbols of the paper where it implements an equation.
"""

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.state import Controls
from ..onboard.flow import BankedMotion, sensed_flow, twice_along
from ..onboard.measurement import Measurement
from ..onboard.model import OnboardModel
from ..onboard.reference import DragReference
from ..world.aerodynamics import ConstantAerodynamics, PolynomialAerodynamics
from ..world.atmosphere import ExponentialAtmosphere
from ..world.gravity import InverseSquareGravity
from ..world.shape import Sphere
from ..world.wind import StillAir
from .lateral import AbstractLateralLogic, FixedSide
from .law import AbstractBankLaw, Tracked
from .open_loop import vertical_lift_command
from .switching import AbstractSwitching, Sharp


class ErrorGains(eqx.Module):
    """Second-order error dynamics x'' = -(a / epsilon0^2) x - (b / epsilon0) x'."""

    epsilon0: Scalar = scalar(unit="s", positive=True)
    a: Scalar = scalar(positive=True)
    b: Scalar = scalar(positive=True)


class ObserverGains(eqx.Module):
    """High-gain observer with the polynomial s^2 + (l1 / epsilon) s + l2 / epsilon^2."""

    epsilon: Scalar = scalar(unit="s", positive=True)
    l1: Scalar = scalar(positive=True)
    l2: Scalar = scalar(positive=True)


class ObserverState(eqx.Module):
    """Estimates of the drag error and of its rate."""

    drag_error: Scalar
    """m/s2"""
    drag_error_rate: Scalar
    """m/s3"""


def drag_dynamics(
    model: OnboardModel, measurement: Measurement, angle_of_attack: Scalar
) -> BankedMotion:
    """Modelled motion of the drag: D, D' and D'' = f + g0 u with u = cos(bank).

    The drag is the sensed one. The lift is the sensed drag times the lift-to-drag ratio of
    the model. Any atmosphere, gravity and aerodynamics can be used, in still air over a
    planet at rest, at a constant angle of attack (rad).
    """
    state = measurement.state
    lift = model.lift_to_drag(state, angle_of_attack) * measurement.drag
    if _is_of_the_paper(model):
        return _expanded(model, measurement, lift)
    flow = sensed_flow(model, angle_of_attack)
    # The rate of the drag is that of the flow; the time does not enter.
    time = jnp.zeros_like(measurement.drag)
    return twice_along(flow, lambda point: point.drag, measurement, time, lift)


def _is_of_the_paper(model: OnboardModel) -> bool:
    """Whether equations (8), (9) and (11) apply.

    `benchmarks/costs.py` prints the cost of a flight with them and without.
    """
    planet, vehicle = model.planet, model.vehicle
    return (
        isinstance(planet.atmosphere, ExponentialAtmosphere)
        and isinstance(planet.wind, StillAir)
        and isinstance(planet.gravity, InverseSquareGravity)
        and isinstance(planet.shape, Sphere)
        and isinstance(
            vehicle.aerodynamics, ConstantAerodynamics | PolynomialAerodynamics
        )
    )


def _expanded(
    model: OnboardModel, measurement: Measurement, lift: Scalar
) -> BankedMotion:
    """Equations (8), (9) and (11): exponential atmosphere and constant C_D.

    The last term of f has its sign corrected: it is - v^2 cos^2(gamma) / (r h_s).
    """
    atmosphere = model.planet.atmosphere
    assert isinstance(atmosphere, ExponentialAtmosphere)
    state, D, L = measurement.state, measurement.drag, lift
    v = state.velocity
    sin, cos = sincos(state.flight_path_angle)
    r = model.planet.radius + state.altitude
    g = model.planet.gravity.acceleration(r)
    per_v, per_r, per_h = 1.0 / v, 1.0 / r, 1.0 / atmosphere.scale_height

    common = -v * sin * per_h - 2.0 * g * sin * per_v
    drag_rate = D * (common - 2.0 * D * per_v)  # (8)
    f = (common - 4.0 * D * per_v) * drag_rate + D * (  # (11), corrected
        (D * sin + g) * per_h
        + (4.0 * g * sin * sin - 2.0 * g * cos * cos) * per_r
        - (2.0 * D * D + 4.0 * D * g * sin + 2.0 * g * g * (sin * sin - cos * cos))
        * (per_v * per_v)
        - v * v * cos * cos * (per_r * per_h)
    )
    g0 = -(v * per_h + 2.0 * g * per_v) * L * D * cos * per_v
    return BankedMotion(D, drag_rate, f, g0)


class Tracking(eqx.Module):
    """Command that tracks the reference at one instant, and its errors."""

    u: Scalar
    """Cosine of the bank, within its limits"""
    x1: Scalar
    """Drag error, m/s2"""
    x2: Scalar
    """Rate of the drag error that is fed back, m/s3"""
    excess: Scalar
    """Drag above the gate of the reference, m/s2"""


def track(
    gains: ErrorGains,
    reference: DragReference,
    model: OnboardModel,
    time: Scalar,
    measurement: Measurement,
    observed: ObserverState | None,
    switching: AbstractSwitching,
    scale: Scalar | float = 1.0,
) -> Tracking:
    """Bank that tracks the reference: equation (14), or (24) with an observer.

    The reference drag is multiplied by `scale`.

    Below the gate of the reference, u is the planned bank of the reference. This applies
    before the drag has built up, and again at the end if it falls so low.
    """
    angle = measurement.trim_angle_of_attack
    plant = drag_dynamics(model, measurement, angle)
    wanted = reference.at(time, measurement, model, angle, plant.rate)
    x1 = measurement.drag - scale * wanted.value
    if observed is None:
        x2 = plant.rate - scale * wanted.rate
    else:
        x2 = observed.drag_error_rate
    a, b, epsilon0 = gains.a, gains.b, gains.epsilon0
    feedback = -(a / (epsilon0 * epsilon0)) * x1 - (b / epsilon0) * x2
    # D*'' contains u if the index does: this part is moved to g0.
    g0 = plant.gain - scale * wanted.gain
    u = (-plant.drift + scale * wanted.drift + feedback) / g0
    excess = measurement.drag - reference.gate
    planned = reference.cos_bank(measurement.state.velocity)
    u = switching.beyond(excess, switching.limited(u), planned)
    return Tracking(u, x1, x2, excess)


def observe(
    gains: ErrorGains,
    observer: ObserverGains,
    switching: AbstractSwitching,
    tracking: Tracking,
    estimate: ObserverState,
) -> ObserverState:
    """Rate of the observer's state, equation (25), driven by the unlimited command.

    Below the gate the estimated drag error follows the actual one, and the estimate of its
    rate is constant, so that at the gate the observer starts from x1 and 0.
    """
    a, b, epsilon0 = gains.a, gains.b, gains.epsilon0
    epsilon = observer.epsilon
    innovation = tracking.x1 - estimate.drag_error
    error_rate = estimate.drag_error_rate + (observer.l1 / epsilon) * innovation
    error_rate_rate = (
        -(a / (epsilon0 * epsilon0)) * tracking.x1
        - (b / epsilon0) * estimate.drag_error_rate
        + (observer.l2 / (epsilon * epsilon)) * innovation
    )
    nothing = jnp.zeros_like(error_rate_rate)
    return ObserverState(
        drag_error=error_rate,
        drag_error_rate=switching.beyond(tracking.excess, error_rate_rate, nothing),
    )


class StateFeedbackDragTracking(AbstractBankLaw[None]):
    """Drag tracking with the drag rate of the onboard model, equation (14)."""

    gains: ErrorGains
    reference: DragReference
    model: OnboardModel
    switching: AbstractSwitching = Sharp()
    lateral: AbstractLateralLogic = FixedSide()

    def init(self, measurement: Measurement) -> None:
        return None

    def tracked(self, time: Scalar, measurement: Measurement, held: None) -> Tracked:
        tracking = track(
            self.gains, self.reference, self.model, time, measurement, None, Sharp()
        )
        return Tracked(((tracking.x1, tracking.x2),), ("bank_angle",))

    def to_the_right(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        tracking = track(
            self.gains,
            self.reference,
            self.model,
            time,
            measurement,
            None,
            self.switching,
        )
        angle_of_attack = measurement.trim_angle_of_attack
        return vertical_lift_command(tracking.u, angle_of_attack), None


class ObserverDragTracking(AbstractBankLaw[ObserverState]):
    """Drag tracking without drag-rate measurement, equations (24) and (25).

    Memory is the state of the high-gain observer; it starts at the drag error and zero.
    """

    gains: ErrorGains
    observer: ObserverGains
    reference: DragReference
    model: OnboardModel
    switching: AbstractSwitching = Sharp()
    lateral: AbstractLateralLogic = FixedSide()

    def init(self, measurement: Measurement) -> ObserverState:
        zero = 0.0 * measurement.drag
        tracking = self._track(zero, measurement, None)
        return ObserverState(tracking.x1, zero)

    def tracked(self, time: Scalar, measurement: Measurement, held: None) -> Tracked:
        tracking = self._track(time, measurement, None)
        return Tracked(((tracking.x1, tracking.x2),), ("bank_angle",))

    def to_the_right(
        self, time: Scalar, measurement: Measurement, memory: ObserverState
    ) -> tuple[Controls, ObserverState]:
        tracking = self._track(time, measurement, memory)
        angle_of_attack = measurement.trim_angle_of_attack
        rate = observe(self.gains, self.observer, self.switching, tracking, memory)
        return vertical_lift_command(tracking.u, angle_of_attack), rate

    def _track(
        self, time: Scalar, measurement: Measurement, observed: ObserverState | None
    ) -> Tracking:
        return track(
            self.gains,
            self.reference,
            self.model,
            time,
            measurement,
            observed,
            self.switching,
        )
