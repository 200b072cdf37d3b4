"""The upper phases of the entry guidance of Apollo: what they command, and when they end.

Names in brackets are those of the flight program, Comanche 055, 1969. All defaults are its
constants, converted to SI.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ..._interpolation import clamp
from ..._math import safe_sqrt
from ...fields import Flag, Scalar, scalar
from ...units import foot
from .skip import GRAVITY, MILE, SkipPlan, SkipPrediction


class Seen(NamedTuple):
    """The motion of the vehicle in the frame that does not rotate."""

    velocity: Scalar
    """Inertial velocity, m/s"""
    rate: Scalar
    """Altitude rate, m/s"""
    drag: Scalar
    """Sensed specific force, which the program takes for the drag, m/s2"""
    range_to_go: Scalar
    """Arc to the place of the target at the end, rad"""

    def excess(self, prediction: SkipPrediction) -> Scalar:
        """Square of the velocity over the circular one, minus one (LEQ)."""
        return (self.velocity / prediction.circular_velocity) ** 2 - 1.0


class InitialRoll(eqx.Module):
    """From the first drag to constant drag: lift up, or down if the entry is shallow.

    The lift is down if V - `shallow_velocity` + `steepness` sin(gamma)^3 is positive at
    the first drag, with inertial velocity V and flight-path angle gamma.
    """

    first_drag: Scalar = scalar(0.05 * GRAVITY, unit="m/s2", positive=True)
    """Drag at which this phase starts"""
    shallow_velocity: Scalar = scalar(26_600.0 * foot, unit="m/s", positive=True)
    """VFINAL"""
    steepness: Scalar = scalar(19_749_550.0 * foot, unit="m/s", positive=True)
    """1 / K44"""
    slow_velocity: Scalar = scalar(27_000.0 * foot, unit="m/s", positive=True)
    """Velocity below which the ballistic phase comes next, as from a low orbit (VFINAL1)"""
    held_drag: Scalar = scalar(0.2 * GRAVITY, unit="m/s2", positive=True)
    """Drag that ends this phase, at the circular velocity (KA2)"""
    held_drag_growth: Scalar = scalar(1.3 * GRAVITY, unit="m/s2")
    """Increase of that drag per cube of the excess of V^2 (KA1)"""
    largest_held_drag: Scalar = scalar(1.5 * GRAVITY, unit="m/s2", positive=True)
    """KALIM"""
    constant_drag: Scalar = scalar(40.0 * foot, unit="m/s2", positive=True)
    """Drag of the next phase, at the circular velocity (KA4)"""
    constant_drag_growth: Scalar = scalar(90.0 * foot, unit="m/s2")
    """Increase of that drag per excess of V^2 (KA3)"""

    def ending_drag(self, excess: Scalar) -> Scalar:
        """Drag that ends this phase (KAT), m/s2."""
        grown = self.held_drag + self.held_drag_growth * excess**3
        return jnp.minimum(grown, self.largest_held_drag)

    def drag_after(self, excess: Scalar) -> Scalar:
        """Drag that the next phase holds (D0), m/s2."""
        return self.constant_drag + self.constant_drag_growth * excess

    def is_shallow(self, seen: Seen) -> Flag:
        """Whether the lift must be down."""
        sine = seen.rate / seen.velocity
        return seen.velocity - self.shallow_velocity + self.steepness * sine**3 > 0.0


class ConstantDrag(eqx.Module):
    """Control of a drag, and the search for a skip that has the range to go."""

    drag_gain: Scalar = scalar(0.01 / foot, unit="s2/m")
    """C16"""
    rate_gain: Scalar = scalar(0.001 / foot, unit="s/m")
    """C17"""
    search_rate: Scalar = scalar(-700.0 * foot, unit="m/s")
    """Altitude rate above which the search starts (-VRCONT)"""
    first_lift_to_drag: Scalar = scalar(0.15, positive=True)
    """Upward lift-to-drag ratio of the first skip (LEWD1)"""
    first_change: Scalar = scalar(-0.05)
    """Change of the ratio from which the secant method starts (DLEWD0)"""
    tolerance: Scalar = scalar(25.0 * MILE, unit="rad", positive=True)
    """Error of the range that ends the search"""
    slow_exit: Scalar = scalar(18_000.0 * foot, unit="m/s", positive=True)
    """Exit velocity below which the final phase comes next (VLMIN)"""
    lowering: Scalar = scalar(1_000.0 * foot, unit="m/s")
    """Decrease of the pull-out velocity while the lift is down"""

    def holding(self, prediction: SkipPrediction, seen: Seen, drag: Scalar) -> Scalar:
        """Upward lift-to-drag ratio that holds a drag."""
        balance = -GRAVITY * seen.excess(prediction) / drag
        rate = -2.0 * prediction.scale_height * drag / seen.velocity
        return balance + self._feedback(seen, drag, rate)

    def pulling_out(
        self, prediction: SkipPrediction, plan: SkipPlan, seen: Seen
    ) -> Scalar:
        """Upward lift-to-drag ratio that descends to the pull-out of a plan."""
        lift = prediction.lift_to_drag
        faster = seen.velocity - plan.pull_out_velocity
        height = 2.0 * prediction.drag_rise * prediction.scale_height
        share = (seen.velocity / plan.pull_out_velocity) ** 2
        drag = share * plan.pull_out_drag - faster * faster * lift / height
        return lift + self._feedback(seen, drag, -lift * faster)

    def _feedback(self, seen: Seen, drag: Scalar, rate: Scalar) -> Scalar:
        by_drag = self.drag_gain * (seen.drag - drag)
        return by_drag - self.rate_gain * (seen.rate - rate)


class UpControl(eqx.Module):
    """Control of the velocity and the altitude rate over the drag, up to the exit."""

    velocity_gain: Scalar = scalar(0.0034 / foot, unit="s/m")
    """KB2"""
    rate_gain: Scalar = scalar(3.4)
    """KB1"""
    soft_limit: Scalar = scalar(0.1, positive=True)
    """Change of the lift-to-drag ratio above which the gain is less by `soft_share`"""
    soft_share: Scalar = scalar(0.1, range=(0.0, 1.0))
    early_velocity: Scalar = scalar(500.0 * foot, unit="m/s")
    """Excess over the exit velocity below which a vehicle that descends goes to the final
    phase at once (C18)"""
    fading_drag: Scalar = scalar(40.0 * foot, unit="m/s2", positive=True)
    """Drag below which the gain no longer changes (Q7MIN)"""
    no_reversal_drag: Scalar = scalar(140.0 * foot, unit="m/s2", positive=True)
    """Drag above which the bank is not reversed (C21)"""
    no_dive_drag: Scalar = scalar(175.0 * foot, unit="m/s2", positive=True)
    """Drag above which the lift is never down, also in constant drag (C20)"""

    def gain(self, plan: SkipPlan, drag: Scalar, before: Scalar) -> Scalar:
        """Factor on the feedback: one at the pull-out, less with less drag (FACTOR)."""
        span = plan.first_drag - plan.exit_drag
        known = jnp.abs(span) > 1e-6
        now = (drag - plan.exit_drag) / jnp.where(known, span, 1.0)
        return jnp.where(known & (drag >= self.fading_drag), now, before)

    def climbing(
        self, prediction: SkipPrediction, plan: SkipPlan, seen: Seen, gain: Scalar
    ) -> Scalar:
        """Upward lift-to-drag ratio that follows a plan."""
        velocity = plan.velocity_at(seen.drag)
        rate = plan.lift_to_drag * (plan.pull_out_velocity - velocity)
        slower = jnp.maximum(plan.hook_velocity - velocity, 0.0)
        spans = plan.hook_span > 1.0
        share = slower / jnp.where(spans, plan.hook_span, 1.0)
        grown = 1.0 + plan.hook_slope * jnp.where(spans, share, 0.0)
        falling = prediction.hook * GRAVITY * slower * slower
        rate = rate - falling * grown / (plan.hook_drag * jnp.maximum(velocity, 1.0))
        error = self.rate_gain * gain * (seen.rate - rate) + seen.velocity - velocity
        change = -self.velocity_gain * gain * error
        inside = clamp(change, -self.soft_limit, self.soft_limit)
        soft = inside + self.soft_share * (change - inside)
        return jnp.where(
            seen.drag > plan.pull_out_drag,
            prediction.lift_to_drag,
            plan.lift_to_drag + soft,
        )

    def without_dive(self, drag: Scalar, lift_to_drag: Scalar) -> Scalar:
        """The ratio, not negative at high drag."""
        dives = (drag > self.no_dive_drag) & (lift_to_drag < 0.0)
        return jnp.where(dives, 0.0, lift_to_drag)


class DecelerationLimit(eqx.Module):
    """Lift up in the final phase where the deceleration would exceed a limit (GLIMITER).

    From half the limit on, the lift is up if the vehicle descends faster than full lift can
    stop before the limit. The limit is of the specific force, of lift and drag together.
    """

    limit: Scalar = scalar(8.0 * GRAVITY, unit="m/s2", positive=True)
    """GMAX"""

    def needs_lift(self, prediction: SkipPrediction, seen: Seen) -> Flag:
        """Whether the lift must be up."""
        left = self.limit - seen.drag
        height = 2.0 * prediction.scale_height
        lift = seen.excess(prediction) * GRAVITY / self.limit + prediction.lift_to_drag
        steady = height * self.limit / seen.velocity
        late = seen.rate + safe_sqrt(height * left * lift + steady * steady) < 0.0
        return (left < 0.0) | ((left < 0.5 * self.limit) & late)
