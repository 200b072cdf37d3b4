"""Track a reference drag that is rescaled each second to fly the range to go.

In the family of H. Yan, Y. He, "Drag-Tracking Guidance for Entry Vehicles Without Drag
Rate Measurement", and beyond it: the reference follows the range that is left, and bank
reversals keep the flight in its plane.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .._interpolation import clamp
from .._types import Scalar, scalar
from ..motion.forces import air_data
from ..motion.quantities import ground_track
from ..motion.state import Controls, EntryState
from ..onboard.model import OnboardModel
from ..onboard.navigation import Measurement
from ..onboard.profiles import AbstractProfile
from ..onboard.reference import DragReference
from .drag_tracking import ErrorGains, ObserverGains, ObserverState, observe, track
from .lateral import LateralCorridor, predicted_crossrange, reverse_bank
from .law import AbstractSampledLaw
from .open_loop import vertical_lift_command


class Aim(eqx.Module):
    """Where the law is to bring the vehicle: its own copy, never dispersed.

    Guided flight ends at the first of the altitude and the velocity, and should then be
    at the downrange and crossrange, counted from the origin as in `ground_track`.
    """

    origin: EntryState
    downrange: Scalar = scalar(unit="m")
    crossrange: Scalar = scalar(unit="m")
    altitude: Scalar = scalar(unit="m")
    velocity: Scalar = scalar(unit="m/s", positive=True)


class RangeScaling(eqx.Module):
    """When and how far the reference drag may be scaled."""

    last_range: Scalar = scalar(unit="m", positive=True)
    """With less than this to go the scale is left as it is"""
    least: Scalar = scalar(0.5, positive=True)
    most: Scalar = scalar(2.0, positive=True)


class Decision(eqx.Module):
    """What is held through a guidance cycle."""

    scale: Scalar
    """Of the reference drag"""
    bank_sign: Scalar
    """1 to the right, -1 to the left"""


def scale_to_reach(law, now, to_go, q, steps=5):
    planet, beta = law.model.planet, law.model.ballistic_coefficient

    def end(altitude, kinetic):
        """Scale for which the profile passes here, and the range error it then makes"""
        E = kinetic + planet.gravity.potential(planet.radius + altitude)
        scale = q * planet.density(altitude) * kinetic / (beta * law.reference.drag(E))
        return scale * to_go - (law.range_flown(E) - now), scale

    aim = law.aim
    kinetic_end = 0.5 * aim.velocity * aim.velocity
    altitude, kinetic = aim.altitude, kinetic_end
    one = jnp.ones_like(altitude)
    for _ in range(steps):
        error, slope, _ = jax.jvp(lambda h: end(h, kinetic_end), (altitude,), (one,), has_aux=True)
        altitude = clamp(altitude - error / slope, 0., 30e3)
        error, slope, _ = jax.jvp(lambda e: end(aim.altitude, e), (kinetic,), (one,), has_aux=True)
        kinetic = clamp(kinetic - error / slope, 0.5*kinetic_end, 20.*kinetic_end)
    _, slow = end(altitude, kinetic_end)
    _, low = end(aim.altitude, kinetic)
    return jnp.minimum(slow, low)


class RangeTracking(AbstractSampledLaw[ObserverState, Decision]):
    """Drag tracking with an observer, of a reference scaled to the range to go.

    Between cycles this is equations (24) and (25), with K D* for D*. At each cycle K is
    the range that the reference still flies from this energy to the predicted end,
    over the range to go: range flown over energy is the integral of 1/D. While the drag
    is below the gate of the reference K stays as it is. The drag error that the observer
    estimates jumps with K, so that the observer sees no step.

    Bank is reversed when the crossrange predicted at the target leaves the corridor.
    """

    gains: ErrorGains
    observer: ObserverGains
    reference: DragReference
    range_flown: AbstractProfile
    """By the reference, over its index, m"""
    model: OnboardModel
    aim: Aim
    scaling: RangeScaling
    corridor: LateralCorridor
    first_bank_sign: Scalar = scalar(1.0)
    period: float = eqx.field(default=1.0, static=True)

    def init(self, measurement: Measurement) -> tuple[ObserverState, Decision]:
        zero = 0.0 * measurement.drag
        held = Decision(1.0 + zero, self.first_bank_sign)
        tracking = self._track(zero, measurement, None, held)
        return ObserverState(tracking.x1, zero), held

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: ObserverState,
        held: Decision,
    ) -> tuple[ObserverState, Decision]:
        planet, state = self.model.planet, measurement.state
        downrange, _ = ground_track(planet, self.aim.origin, state)
        to_go = self.aim.downrange - downrange
        scale = self._scale(measurement, to_go, held.scale)
        index = self.reference.index.motion(time,measurement,self.model,0.0*time)
        D,slope,_ = self.reference.drag.with_derivatives(index.value)
        jump = scale-held.scale
        memory = ObserverState(memory.drag_error - jump * D, memory.drag_error_rate - jump*slope*index.rate)
        crossrange = predicted_crossrange(planet, self.aim.origin, state, to_go)
        sign = reverse_bank(
            held.bank_sign,
            crossrange - self.aim.crossrange,
            self.corridor.half_width(state.velocity),
        )
        return memory, Decision(scale, sign)

    def _scale(self, measurement, to_go, scale):
        state = measurement.state
        modelled=self.model.planet.density(state.altitude)*state.velocity**2/2/self.model.ballistic_coefficient
        q = measurement.drag/modelled
        energy = self.reference.index.value(self.model.planet, 0.0*to_go, state)
        scales = (measurement.drag > self.reference.gate) & (to_go > self.scaling.last_range)
        wanted = scale_to_reach(self, self.range_flown(energy), jnp.where(scales,to_go,1e5), q)
        wanted = clamp(wanted,self.scaling.least,self.scaling.most)
        return jnp.where(scales, wanted, scale)

    def _track(self, time, measurement, observed, held):
        return track(
            self.gains, self.reference, self.model, time, measurement, observed, held.scale
        )

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: ObserverState,
        held: Decision,
    ) -> tuple[Controls, ObserverState]:
        tracking = self._track(time, measurement, memory, held)
        angle_of_attack = self.model.vehicle.trim_angle_of_attack
        rate = observe(self.gains, self.observer, tracking, memory)
        return vertical_lift_command(tracking.u, angle_of_attack, held.bank_sign), rate
