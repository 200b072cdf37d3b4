"""Modulate the angle of attack with a disturbance observer over the velocity.

Reference: R. Zhang, H. Li, R. Zhang, "Angle-of-Attack Modulation in Trajectory Tracking for
a Reusable Launch Vehicle". The code uses the symbols of the paper where it implements an
equation. Since the velocity decreases, frequency and observer gains do not have the usual
signs: see `ModulationGains`.
"""

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, optional_scalar, scalar
from ..onboard.measurement import Measurement
from ..onboard.reference import Reference
from ..onboard.velocity_domain import Deviations, VelocityDomain
from .cycle import FixedCycle
from .law import AbstractSampledLaw, AngleOfAttackCommand, Tracked
from .shuttle import Gate, drag_tracked


class ModulationGains(eqx.Module):
    """Gains over the velocity in units of the circular velocity."""

    frequency: Scalar = scalar(300.0, positive=True)
    """Magnitude of omega_n of (32), which is negative"""
    damping: Scalar = scalar(0.7, positive=True)
    """zeta of (32)"""
    observer_pole: Scalar = scalar(1000.0, positive=True)
    """p: both eigenvalues of (38) and (39), tau1 = a_rr + a_gg - 2 p and tau2 = p^2"""
    bank_deviation: Scalar = scalar(4.0)
    """k1 of (42), on the deviation of the angle of attack, rad/rad"""
    bank_rate: Scalar = scalar(-0.15)
    """k2 of (42), on the internal state, rad per rad per unit of velocity"""
    scheduled_at: Scalar | None = optional_scalar(unit="m/s2")
    """Reference drag at which frequency and pole have these values. Elsewhere they are
    proportional to one over the reference drag, which makes them constant over the time.
    None for constant values"""


class AttitudeLag(eqx.Module):
    """Second-order response of the angle of attack, for which the command has a lead."""

    frequency: Scalar = scalar(unit="rad/s", positive=True)
    damping: Scalar = scalar(positive=True)


class ObserverStates(eqx.Module):
    """What the law holds from cycle to cycle; derivatives are over the velocity."""

    deviation: Scalar
    """u1, deviation of the angle of attack, rad"""
    slope: Scalar
    """u1'"""
    second: Scalar
    """u1'' with the last error"""
    drag_error_slope: Scalar
    """Estimate of xi2"""
    disturbance: Scalar
    """Estimate of d^z"""
    drag_error: Scalar
    """xi1 at the last cycle, in units of gravity"""
    velocity: Scalar
    """Velocity at the last cycle, in units of the circular velocity"""
    active: Scalar
    """1 where the angle of attack is modulated, else 0"""
    command: AngleOfAttackCommand


