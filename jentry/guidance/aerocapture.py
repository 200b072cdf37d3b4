"""Numerical predictor-corrector for an aerocapture: lift up first, then a larger bank.

In each guidance cycle the onboard model is propagated to the exit from the atmosphere, and
the apoapsis of the orbit there is compared with that of the target orbit. In the first
phase the bank is small, and the law corrects the time of the switch to a large bank. From
that time on, in the second phase, it corrects a constant magnitude of the bank. This is
the shape of the bank for which the burns after the exit are smallest.

Source: P. Lu, C. Cerimele, M. Tigges, D. Matz, "Optimal Aerocapture Guidance", Journal of
Guidance, Control, and Dynamics 38(4), 2015. We have not seen the paper itself: the two
phases are as later papers describe them. Beyond these: Newton's method with the exact
derivative of the prediction, in both phases; the reciprocal of the apoapsis radius in place
of the apoapsis, which is smooth for a hyperbola too.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from .._batching import where_due
from .._interpolation import clamp
from .._math import safe_sqrt, sincos
from .._newton import newton
from ..fields import Flag, Scalar, scalar
from ..motion.orbit import OrbitTarget, orbit_of
from ..motion.state import Controls, EntryState
from ..onboard.estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    AbstractFactors,
    FactorEstimator,
)
from ..onboard.measurement import Measurement, measure
from ..onboard.model import OnboardModel, require_sphere
from ..onboard.propagation import Prediction, propagate, require_corrections
from ..units import degree, km
from .aim import OrbitOfScenario, known_orbit
from .cycle import FixedCycle
from .inclination import InclinationCorridor, OrbitPlane
from .lateral import AbstractLateralLogic, FixedSide
from .law import AbstractSampledLaw


_HALF_TURN = 0.0, math.pi

_LEAVES_THE_AIR = 1
"""Place of the exit altitude among the ends of a prediction"""


class CaptureDecision(eqx.Module):
    """Decision at a guidance cycle."""

    exits: Scalar
    """1 if the second phase has begun, else 0"""
    switches_at: Scalar
    """Time at which the second phase begins, s since the start"""
    cos_bank: Scalar
    """Cosine of the constant bank of the second phase"""
    side: Any
    """Decision of the lateral logic"""
    estimate: AbstractFactorEstimate
    decisions: Scalar
    """Number of corrections so far"""
    without_prediction: Scalar
    """Number of corrections with a prediction that was not finite"""


class AerocaptureGuidance(AbstractSampledLaw[tuple[()], CaptureDecision]):
    """Commands the bank with which the onboard model leaves the air for the target orbit.

    In the first phase the bank has the magnitude `first_bank`, which is small, until the
    switch. The time of the switch is such that a flight which then turns to `exit_bank` is
    predicted to have the apoapsis of the target. In the second phase the bank has a
    constant magnitude, between `first_bank` and `largest_bank`, which is corrected for the
    same apoapsis. If the apoapsis cannot be met, the switch is as early or as late, and the
    bank as small or as large, as allowed. An `exit_bank` below the largest one leaves the
    second phase a reserve. Once begun, the second phase does not end.

    At the start of a cycle the sensed lift and drag are compared with those of the model,
    and the prediction uses the estimated factors. It ends at the exit altitude or on the
    ground, where the orbit has a low apoapsis. So it has for a flight that is still in the
    air after all steps. A prediction that is not finite leaves the decision unchanged.

    The apoapsis is that of the inertial velocity, over a planet that may rotate. The
    prediction is in three dimensions, with the bank on its present side to the exit.

    More lift upwards raises the apoapsis. Late on the way out it may lower it a little: on
    a climbing path lift upwards points backwards too, and over a rotating planet it takes
    energy from the orbit. In the second phase the derivative of the prediction tells which
    of the two holds, and the bank goes that way.

    The derivative of a flight has the following meaning. The corrections are differentiated
    exactly. Three things are discrete: the cycle at which the second phase begins, bank
    reversals, and the cycle at which the drag first exceeds `gate`. A number at a bound has
    no derivative.
    """

    model: OnboardModel
    orbit: OrbitTarget | OrbitOfScenario = OrbitOfScenario()
    """Target orbit"""
    lateral: AbstractLateralLogic = FixedSide()
    """Side of the bank: an `InclinationCorridor`, or a fixed side"""
    exit_altitude: Scalar = scalar(130.0 * km, unit="m", positive=True)
    """Altitude at which a vehicle has left the air"""
    first_bank: Scalar = scalar(15.0 * degree, unit="rad", range=_HALF_TURN)
    """Magnitude of the bank in the first phase, and the least one in the second phase"""
    exit_bank: Scalar = scalar(120.0 * degree, unit="rad", range=_HALF_TURN)
    """Magnitude of the bank after the switch, in predictions of the first phase"""
    largest_bank: Scalar = scalar(165.0 * degree, unit="rad", range=_HALF_TURN)
    """Largest magnitude of the bank in the second phase"""
    turn_rate: Scalar = scalar(15.0 * degree, unit="rad/s", positive=True)
    """Rate at which the bank turns after the switch, until the second phase begins"""
    latest_switch: Scalar = scalar(300.0, unit="s", positive=True)
    """Largest time to the switch that is considered"""
    gate: Scalar = scalar(0.2, unit="m/s2", positive=True)
    """Sensed drag below which the decision stays unchanged, since there is too little
    lift"""
    estimator: AbstractFactorEstimator = eqx.field(default_factory=FactorEstimator)
    cycle: FixedCycle = FixedCycle(1.0)
    corrections: int = eqx.field(default=2, static=True)
    """Newton steps in one guidance cycle; each needs a prediction"""
    step: float = eqx.field(default=4.0, static=True)
    """Step of a prediction, s"""
    steps: int = eqx.field(default=200, static=True)
    """Largest number of steps in a prediction"""

    def __check_init__(self):
        require_corrections(self.corrections, self.step, self.steps)
        for larger in ("exit_bank", "largest_bank"):
            _require_order(self, "first_bank", larger)

    def init(self, measurement: Measurement) -> tuple[tuple[()], CaptureDecision]:
        nothing = 0.0 * measurement.drag
        return (), CaptureDecision(
            exits=nothing,
            switches_at=nothing + 0.5 * self.latest_switch,
            cos_bank=nothing + sincos(self.exit_bank)[1],
            side=self.lateral.init(measurement),
            estimate=self.estimator.start(nothing),
            decisions=nothing,
            without_prediction=nothing,
        )

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: CaptureDecision,
    ) -> tuple[tuple[()], CaptureDecision]:
        require_sphere(self.model.planet, "the guidance of an aerocapture")
        senses = measurement.drag > self.gate
        estimate = self._estimate(measurement, held.estimate, senses)
        begun = senses & (time >= held.switches_at)
        exits = (held.exits > 0.5) | begun
        sign = self.lateral.sign(held.side)

        def correct(before: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            return self._correct(measurement, estimate.ahead, before[0], exits, sign)

        begin = jnp.where(exits, held.cos_bank, held.switches_at - time)
        before = begin, jnp.zeros_like(held.decisions)
        number, lacks = where_due(senses, correct, before)
        corrects_time = senses & ~exits
        # Without air to feel, the switch is planned as a time to go.
        waits = ~senses & ~exits
        later = jnp.where(waits, held.switches_at + self.cycle.period, held.switches_at)
        side = self._side(time, measurement, held.side)
        return (), CaptureDecision(
            exits=jnp.where(exits, 1.0, 0.0),
            switches_at=jnp.where(corrects_time, time + number, later),
            cos_bank=jnp.where(exits, number, held.cos_bank),
            side=side,
            estimate=estimate,
            decisions=held.decisions + jnp.where(senses, 1.0, 0.0),
            without_prediction=held.without_prediction + lacks,
        )

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: CaptureDecision,
    ) -> tuple[Controls, tuple[()]]:
        exits = held.exits > 0.5
        cosine = self._cos_bank(exits, held.cos_bank, held.switches_at, time)
        angle = measurement.trim_angle_of_attack
        return _banked_to(cosine, angle, self.lateral.sign(held.side)), ()

    def caveats(self, held: CaptureDecision) -> dict[str, Scalar]:
        """Share of the corrections without a prediction, and caveats of the estimate."""
        share = held.without_prediction / jnp.maximum(held.decisions, 1.0)
        return {"decisions_without_prediction": share} | held.estimate.caveats()

    def predicted(
        self,
        measurement: Measurement,
        factors: AbstractFactors,
        number: Scalar,
        exits: Flag,
        sign: Scalar | float,
    ) -> Prediction:
        """Rest of the flight as predicted with the onboard model, to exit or ground.

        **Arguments:**

        - `number`: in the first phase the time to the switch, s; in the second phase the
          cosine of the bank.
        - `exits`: whether it is the second phase.
        """
        angle = measurement.trim_angle_of_attack

        def flown(elapsed: Scalar, state: EntryState) -> Controls:
            cosine = self._cos_bank(exits, number, number, elapsed)
            return _banked_to(cosine, angle, sign)

        ceiling = self.exit_altitude
        return propagate(
            self.model,
            measurement.state,
            flown,
            (lambda state: state.altitude, lambda state: ceiling - state.altitude),
            step=self.step,
            steps=self.steps,
            factors=factors,
        )

    def _cos_bank(
        self, exits: Flag, cosine: Scalar, switches_at: Scalar, time: Scalar
    ) -> Scalar:
        """Cosine of the bank of either phase at a time."""
        since = jnp.where(exits, 0.0, time - switches_at)
        turned = self.first_bank + self.turn_rate * jnp.maximum(since, 0.0)
        _, switching = sincos(jnp.minimum(turned, self.exit_bank))
        return jnp.where(exits, cosine, switching)

    def _correct(
        self,
        measurement: Measurement,
        factors: AbstractFactors,
        number: Scalar,
        exits: Flag,
        sign: Scalar | float,
    ) -> tuple[Scalar, Scalar]:
        """The number of the phase after its corrections, and 1 if a prediction was not
        finite, else 0."""
        planet = self.model.planet
        goal = planet.radius + known_orbit(self.orbit).apoapsis_altitude
        (_, steep), (_, flat) = sincos(self.first_bank), sincos(self.largest_bank)
        lower = jnp.where(exits, flat, 0.0)
        upper = jnp.where(exits, steep, self.latest_switch)

        def too_low(number: Scalar) -> tuple[Scalar, Flag]:
            """How far the apoapsis is too low, and whether the vehicle leaves the air."""
            end = self.predicted(measurement, factors, number, exits, sign)
            inverse = orbit_of(planet, end.state).inverse_apoapsis_radius
            return goal * inverse - 1.0, end.ended_by == _LEAVES_THE_AIR

        def falling(number: Scalar) -> tuple[Scalar, Scalar]:
            """`too_low` with its slope; both change their sign where more lift upwards
            lowers the apoapsis.

            Only a flight with a constant bank that leaves the air tells this. One that
            comes down has too little lift whatever its slope is, and a switch late in the
            climb may have to be much earlier.
            """
            one = jnp.ones_like(number)
            value, slope, leaves = jax.jvp(too_low, (number,), (one,), has_aux=True)
            way = jnp.where(exits & leaves & (slope > 0.0), -1.0, 1.0)
            return way * value, way * slope

        found = newton(
            falling,
            clamp(number, lower, upper),
            self.corrections,
            lower=lower,
            upper=upper,
            falls=True,
        )
        return jnp.asarray(found.x), jnp.where(found.known, 0.0, 1.0)

    def _side(self, time: Scalar, measurement: Measurement, side: Any) -> Any:
        """Decision of the lateral logic, which only the inclination gives an aim."""
        desired = known_orbit(self.orbit).inclination
        lateral = self.lateral
        if desired is None or not isinstance(lateral, InclinationCorridor):
            return lateral.update(time, measurement, side, None)
        plane = OrbitPlane(self.model.planet, desired)
        return lateral.update(time, measurement, side, plane)

    def _estimate(
        self, measurement: Measurement, before: AbstractFactorEstimate, senses: Flag
    ) -> AbstractFactorEstimate:
        state, model = measurement.state, self.model
        angle = measurement.angle_of_attack
        believed = measure(model.planet, model.vehicle, state, angle)
        after = self.estimator.update(
            before,
            state.altitude,
            (measurement.lift, measurement.drag),
            (believed.lift, believed.drag),
            jnp.full_like(measurement.drag, self.cycle.period),
        )
        return jax.tree.map(lambda a, b: jnp.where(senses, a, b), after, before)


def _banked_to(cosine: Scalar, angle: Scalar, sign: Scalar | float) -> Controls:
    return Controls(angle, cosine, sign * safe_sqrt(1.0 - cosine * cosine))


def _require_order(law: AerocaptureGuidance, smaller: str, larger: str) -> None:
    first, second = getattr(law, smaller), getattr(law, larger)
    if any(isinstance(x, Tracer) or jnp.ndim(x) for x in (first, second)):
        return
    if not eqx.is_array(first) or not eqx.is_array(second):
        return
    if not float(first) < float(second):
        raise ValueError(
            f"{smaller} is {float(first) / degree:g} deg and {larger} "
            f"{float(second) / degree:g} deg: the lift is upwards first and downwards "
            f"after the switch, so {smaller} must be the smaller one"
        )
