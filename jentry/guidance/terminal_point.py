"""The terminal-point law: the final phase of Apollo, with heading alignment."""

import math

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import PyTree

from .._math import sincos
from ..fields import Flag, Scalar, optional_scalar, scalar
from ..motion.index import VelocityIndex
from ..motion.quantities import direction_to, from_ground_track, ground_track
from ..motion.state import Controls
from ..onboard.measurement import Measurement, measure
from ..onboard.model import OnboardModel, require_sphere, require_still_air
from ..onboard.profiles import AbstractProfile
from ..onboard.reference import Reference
from ..world.planet import Planet
from .aim import Aim, TargetOfScenario, known
from .cycle import FixedCycle
from .lateral import (
    AbstractLateralLogic,
    CrossrangeCorridor,
    Destination,
    turned,
)
from .law import AbstractSampledLaw
from .open_loop import vertical_lift_command
from .switching import AbstractSwitching, Sharp


COLUMNS = (
    "drag",
    "altitude_rate",
    "lift_to_drag_up",
    "range_to_go",
    "range_per_drag",
    "range_per_altitude_rate",
    "range_per_lift_to_drag",
)
"""Quantities of the reference over the velocity: D, r, u, R, F1, F2 and F3, in SI units"""


class HeadingAlignment(eqx.Module):
    """Bank towards the target at the end of the flight, in place of range control.

    The bank is `gain` times the heading error, within `largest_bank` to either side. The
    heading error is the bearing of the target minus the heading, rad in [-pi, pi]. A
    limit of the bank leaves most of the lift upwards.
    """

    velocity: Scalar = scalar(unit="m/s", positive=True)
    """Velocity below which the bank aligns the heading"""
    gain: Scalar = scalar(4.0, positive=True)
    largest_bank: Scalar = scalar(math.pi / 6.0, unit="rad", range=(0.0, math.pi))

    def bank(
        self, aim: Aim, planet: Planet, measurement: Measurement
    ) -> tuple[Scalar, Scalar]:
        """Sine and cosine of the bank, which is positive to the right."""
        place = from_ground_track(planet, aim.origin, aim.downrange, aim.crossrange)
        ahead, right, _ = direction_to(*place, measurement.state)
        bank = self.gain * jnp.arctan2(right, ahead)
        return sincos(jnp.clip(bank, -self.largest_bank, self.largest_bank))


class EarlyEnd(eqx.Module):
    """Range that is not flown if the flight reaches the altitude of the aim too fast.

    It is for flights that end at a velocity or at an altitude, whichever comes first. In
    thin air, or for a heavy vehicle, the altitude comes first. Let q be the sensed drag
    over that of the model. Such a flight has nearly the drag of the reference at each
    velocity, lower by H ln(1/q) with the scale height H. It therefore ends where the
    reference is at the altitude h_end - H ln(q), with the range to go of the reference
    there. This extension is our own.
    """

    model: OnboardModel
    range_to_go: AbstractProfile
    """Range to go of the reference (m) over the altitude (m)"""

    def range_lost(self, aim: Aim, measurement: Measurement, sensed: Flag) -> Scalar:
        """Range to go at the predicted end, m; zero where the drag is not sensed."""
        model, state = self.model, measurement.state
        require_sphere(model.planet, "an end at the altitude of the aim")
        angle = measurement.trim_angle_of_attack
        believed = measure(model.planet, model.vehicle, state, angle).drag
        factor = jnp.where(sensed, measurement.drag, 1.0)
        factor = factor / jnp.where(sensed, believed, 1.0)
        end = eqx.tree_at(lambda s: s.altitude, state, aim.altitude)
        higher = -model.scale_height(end) * jnp.log(factor)
        lost = self.range_to_go(aim.altitude + higher)
        return jnp.maximum(jnp.where(sensed, lost, 0.0), 0.0)


class HeldBank(eqx.Module):
    """Bank that is held through a guidance cycle."""

    cos_bank: Scalar
    sin_bank: Scalar
    """Positive to the right"""
    side: PyTree
    """Decision of the lateral logic"""


