"""Range of a skip in closed form: pull-out, up phase, ballistic arc and final phase."""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ..._interpolation import clamp
from ..._math import arcsin, safe_sqrt
from ...fields import Scalar, scalar
from ...units import foot


GRAVITY = 32.2 * foot
"""Acceleration that the flight program calls one g, m/s2"""

MILE = math.pi / 10_800.0
"""Angle of a nautical mile of the flight program: 21 600 are a full circle, rad"""

_TINY = 1e-9
"""Bound of divisors that are zero in no flight"""


class SkipPlan(eqx.Module):
    """An up-control trajectory: the velocity over the drag from pull-out to exit.

    Velocities are inertial. Names in brackets are those of the flight program.
    """

    pull_out_velocity: Scalar = scalar(unit="m/s")
    """Velocity at the pull-out, where the altitude is lowest (V1)"""
    pull_out_drag: Scalar = scalar(unit="m/s2")
    """Largest drag, at the pull-out (A0)"""
    first_drag: Scalar = scalar(unit="m/s2")
    """Drag at which the feedback has its full gain (A1)"""
    exit_velocity: Scalar = scalar(unit="m/s")
    """Velocity at the exit (VL)"""
    exit_drag: Scalar = scalar(unit="m/s2")
    """Drag at the exit (Q7)"""
    exit_angle: Scalar = scalar(unit="rad", range=(-math.inf, math.inf))
    """Flight-path angle at the exit (GAMMAL)"""
    mean_angle: Scalar = scalar(unit="rad", range=(-math.inf, math.inf))
    """Flight-path angle with which the range of the up phase is computed (GAMMAL1)"""
    lift_to_drag: Scalar = scalar()
    """Upward lift-to-drag ratio of the trajectory (LEWD)"""
    curvature: Scalar = scalar()
    """2 C1 H A0 / (LEWD V1^2), below one (ALP)"""
    hook_velocity: Scalar = scalar(unit="m/s")
    """Velocity below which gravity bends the trajectory (VS1)"""
    hook_span: Scalar = scalar(unit="m/s")
    """Hook velocity minus exit velocity (DVL)"""
    hook_drag: Scalar = scalar(unit="m/s2")
    """Drag at the hook velocity (DHOOK)"""
    hook_slope: Scalar = scalar()
    """Correction of the bend for the change of the drag (AHOOK DVL)"""

    @classmethod
    def unknown(cls, nothing: Scalar) -> "SkipPlan":
        """A plan before the first prediction, with ones, and of the shape of `nothing`."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(**{name: nothing + 1.0 for name in names})

    @property
    def velocity_factor(self) -> Scalar:
        """V1 / (1 - ALP), m/s (FACT1)."""
        return self.pull_out_velocity / (1.0 - self.curvature)

    @property
    def drag_factor(self) -> Scalar:
        """ALP (ALP - 1) / A0, s2/m (FACT2)."""
        return self.curvature * (self.curvature - 1.0) / self.pull_out_drag

    def velocity_at(self, drag: Scalar) -> Scalar:
        """Velocity at a drag (VREF), m/s."""
        root = safe_sqrt(self.drag_factor * drag + self.curvature)
        return self.velocity_factor * (1.0 - root)

    def drag_at(self, velocity: Scalar) -> Scalar:
        """Drag at a velocity: the inverse of `velocity_at`, m/s2."""
        share = 1.0 - velocity / self.velocity_factor
        return (share * share - self.curvature) / self.drag_factor


class SkipRange(NamedTuple):
    """Parts of the range of a skip, as angles about the centre of the planet, rad."""

    down: Scalar
    """To the pull-out (ASPDWN)"""
    up: Scalar
    """From the pull-out to the exit (ASPUP)"""
    ballistic: Scalar
    """From the exit to the same altitude (ASKEP)"""
    final: Scalar
    """Final phase (ASP1)"""
    correction: Scalar
    """Correction of the final phase for the angle at its start (ASP3)"""

    @property
    def total(self) -> Scalar:
        return self.down + self.up + self.ballistic + self.final + self.correction


class SkipPrediction(eqx.Module):
    """Predicts a skip from the present velocity, altitude rate and drag, in closed form.

    The lift-to-drag ratio is constant in each part, the air is exponential, and gravity and
    centrifugal force balance down to the circular velocity. Below it, a correction (the
    hook) bends the trajectory down. If the skip does not reach the exit drag, the exit is
    where the trajectory is level, at the drag there.

    Defaults are the constants of Comanche 055, 1969, with the load of the pad for the
    lift-to-drag ratio. Equations: P. E. Moseley, "The Apollo Entry Guidance: A Review of
    the Mathematical Development and Its Operational Characteristics", TRW, 1969, as coded
    in HUNTEST, RANGER and NEGAMA of the program.
    """

    lift_to_drag: Scalar = scalar(0.3, positive=True)
    """Largest lift-to-drag ratio that is counted on (LAD)"""
    circular_velocity: Scalar = scalar(25766.1973 * foot, unit="m/s", positive=True)
    """VSAT"""
    radius: Scalar = scalar(21_202_900.0 * foot, unit="m", positive=True)
    """Radius at which the ranges are angles (RE)"""
    scale_height: Scalar = scalar(28_500.0 * foot, unit="m", positive=True)
    """HS"""
    drag_rise: Scalar = scalar(1.25, positive=True)
    """Factor on the scale height in the up phase (C1)"""
    hook: Scalar = scalar(1.0, positive=True)
    """Factor on the bend below the circular velocity (CH1)"""
    hook_growth: Scalar = scalar(0.25)
    """Factor on the correction of the bend (CHOOK)"""
    angle_share: Scalar = scalar(0.5, range=(0.0, 1.0))
    """Share of the exit angle in the mean angle of the up phase (Q19)"""
    exit_drag: Scalar = scalar(6.0 * foot, unit="m/s2", positive=True)
    """Drag at which the vehicle leaves the air (Q7F)"""
    final_range: Scalar = scalar((-1152.0 + 500.0 * 0.3) * MILE, unit="rad")
    """Range of the final phase, extrapolated to an exit velocity of zero (Q2)"""
    final_range_per_velocity: Scalar = scalar(0.07 * MILE / foot, unit="s/m")
    """Range of the final phase per exit velocity, rad s/m (Q3)"""
    final_range_per_angle: Scalar = scalar(0.3 * 23_500.0 * MILE)
    """Range of the final phase, rad, per rad by which the exit angle is below
    `final_angle` (Q5)"""
    final_angle: Scalar = scalar(0.0349, unit="rad")
    """Exit angle for which the range of the final phase holds (Q6)"""

    def plan(
        self,
        velocity: Scalar,
        rate: Scalar,
        drag: Scalar,
        up: Scalar,
        lower: Scalar,
    ) -> SkipPlan:
        """Up-control trajectory from a velocity, an altitude rate and a drag.

        `up` is the upward lift-to-drag ratio from the pull-out on. The pull-out velocity is
        lower by `lower`, m/s.
        """
        falls = rate < 0.0
        ratio = jnp.where(falls, self.lift_to_drag, up)
        height = 2.0 * self.drag_rise * self.scale_height
        v1 = velocity + rate / ratio
        a0 = (v1 / velocity) ** 2 * (drag + rate * rate / (ratio * height))
        a0 = jnp.maximum(a0, _TINY)
        first = jnp.where(falls, a0, drag)
        v1 = v1 - lower
        alpha = jnp.minimum(height * a0 / (up * v1 * v1), 1.0 - 1e-6)
        return self._hooked(v1, a0, first, alpha, up)

    def _hooked(
        self, v1: Scalar, a0: Scalar, first: Scalar, alpha: Scalar, up: Scalar
    ) -> SkipPlan:
        circular, q7 = self.circular_velocity, self.exit_drag
        nothing = jnp.zeros_like(v1)
        bare = SkipPlan(
            v1,
            a0,
            first,
            nothing,
            q7 + nothing,
            nothing,
            nothing,
            up,
            alpha,
            nothing,
            nothing,
            nothing,
            nothing,
        )
        vl = jnp.maximum(bare.velocity_at(q7), 1.0)
        vs = jnp.minimum(v1, circular)
        span = vs - vl
        hook_drag = jnp.maximum(bare.drag_at(vs), _TINY)
        slope = self.hook_growth * (hook_drag / q7 - 1.0)
        straight = up * (v1 - vl) / vl
        bend = self.hook * GRAVITY * span / (hook_drag * vl)
        angle = straight - bend * span * (1.0 + slope) / vl

        # NEGAMA: the exit is where the trajectory is level.
        dives = angle < 0.0
        steepness = up / 3.0 - bend * (2.0 / 3.0 + slope)
        solvable = dives & (jnp.abs(steepness) > _TINY)
        steepness = jnp.where(solvable, steepness, -1.0)
        level = vl + jnp.where(dives, angle, 0.0) * vl / 3.0 / steepness
        drag_there = jnp.maximum(bare.drag_at(level), _TINY)
        vl = jnp.where(dives, level, vl)
        q7 = jnp.where(dives, drag_there, q7)
        angle = jnp.where(dives, 0.0, angle)
        mean = straight + self.angle_share * (angle - straight)
        return SkipPlan(
            v1, a0, first, vl, q7, angle, mean, up, alpha, vs, span, hook_drag, slope
        )

    def range(self, plan: SkipPlan, velocity: Scalar, rate: Scalar) -> SkipRange:
        """Range of a plan from the velocity and the altitude rate it was made for."""
        share = (plan.exit_velocity / self.circular_velocity) ** 2
        sine = plan.exit_angle
        cosine = 1.0 - 0.5 * sine * sine
        eccentricity = safe_sqrt(1.0 + (share - 2.0) * share * cosine * cosine)
        eccentricity = jnp.maximum(eccentricity, _TINY)
        half = clamp(share * cosine * sine / eccentricity, -1.0 + _TINY, 1.0 - _TINY)
        faster = (plan.pull_out_velocity / plan.exit_velocity) ** 2
        thinner = jnp.log(faster * plan.exit_drag / plan.pull_out_drag)
        climbs = jnp.maximum(plan.mean_angle, _TINY)
        resists = plan.pull_out_drag * self.lift_to_drag * self.radius
        per_velocity = self.final_range_per_velocity * plan.exit_velocity
        return SkipRange(
            down=-rate * velocity / resists,
            up=-self.scale_height / self.radius * thinner / climbs,
            ballistic=2.0 * arcsin(half),
            final=self.final_range + per_velocity,
            correction=self.final_range_per_angle * (self.final_angle - sine),
        )
