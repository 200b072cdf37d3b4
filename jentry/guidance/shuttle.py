"""The Shuttle's entry guidance: drag tracking with the bank and the angle of attack.

Reference: J. C. Harpold, C. A. Graves, "Shuttle Entry Guidance", Journal of the
Astronautical Sciences 27(3), 1979, in the form in which R. Zhang, H. Li, R. Zhang,
"Angle-of-Attack Modulation in Trajectory Tracking for a Reusable Launch Vehicle", use it
for comparison. The paper prints no gains: these are similar to the Shuttle's.
"""

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import Scalar, scalar
from ..motion.state import Controls
from ..onboard.measurement import Measurement
from ..onboard.model import OnboardModel
from ..onboard.reference import Reference
from ..units import degree, foot, standard_gravity
from .lateral import AbstractLateralLogic, FixedSide
from .law import AbstractBankLaw, AbstractContinuousLaw, AngleOfAttackCommand, Tracked
from .open_loop import vertical_lift_command


class Gate(eqx.Module):
    """Conditions from which guidance and angle-of-attack modulation begin."""

    drag: Scalar = scalar(0.05 * standard_gravity, unit="m/s2", positive=True)
    """Sensed drag above which the law guides"""
    velocity: Scalar = scalar(7200.0, unit="m/s", positive=True)
    """Velocity at and below which the angle of attack is modulated"""

    def guides(self, measurement: Measurement):
        """Whether the bank is guided."""
        return measurement.drag > self.drag

    def modulates(self, measurement: Measurement):
        """Whether the angle of attack is modulated."""
        below = measurement.state.velocity <= self.velocity
        return below & self.guides(measurement)


class BankGains(eqx.Module):
    """Gains on the errors of drag and altitude rate, functions of the sensed drag.

    With the drag D in ft/s2: C16 = clip(0.1354 D^-0.10) in s2/ft, and
    C17 = clip(1.537e-2 D^-0.58146) in s/ft.
    """

    drag: Scalar = scalar(0.1354)
    drag_power: Scalar = scalar(-0.10)
    least_drag: Scalar = scalar(0.025)
    largest_drag: Scalar = scalar(0.35)
    rate: Scalar = scalar(1.537e-2)
    rate_power: Scalar = scalar(-0.58146)
    least_rate: Scalar = scalar(0.0025)
    least_modulated: Scalar = scalar(0.00133)
    """Used in place of `least_rate` while the angle of attack is modulated"""
    largest_rate: Scalar = scalar(0.014)
    modulated: Scalar = scalar(0.75)
    """Factor on C17 while the angle of attack is modulated"""

    def at(self, drag: Scalar, modulates) -> tuple[Scalar, Scalar]:
        """Gains on the errors of the drag (s2/m) and of the altitude rate (s/m).

        `drag` is the sensed drag (m/s2). `modulates` is true while the angle of attack is
        modulated.
        """
        in_feet = jnp.maximum(drag / foot, 1e-3)
        c16 = jnp.clip(
            self.drag * in_feet**self.drag_power, self.least_drag, self.largest_drag
        )
        least = jnp.where(modulates, self.least_modulated, self.least_rate)
        c17 = jnp.clip(self.rate * in_feet**self.rate_power, least, self.largest_rate)
        c17 = jnp.where(modulates, self.modulated, 1.0) * c17
        return c16 / foot, c17 / foot


