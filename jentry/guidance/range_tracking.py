"""Tracking of a reference drag that is scaled each cycle to fly the range to go.

Beyond H. Yan, Y. He, "Drag-Tracking Guidance for Entry Vehicles Without Drag Rate
Measurement". Between the cycles the law is that of the paper with the observer.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._interpolation import clamp
from .._newton import by_jvp, newton
from ..fields import Scalar, scalar
from ..motion.index import EnergyIndex
from ..motion.quantities import ground_track
from ..motion.state import Controls
from ..onboard.measurement import Measurement, measure
from ..onboard.model import OnboardModel, require_sphere, require_still_air
from ..onboard.profiles import AbstractProfile
from ..onboard.reference import DragReference
from .aim import Aim, TargetOfScenario, known
from .cycle import FixedCycle
from .drag_tracking import (
    ErrorGains,
    ObserverGains,
    ObserverState,
    Tracking,
    observe,
    track,
)
from .lateral import AbstractLateralLogic, Destination, turned
from .law import AbstractSampledLaw, Tracked
from .open_loop import vertical_lift_command
from .switching import AbstractSwitching, Sharp


_NEWTON_STEPS = 4
"""Newton steps, which start from the end of the reference. For half to twice the density,
further steps change the miss at the end of a flight by less than a metre."""


class ScaleLimits(eqx.Module):
    """Bounds of the scale of the reference drag, and the last range at which it changes."""

    lower: Scalar = scalar(positive=True)
    upper: Scalar = scalar(positive=True)
    last_range: Scalar = scalar(unit="m", positive=True)
    """Range to go below which the scale is held. It must exceed g h_s / D at the end. Below
    g h_s / D more drag no longer shortens the flight: the flight then ends lower, which
    adds as much range."""


class HeldScale(eqx.Module):
    """Decision that is held through a guidance cycle."""

    scale: Scalar
    """K, scale of the reference drag"""
    lift_factor: Scalar
    """Sensed over modelled lift-to-drag ratio"""
    side: Any
    """Decision of the lateral logic"""


def scale_to_reach(
    aim: Aim,
    reference: DragReference,
    range_flown: AbstractProfile,
    model: OnboardModel,
    energy: Scalar,
    range_to_go: Scalar,
    drag_factor: Scalar,
    angle_of_attack: Scalar,
) -> Scalar:
    """Scale K of the reference drag that flies the range to go until the predicted end.

    The range flown over an energy interval is the integral of cos(gamma) r0 / (r D). The
    drag K D* therefore flies 1/K of the range of the reference between the same energies:

        K range_to_go = S*(E_end) - S*(E)

    On the profile, D = K D*(E) is also q D_m(h, V), the drag of the onboard model times
    the sensed factor q, at every altitude and velocity. This relates K to the end of the
    flight. The flight ends either at the end altitude with a higher velocity or at the end
    velocity with a higher altitude. The sign of the range error of the profile through the
    corner, where both end conditions are met, determines which end comes first. From the
    corner Newton's method searches for the end along one of the two conditions, with the
    energy above the corner as unknown. The error is convex along one and concave along the
    other, such that the iteration converges from one side.

    The result is NaN where the search meets a value that is not finite.

    **Arguments:**

    - `range_flown`: S*, range flown by the reference, over the energy; m.
    - `energy`: present energy, J/kg.
    - `range_to_go`: m.
    - `drag_factor`: q, sensed drag over that of the onboard model.
    - `angle_of_attack`: angle of attack for the rest of the flight, rad.
    """
    planet = model.planet
    require_still_air(planet, "the range of a scaled reference")
    require_sphere(planet, "the range of a scaled reference")
    radius = planet.radius + aim.altitude
    gravity = planet.gravity.acceleration(radius)
    flown = range_flown(energy)

    def through(altitude: Scalar, kinetic: Scalar) -> tuple[Scalar, Scalar]:
        """Range error of the profile that ends here (m), and its scale."""
        end = kinetic + planet.gravity.potential(planet.radius + altitude)
        there = eqx.tree_at(
            lambda s: (s.altitude, s.velocity),
            aim.origin,
            (altitude, jnp.sqrt(2.0 * kinetic)),
        )
        loading = model.ballistic_coefficient(there, angle_of_attack)
        modelled = planet.density(altitude) * kinetic / loading
        scale = drag_factor * modelled / reference.drag(end)
        return scale * range_to_go - (range_flown(end) - flown), scale

    corner = aim.altitude, 0.5 * aim.velocity * aim.velocity
    too_short, _ = through(*corner)
    low = too_short < 0.0
    climb, speed_up = jnp.where(low, 0.0, 1.0 / gravity), jnp.where(low, 1.0, 0.0)

    def along(excess: Scalar) -> tuple[Scalar, Scalar]:
        altitude, kinetic = corner
        return through(altitude + excess * climb, kinetic + excess * speed_up)

    corner_energy = corner[1] + planet.gravity.potential(radius)
    found = newton(
        by_jvp(lambda excess: along(excess)[0]),
        0.0 * range_to_go,
        _NEWTON_STEPS,
        lower=0.0,
        upper=jnp.maximum(energy - corner_energy, 0.0),
        nan_where_lost=True,
    )
    _, scale = along(found.x)
    return scale


class RangeTracking(AbstractSampledLaw[ObserverState, HeldScale]):
    """Drag tracking with an observer, of a reference that is scaled to the range to go.

    Between cycles the law is equations (24) and (25) with K D* in place of D*. At a
    guidance cycle, once the drag exceeds the gate of the reference, it decides:

    - the scale K, see `scale_to_reach`, with the ratio of the sensed to the modelled drag.
      The estimates of the observer for the drag error D - K D* jump with K, so that the
      observer sees no step.
    - the lift-to-drag ratio with which the bank is computed: the sensed one.

    From the start of guidance it also decides:

    - the side of the bank, by its lateral logic. With a `CrossrangeCorridor` the bank is
      reversed when the predicted crossrange at the aim leaves the corridor.
    """

    gains: ErrorGains
    observer: ObserverGains
    reference: DragReference
    """Drag over energy"""
    range_flown: AbstractProfile
    """Range flown by the reference (m) over the energy"""
    model: OnboardModel
    limits: ScaleLimits
    lateral: AbstractLateralLogic
    switching: AbstractSwitching = Sharp()
    cycle: FixedCycle = FixedCycle(1.0)
    aim: Aim | TargetOfScenario = TargetOfScenario()

    def __check_init__(self):
        if not isinstance(self.reference.index, EnergyIndex):
            raise ValueError(
                f"the reference is over {type(self.reference.index).__name__}: range "
                "is scaled by the drag over energy, so it must be an EnergyIndex"
            )

    def init(self, measurement: Measurement) -> tuple[ObserverState, HeldScale]:
        zero = 0.0 * measurement.drag
        held = HeldScale(1.0 + zero, 1.0 + zero, self.lateral.init(measurement))
        tracking = self._track(zero, measurement, None, held)
        return ObserverState(tracking.x1, zero), held

    def tracked(
        self, time: Scalar, measurement: Measurement, held: HeldScale
    ) -> Tracked:
        tracking = self._track(time, measurement, None, held)
        return Tracked(((tracking.x1, tracking.x2),), ("bank_angle",))

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: ObserverState,
        held: HeldScale,
    ) -> tuple[ObserverState, HeldScale]:
        aim, planet, state = known(self.aim), self.model.planet, measurement.state
        downrange, _ = ground_track(planet, aim.origin, state)
        range_to_go = aim.downrange - downrange

        sensed = measurement.drag > self.reference.gate
        scales = sensed & (range_to_go > self.limits.last_range)
        angle = measurement.trim_angle_of_attack
        believed = measure(planet, self.model.vehicle, state, angle)
        scale = scale_to_reach(
            aim,
            self.reference,
            self.range_flown,
            self.model,
            self.reference.index.value(planet, time, state),
            # Where it is not used it may be zero, at which the derivative is not finite.
            jnp.where(scales, range_to_go, aim.downrange),
            measurement.drag / believed.drag,
            angle,
        )
        scales = scales & jnp.isfinite(scale)
        scale = clamp(scale, self.limits.lower, self.limits.upper)
        lift_factor = (measurement.lift / measurement.drag) / (
            believed.lift / believed.drag
        )
        destination = Destination(planet, aim.origin, aim.downrange, aim.crossrange)
        decided = HeldScale(
            scale=jnp.where(scales, scale, held.scale),
            lift_factor=jnp.where(sensed, lift_factor, held.lift_factor),
            side=self.lateral.update(time, measurement, held.side, destination),
        )
        jump = decided.scale - held.scale
        return self._shifted(time, measurement, memory, jump), decided

    def _shifted(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: ObserverState,
        jump: Scalar,
    ) -> ObserverState:
        """The estimates of D - K D* and of its rate after a jump of K."""
        nothing = jnp.zeros_like(jump)
        angle = measurement.trim_angle_of_attack
        wanted = self.reference.at(time, measurement, self.model, angle, nothing)
        return ObserverState(
            drag_error=memory.drag_error - jump * wanted.value,
            drag_error_rate=memory.drag_error_rate - jump * wanted.rate,
        )

    def _track(
        self,
        time: Scalar,
        measurement: Measurement,
        observed: ObserverState | None,
        held: HeldScale,
    ) -> Tracking:
        model = eqx.tree_at(
            lambda m: m.vehicle.lift_scale,
            self.model,
            self.model.vehicle.lift_scale * held.lift_factor,
        )
        return track(
            self.gains,
            self.reference,
            model,
            time,
            measurement,
            observed,
            self.switching,
            held.scale,
        )

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: ObserverState,
        held: HeldScale,
    ) -> tuple[Controls, ObserverState]:
        tracking = self._track(time, measurement, memory, held)
        angle_of_attack = measurement.trim_angle_of_attack
        controls = vertical_lift_command(tracking.u, angle_of_attack)
        rate = observe(self.gains, self.observer, self.switching, tracking, memory)
        return turned(controls, self.lateral.sign(held.side)), rate