class TerminalPoint(AbstractSampledLaw[tuple[()], HeldBank]):
    """Commands the lift that flies the range to go, by influence coefficients.

    The range to the end of guided flight is predicted from the reference at the present
    velocity, with the deviations of the sensed drag D and the altitude rate r:

        R_p = R + F1 (D - D_ref) + F2 (r - r_ref)

    The upward lift-to-drag ratio is that of the reference, with a correction that would
    remove the range error K times over if it were held to the end:

        u = u_ref + K (range to go - R_p) / F3

    The over-control gain K makes the correction early, when there is still lift to remove
    an error. `plan_terminal_point` computes reference and coefficients. The bank has the
    cosine u over the sensed lift-to-drag ratio, between two limits, to the side of the
    lateral logic. There are three phases:

    - Below the `gate`, a constant bank (prebank) to the side of the lateral logic.
    - Above it, range control.
    - With `alignment`, below a velocity, heading alignment.

    Sources: D. J. Morth, "Reentry Guidance for Apollo", MIT R-532, 1966, and the flight
    program, PREDICT3 of Comanche 055, 1969 (the law, and K = 4); G. F. Mendeck, L. Craig
    McGrew, "Entry Guidance Design and Postflight Performance for 2011 Mars Science
    Laboratory Mission", Journal of Spacecraft and Rockets 51(4), 2014 (prebank, heading
    alignment). Our choices: the sensed ratio of lift to drag, the form of the alignment,
    the range to go as the difference of the downranges of aim and vehicle, also past the
    aim, and `early_end`. The limit of the deceleration and the filters of these programs
    are not included.
    """

    reference: Reference
    """`COLUMNS` over the velocity"""
    planet: Planet
    """Planet on board, for ranges and bearings"""
    lateral: AbstractLateralLogic
    gate: Scalar = scalar(unit="m/s2", positive=True)
    """Sensed drag above which the range is controlled"""
    prebank: Scalar = scalar(unit="rad", range=(0.0, math.pi))
    """Bank below the gate, to the side of the lateral logic"""
    gain: Scalar = scalar(4.0, positive=True)
    """K"""
    alignment: HeadingAlignment | None = None
    early_end: EarlyEnd | None = None
    """For flights that may reach the altitude of the aim before its velocity"""
    smallest_bank: Scalar = scalar(0.0, unit="rad", range=(0.0, math.pi))
    largest_bank: Scalar = scalar(math.pi, unit="rad", range=(0.0, math.pi))
    """Largest magnitude of the bank in range control, as `smallest_bank` is the smallest"""
    narrowing: Scalar | None = optional_scalar(range=(0.0, 1.0))
    """Factor on the width of a `CrossrangeCorridor` while the bank is at one of these
    limits; one half in the flight program. None leaves the corridor as it is"""
    least_effect: Scalar = scalar(1e3, unit="m", positive=True)
    """Lower bound of F3, which is zero at the end"""
    switching: AbstractSwitching = Sharp()
    cycle: FixedCycle = FixedCycle(1.0)
    aim: Aim | TargetOfScenario = TargetOfScenario()

    def __check_init__(self):
        if not isinstance(self.reference.index, VelocityIndex):
            raise ValueError(
                f"the reference is over {type(self.reference.index).__name__}: the "
                "influence coefficients are at a velocity, so it must be a VelocityIndex"
            )
        quantities = self.reference.quantities
        names = quantities if isinstance(quantities, dict) else quantities.coefficients
        missing = [name for name in COLUMNS if name not in names]
        if missing:
            raise ValueError(
                f"the reference has no {', '.join(missing)}: it needs "
                f"{', '.join(COLUMNS)}, as plan_terminal_point gives them"
            )
        if self.narrowing is not None and not isinstance(
            self.lateral, CrossrangeCorridor
        ):
            raise ValueError(
                f"narrowing is {self.narrowing} and lateral {type(self.lateral).__name__}: "
                "only a CrossrangeCorridor is narrowed, so leave narrowing out"
            )
        limits = self.smallest_bank, self.largest_bank
        if any(isinstance(x, Tracer) or not eqx.is_array(x) for x in limits):
            return
        smallest, largest = map(float, limits)
        if not smallest < largest:
            raise ValueError(
                f"smallest_bank is {smallest:g} rad and largest_bank {largest:g} rad: the "
                "first must be below the second"
            )

    def init(self, measurement: Measurement) -> tuple[tuple[()], HeldBank]:
        side = self.lateral.init(measurement)
        sine, cosine = sincos(self.prebank + 0.0 * measurement.drag)
        return (), HeldBank(cosine, self.lateral.sign(side) * sine, side)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: HeldBank,
    ) -> tuple[tuple[()], HeldBank]:
        aim, planet, switching = known(self.aim), self.planet, self.switching
        require_still_air(planet, "a terminal-point reference")
        destination = Destination(planet, aim.origin, aim.downrange, aim.crossrange)
        excess = measurement.drag - self.gate
        sensed = excess > 0.0
        lift = jnp.where(sensed, measurement.lift, 1.0)
        drag = jnp.where(sensed, measurement.drag, 1.0)
        lower, upper = (jnp.cos(x) for x in (self.largest_bank, self.smallest_bank))
        wished = self.lift_to_drag_up(measurement) * drag / lift
        limited = sensed & ((wished <= lower) | (wished >= upper))
        lateral = self.corridor(limited)
        side = lateral.update(time, measurement, held.side, destination)
        cosine = _between(switching, wished, lower, upper)
        cosine = switching.beyond(excess, cosine, jnp.cos(self.prebank))
        angle = measurement.trim_angle_of_attack
        controls = turned(vertical_lift_command(cosine, angle), lateral.sign(side))
        cosine, sine = controls.cos_bank, controls.sin_bank
        if self.alignment is not None:
            align = measurement.state.velocity < self.alignment.velocity
            aligned = self.alignment.bank(aim, planet, measurement)
            sine, cosine = (
                jnp.where(align, a, b)
                for a, b in zip(aligned, (sine, cosine), strict=True)
            )
        return (), HeldBank(cosine, sine, side)

    def corridor(self, limited: Flag) -> AbstractLateralLogic:
        """The lateral logic, with a narrower corridor if the bank is at a limit."""
        if self.narrowing is None:
            return self.lateral
        assert isinstance(self.lateral, CrossrangeCorridor)
        return self.lateral.narrowed(jnp.where(limited, self.narrowing, 1.0))

    def range_error(self, measurement: Measurement) -> Scalar:
        """Range to go minus the predicted range R_p, m."""
        aim, state = known(self.aim), measurement.state
        downrange, _ = ground_track(self.planet, aim.origin, state)
        at = self._at(state.velocity)
        rate = state.velocity * sincos(state.flight_path_angle)[0]
        predicted = (
            at["range_to_go"]
            + at["range_per_drag"] * (measurement.drag - at["drag"])
            + at["range_per_altitude_rate"] * (rate - at["altitude_rate"])
        )
        error = aim.downrange - downrange - predicted
        if self.early_end is None:
            return error
        sensed = measurement.drag > self.gate
        return error + self.early_end.range_lost(aim, measurement, sensed)

    def lift_to_drag_up(self, measurement: Measurement) -> Scalar:
        """Commanded upward lift-to-drag ratio u, before its limits."""
        at = self._at(measurement.state.velocity)
        effect = jnp.maximum(at["range_per_lift_to_drag"], self.least_effect)
        correction = self.gain * self.range_error(measurement) / effect
        return at["lift_to_drag_up"] + correction

    def _at(self, velocity: Scalar) -> dict[str, Scalar]:
        read = self.reference.over_index(velocity)
        return {name: read[name][0] for name in COLUMNS}

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: HeldBank,
    ) -> tuple[Controls, tuple[()]]:
        angle = measurement.trim_angle_of_attack
        return Controls(angle, held.cos_bank, held.sin_bank), ()


def _between(
    switching: AbstractSwitching, cosine: Scalar, lower: Scalar, upper: Scalar
) -> Scalar:
    """A cosine within bounds, by the limits of a switching."""
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return middle + half * switching.limited((cosine - middle) / half)