class ShuttleBank(AbstractBankLaw[None]):
    """Bank for a vertical lift-to-drag ratio with feedback of drag and altitude rate.

    (L/D) cos(bank) = reference value + C16 (D - D_ref) + C17 (hdot_ref - hdot), with the
    sensed lift-to-drag ratio. Before guidance begins the bank is constant.
    """

    reference: Reference
    """Columns over the velocity: lift_to_drag_up, drag (m/s2) and altitude_rate (m/s)"""
    gains: BankGains = eqx.field(default_factory=BankGains)
    gate: Gate = eqx.field(default_factory=Gate)
    first_bank: Scalar = scalar(30.0 * degree, unit="rad")
    """Bank before guidance begins"""
    largest_bank: Scalar = scalar(80.0 * degree, unit="rad")
    lateral: AbstractLateralLogic = FixedSide()

    def init(self, measurement: Measurement) -> None:
        return None

    def to_the_right(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[Controls, None]:
        state = measurement.state
        wanted = self.reference.over_index(state.velocity)
        drag, rate = wanted["drag"][0], wanted["altitude_rate"][0]
        modulates = self.gate.modulates(measurement)
        c16, c17 = self.gains.at(measurement.drag, modulates)
        climbs = state.velocity * sincos(state.flight_path_angle)[0]
        up = wanted["lift_to_drag_up"][0] + c16 * (measurement.drag - drag)
        up = up + c17 * (rate - climbs)
        # Before guidance begins the sensed lift may be zero; the ratio is not used.
        guides = self.gate.guides(measurement)
        lift = jnp.where(guides, measurement.lift, 1.0)
        least, first = sincos(self.largest_bank)[1], sincos(self.first_bank)[1]
        cosine = jnp.clip(up * measurement.drag / lift, least, 1.0)
        cosine = jnp.where(guides, cosine, first)
        return vertical_lift_command(cosine, measurement.trim_angle_of_attack), None


class ShuttleModulation(AbstractContinuousLaw[None]):
    """Angle of attack at which the present drag would equal that of the reference.

    alpha = measured alpha + C_D (D_ref / D - 1) / (f dC_D/dalpha), with the drag
    coefficient at the reference angle of attack. The response of the motion is neglected.
    Use it as `Sampled(law, period)` within `compose`.
    """

    reference: Reference
    """Columns over the velocity: angle_of_attack (rad) and drag (m/s2)"""
    model: OnboardModel
    divisor: Scalar = scalar(1.0, positive=True)
    """f"""
    bank_gain: Scalar = scalar(4.0)
    """Bank increment per deviation of the angle of attack from the reference, rad/rad"""
    dead_band: Scalar = scalar(0.0, unit="m/s2")
    """Drag error within which the angle of attack is not changed"""
    limit: Scalar = scalar(60.0 * degree, unit="rad", positive=True)
    """Largest commanded change of the measured angle of attack"""
    gate: Gate = eqx.field(default_factory=Gate)

    def init(self, measurement: Measurement) -> None:
        return None

    def __call__(
        self, time: Scalar, measurement: Measurement, memory: None
    ) -> tuple[AngleOfAttackCommand, None]:
        wanted = self.reference.over_index(measurement.state.velocity)
        angle, drag = wanted["angle_of_attack"][0], wanted["drag"][0]
        _, (coefficient, slope) = self.model.coefficients_with_slopes(
            measurement.state, angle
        )
        modulates = self.gate.modulates(measurement)
        sensed = jnp.where(modulates, measurement.drag, drag)
        off = jnp.abs(sensed - drag) >= self.dead_band
        ratio = jnp.where(off, drag / sensed - 1.0, 0.0)
        away = measurement.angle_of_attack - angle
        change = coefficient * ratio / (self.divisor * slope)
        change = jnp.clip(change, -self.limit, self.limit)
        wish = jnp.where(modulates, away + change, 0.0)
        increment = jnp.where(modulates, self.bank_gain * away, 0.0)
        return AngleOfAttackCommand(angle + wish, increment), None

    def tracked(
        self, time: Scalar, measurement: Measurement, held: None
    ) -> Tracked | None:
        return drag_tracked(self.reference, measurement)


def drag_tracked(reference: Reference, measurement: Measurement) -> Tracked:
    """The drag error, which the law reduces with the angle of attack."""
    wanted = reference.over_index(measurement.state.velocity)
    return Tracked(((measurement.drag - wanted["drag"][0],),), ("angle_of_attack",))