class DynamicalModulation(AbstractSampledLaw[None, ObserverStates]):
    """Dynamical output feedback, equations (28) to (42).

    The law commands the second derivative of the angle-of-attack deviation over the
    velocity. This cancels the linear model about the reference, places the poles of the
    drag error, and subtracts the disturbance that an observer estimates from that error
    alone. The bank law is given the increment k1 u1 + k2 eta2, which brings the deviation
    back.

    At a guidance cycle the law integrates from the velocity of the last cycle to the
    measured one, in midpoint steps. The error is interpolated linearly between both.
    """

    reference: Reference
    """Reference over the velocity, as from `plan_glide`"""
    domain: VelocityDomain
    gains: ModulationGains = eqx.field(default_factory=ModulationGains)
    lag: AttitudeLag | None = None
    """Attitude lag that the command compensates by a lead from the states of the law; None
    for no lead"""
    gate: Gate = eqx.field(default_factory=Gate)
    cycle: FixedCycle = FixedCycle(0.1)
    substeps: int = eqx.field(default=4, static=True)

    def __check_init__(self):
        if self.substeps < 1:
            raise ValueError(f"substeps is {self.substeps}: it must be 1 or more")

    def init(self, measurement: Measurement) -> tuple[None, ObserverStates]:
        nothing = 0.0 * measurement.drag
        velocity = measurement.state.velocity / self.domain.circular_velocity
        command = AngleOfAttackCommand(measurement.trim_angle_of_attack, nothing)
        none = nothing, nothing, nothing, nothing, nothing, nothing
        return None, ObserverStates(*none, velocity, nothing, command)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: None,
        held: ObserverStates,
    ) -> tuple[None, ObserverStates]:
        state, domain = measurement.state, self.domain
        wanted = self.reference.over_index(state.velocity)
        point = domain.point(state, wanted)
        model = domain.simplified(point)
        error = measurement.drag / domain.gravity - point.drag
        frequency, tau1, tau2 = self._placed(model, point.drag * domain.gravity)

        active = self.gate.modulates(measurement)
        goes_on = active & (held.active > 0.0)
        # At the start the estimates of slope and disturbance are zero.
        known = jnp.where(goes_on, 1.0, 0.0)
        way = jnp.where(goes_on, point.velocity - held.velocity, 0.0)
        first = jnp.where(goes_on, held.drag_error, error)

        def command(u: Scalar, slope: Scalar, xi1: Scalar, xi2: Scalar, d: Scalar):
            nominal = self._cancelled(model, u, slope, xi1, xi2)
            placed = -2.0 * self.gains.damping * frequency * xi2 - frequency**2 * xi1
            return (-nominal + placed - d) / model.chi

        def rates(y, share: Scalar):
            u, slope, xi2_bar, d_bar = y
            xi1 = first + share * (error - first)
            xi2, d = xi2_bar + tau1 * xi1, d_bar + tau2 * xi1
            v = command(u, slope, xi1, xi2, d)
            nominal = self._cancelled(model, u, slope, xi1, xi2)
            # (35) less tau1 xi1', and (36) less tau2 xi1', in the variables of (40), (41).
            xi2_rate = nominal + d + model.chi * v - tau1 * xi2
            return slope, v, xi2_rate, -tau2 * xi2

        y = (
            known * held.deviation,
            known * held.slope,
            known * held.drag_error_slope - tau1 * first,
            known * held.disturbance - tau2 * first,
        )
        step = way / self.substeps
        for index in range(self.substeps):
            half = rates(y, jnp.asarray(index / self.substeps))
            middle = tuple(a + 0.5 * step * k for a, k in zip(y, half, strict=True))
            slopes = rates(middle, jnp.asarray((index + 0.5) / self.substeps))
            y = tuple(a + step * k for a, k in zip(y, slopes, strict=True))
        u, slope, xi2_bar, d_bar = y
        xi2, d = xi2_bar + tau1 * error, d_bar + tau2 * error
        second = command(u, slope, error, xi2, d)
        one = jnp.where(active, 1.0, 0.0)
        wish = u + self._lead(measurement, slope, second)
        eta2 = slope - xi2 / model.chi
        increment = self.gains.bank_deviation * u + self.gains.bank_rate * eta2
        scheduled = wanted["angle_of_attack"][0]
        return memory, ObserverStates(
            one * u,
            one * slope,
            one * second,
            one * xi2,
            one * d,
            error,
            point.velocity,
            one,
            AngleOfAttackCommand(scheduled + one * wish, one * increment),
        )

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: None,
        held: ObserverStates,
    ) -> tuple[AngleOfAttackCommand, None]:
        return held.command, None

    def tracked(
        self, time: Scalar, measurement: Measurement, held: ObserverStates
    ) -> Tracked | None:
        return drag_tracked(self.reference, measurement)

    def _lead(self, measurement: Measurement, slope: Scalar, second: Scalar) -> Scalar:
        """Lead that compensates the attitude lag of a deviation, rad."""
        if self.lag is None:
            return jnp.zeros_like(slope)
        state, domain = measurement.state, self.domain
        sine, _ = sincos(state.flight_path_angle)
        falls = measurement.drag + domain.gravity * sine
        slows = -falls / domain.circular_velocity
        frequency, damping = self.lag.frequency, self.lag.damping
        rate, acceleration = slope * slows, second * slows * slows
        return 2.0 * damping / frequency * rate + acceleration / frequency**2

    def _placed(self, model: Deviations, drag: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """omega_n, tau1 and tau2 at a reference drag (m/s2)."""
        gains, factor = self.gains, 1.0
        if gains.scheduled_at is not None:
            factor = gains.scheduled_at / drag
        pole = gains.observer_pole * factor
        tau1 = model.a[0, 0] + model.a[1, 1] - 2.0 * pole
        return -gains.frequency * factor, tau1, pole * pole

    def _cancelled(
        self, model: Deviations, u: Scalar, slope: Scalar, xi1: Scalar, xi2: Scalar
    ) -> Scalar:
        """xi2' of the linear model without its input and disturbance: (20), (31)."""
        (a_rr, a_rg), (a_gr, a_gg) = model.a
        eta2 = slope - xi2 / model.chi
        return (
            a_rr * xi2
            + (a_rg * a_gr - a_rr * a_gg) * xi1
            + a_rg * (model.c[0] * model.b[1] - a_gr * model.chi) * u
            - a_gg * model.chi * eta2
        )
