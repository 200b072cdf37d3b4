"""Numerical predictor-corrector: finds the bank that ends the flight at the target.

In each guidance cycle the onboard model is propagated to the end of guided flight. The bank
is a function of one number or of two. Newton's method corrects the numbers so that the
predicted flight ends at the range of the target and, with two numbers, at its altitude.
There is no reference to track.

Source: P. Lu, "Entry Guidance: A Unified Method", Journal of Guidance, Control, and
Dynamics 37(3), 2014, and the papers that it builds on. Beyond the paper: the derivative of
the prediction is exact, and so is the derivative of the flight.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from .._batching import where_due
from .._interpolation import clamp
from .._math import arccos, arcsin, safe_sqrt, sincos
from ..fields import Flag, Scalar, scalar
from ..motion.attitude import Swing
from ..motion.dynamics import AbstractDynamics, EntryDynamics, EquatorialDynamics
from ..motion.index import AbstractIndex, EnergyIndex
from ..motion.quantities import ground_track
from ..motion.state import Controls, EntryState
from ..onboard.estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    AbstractFactors,
    FactorEstimator,
    Factors,
)
from ..onboard.longitudinal import along_equator
from ..onboard.measurement import Measurement, measure
from ..onboard.model import OnboardModel, require_sphere, require_still_air
from ..onboard.profiles import AbstractProfile
from ..onboard.propagation import (
    Command,
    Prediction,
    SampledCommand,
    propagate,
    require_corrections,
)
from ..onboard.turning import BankTurning
from ..onboard.wind_estimation import WindEstimate, WindEstimator
from ..world.wind import StillAir
from .aim import Aim, TargetOfScenario, known as known_aim
from .bank_shapes import AbstractBankShape, ConstantBankShape, Numbers
from .bounded_step import least_squares_step, within_bounds
from .cycle import FixedCycle
from .glide_damping import GlideDamping
from .guided_end import GuidedEnd
from .lateral import (
    AbstractLateralLogic,
    Destination,
    PredictedCrossrange,
    PredictedPassage,
)
from .law import AbstractSampledLaw
from .path_limits import BankBounds, PathLimits
from .range_network import RangeNetwork


_FAR = 100.0
"""Miss, in units of `least_effect`, beyond which the first number takes its largest step if
the slope is too small to use"""


class _End(NamedTuple):
    """Whether a predicted flight has a valid end, and whether it skips out."""

    is_there: Flag
    skips: Flag
    """The flight goes too far, by an unknown distance"""


class Corrected(eqx.Module):
    """Decision at a guidance cycle."""

    numbers: Numbers
    """Numbers of the shape"""
    since: Scalar
    """Value of the index at the decision, from which the shape is counted"""
    side: Any
    """Decision of the lateral logic"""
    bounds: BankBounds
    """Bounds of the bank under which the path constraints hold"""
    estimate: AbstractFactorEstimate
    wind: WindEstimate | None
    """Wind estimate; None if the wind is not estimated"""
    decisions: Scalar
    """Number of corrections so far"""
    without_prediction: Scalar
    """Number of corrections that found no end and left the numbers unchanged"""


class PredictorCorrector(AbstractSampledLaw[tuple[()], Corrected]):
    """Commands the bank with which the onboard model ends at the range of the target.

    At the start of a cycle the sensed lift and drag are compared with those of the model
    at the actual angle of attack. With the resulting factors the rest of the flight is
    predicted from the measured state to the first end condition of `end`. A few safeguarded
    Newton steps, with the exact derivative of the prediction, correct the numbers of the
    bank shape. Each step is at most `largest_step` and stays within the bounds of the
    shape. If the target cannot be reached, a number ends at a bound. A prediction that
    skips out, or that is still flying after all its steps, counts as one that goes too far.
    A prediction that is not finite leaves the numbers unchanged.

    With `in_space=True` the range is predicted in three dimensions, also over a rotating
    planet, for a bank that does not change sign. The predicted downrange at the end must
    equal that of the target, both counted from the origin of the target. With
    `in_space=False` the range is predicted in the vertical plane, and the range to go is
    the arc to the target. This costs half as much. For a vehicle that turns far to the
    sides it is also the better estimate of the range with bank reversals. In the vertical
    plane only that component of the planet's rotation counts which is about the axis of
    the flown great circle.

    If `turning` models the time that the vehicle takes to turn its bank, the prediction
    includes it, and it includes the next reversal that the lateral logic expects. Without
    `turning` the prediction has no future reversal. During a reversal the lift passes
    through the upward direction. The bank before the reversal must compensate for this,
    since there may be no time to do so after the last reversal.

    The derivative of a flight has the following meaning. Two neighbouring flights have
    guidance cycles at the same times, and their steps are clipped in the same cycles. A
    saturated number has no derivative, as it should. Three things are discrete: bank
    reversals, the cycle at which the drag first exceeds `gate`, and the cycle at which
    `least_effect` is passed. A foreseen reversal takes effect at the next stage of an
    integration step, and the derivative is that between two stages: it includes the effect
    of the reversal time on the prediction, but not the shift of the reversal itself.
    """

    model: OnboardModel
    shape: AbstractBankShape
    end: GuidedEnd
    lateral: AbstractLateralLogic
    aim: Aim | TargetOfScenario = TargetOfScenario()
    """Where the law aims; a shape with two numbers also meets the altitude"""
    angle_of_attack: AbstractProfile | None = None
    """rad, over the index; None for the trim angle of attack of the vehicle, which is then
    assumed for the rest of the flight"""
    damping: GlideDamping | None = None
    """Damping of the phugoid, in the prediction and in flight; None for the bank of the
    shape alone"""
    limits: PathLimits | None = None
    """Limits of the bank that follow from the path constraints of the scenario"""
    turning: BankTurning | None = None
    """Model of how the vehicle turns its bank. The prediction then starts from the sensed
    bank and includes the next reversal that the lateral logic expects. None if commands
    take effect at once"""
    index: AbstractIndex = EnergyIndex()
    """Index of the shape and of the angle-of-attack profile"""
    estimator: AbstractFactorEstimator = eqx.field(default_factory=FactorEstimator)
    wind: WindEstimator | None = None
    """Estimator of the wind from the flow sensors of the scenario; None to assume the wind
    of the model. With an estimator, an estimated head wind does not enter the factors"""
    gate: Scalar = scalar(0.2, unit="m/s2", positive=True)
    """Sensed drag below which the numbers stay unchanged, since there is too little lift"""
    least_effect: Scalar = scalar(100.0, unit="m", positive=True)
    """Change of the range per unit of the first number, below which the numbers stay
    unchanged. Near the end the effect decreases and finally changes sign, since with more
    lift the flight ends sooner and higher"""
    altitude_weight: Scalar = scalar(0.1, positive=True)
    """Weight of the altitude error beside the range error, if both cannot be met"""
    largest_step: Scalar = scalar(0.3, positive=True)
    """Largest change of a number in one correction"""
    cycle: FixedCycle = FixedCycle(2.0)
    network: RangeNetwork | None = None
    """Network that replaces the prediction, for a constant bank. Where it has no answer,
    the number and the side stay unchanged. With a network of the vertical plane, the model
    still predicts for the lateral logic"""
    in_space: bool = eqx.field(default=True, static=True)
    """Whether the range is predicted in three dimensions, with the bank on its present side
    to the end, or in the vertical plane. Predictions for the lateral logic are always in
    three dimensions"""
    predicts_limits: bool = eqx.field(default=False, static=True)
    """Whether the limits also bound the bank in the prediction, at the start of each of its
    steps as in flight at each guidance cycle; `step` must equal the period. If False, the
    prediction has no limits, and where they are active the numbers are corrected for a
    bank that is not flown. True costs several times as much"""
    corrections: int = eqx.field(default=2, static=True)
    """Corrections in one guidance cycle; each needs a prediction"""
    step: float = eqx.field(default=3.0, static=True)
    """Step of a prediction, s"""
    steps: int = eqx.field(default=200, static=True)
    """Largest number of steps in a prediction"""

    def __check_init__(self):
        require_corrections(self.corrections, self.step, self.steps)
        if self.network is not None:
            self._check_network(self.network)
        if self.wind is not None and not self.in_space:
            raise ValueError(
                "wind is estimated and in_space is False: a prediction in the vertical "
                "plane knows no wind; take in_space=True, or leave wind at None"
            )
        if self.predicts_limits and self.limits is None:
            raise ValueError(
                "predicts_limits is True and limits is None: give the limits, such as "
                "PathLimits(), or leave it at False"
            )
        period = self.cycle.period
        if self.predicts_limits and period != self.step:
            raise ValueError(
                f"step is {self.step} s and the guidance cycle {period} s: limits "
                "that are foreseen bound the bank at the start of each step of the "
                "prediction, in flight at each cycle; give the same for both"
            )

    def _check_network(self, network: RangeNetwork) -> None:
        plain = isinstance(self.shape, ConstantBankShape)
        by_velocity = self.end.velocity is not None and self.end.energy is None
        plain = plain and self.angle_of_attack is None and self.damping is None
        plain = plain and self.turning is None and not self.predicts_limits
        if not (plain and by_velocity):
            raise ValueError(
                "a network takes the place of the prediction of a constant bank to a "
                "velocity, at the trim angle of attack and without damping, turning or "
                f"limits that are foreseen: shape is {type(self.shape).__name__}, "
                f"angle_of_attack is {self.angle_of_attack}, damping is {self.damping}, "
                f"turning is {self.turning}, predicts_limits is {self.predicts_limits}, "
                f"end is {self.end}"
            )
        if self.wind is not None:
            raise ValueError(
                "wind is estimated, and a network has learnt flights in still air: leave "
                "wind or network at None"
            )
        if network.in_space != self.in_space:
            learnt = "three dimensions" if network.in_space else "the vertical plane"
            raise ValueError(
                "a network takes the place of the prediction that it has learnt: this one "
                f"is of flights in {learnt}, and in_space is {self.in_space}"
            )
        if not network.in_space:
            if not self._at_rest:
                raise ValueError(
                    "a network tells the range over a planet at rest, and that of the "
                    "model turns: leave network at None"
                )
            return
        wind = self.model.planet.wind
        if not (self._at_rest and isinstance(wind, StillAir)):
            raise ValueError(
                "a network in three dimensions has learnt flights that are alike in every "
                "direction, over a planet at rest and in still air: the planet of the "
                f"model turns by {self.model.planet.rotation_rate} rad/s, with the wind "
                f"{type(wind).__name__}"
            )
        lateral = self.lateral
        if isinstance(lateral, PredictedCrossrange) and lateral.predicts_reversals:
            raise ValueError(
                "a network predicts where the flight ends and not when, and the lateral "
                "logic needs the time of the end for that of a reversal: take "
                "predicts_reversals=False"
            )

    @property
    def _at_rest(self) -> bool:
        turns = self.model.planet.rotation_rate
        known = eqx.is_array(turns) and not isinstance(turns, Tracer)
        return not known or bool(turns == 0.0)

    def init(self, measurement: Measurement) -> tuple[tuple[()], Corrected]:
        nothing = 0.0 * measurement.drag
        return (), Corrected(
            numbers=self.shape.numbers + nothing,
            since=self.index.value(self.model.planet, nothing, measurement.state),
            side=self.lateral.init(measurement),
            bounds=BankBounds(nothing - 1.0, nothing + 1.0),
            estimate=self.estimator.start(nothing),
            wind=None if self.wind is None else self.wind.start(nothing),
            decisions=nothing,
            without_prediction=nothing,
        )

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: Corrected,
    ) -> tuple[tuple[()], Corrected]:
        if self.wind is not None:
            learnt = self._seen(self.wind, measurement, held.wind)
            _, decided = self._in_wind(learnt).update(time, measurement, memory, held)
            return (), dataclasses.replace(decided, wind=learnt)
        state, planet, aim = measurement.state, self.model.planet, known_aim(self.aim)
        senses = measurement.drag > self.gate
        estimate = self._estimate(measurement, held.estimate, senses)
        sign, reverses_in = self._side(time, held)

        def correct(before: tuple[Numbers, Scalar]) -> tuple[Numbers, Scalar]:
            return self._correct(
                time, measurement, estimate.ahead, before[0], sign, reverses_in
            )

        before = held.numbers, jnp.zeros_like(held.decisions)
        numbers, lacks = where_due(senses, correct, before)

        def passage(sign: Scalar) -> PredictedPassage:
            def predict(unknown: PredictedPassage) -> PredictedPassage:
                if self.network is not None and self.in_space:
                    place, known = self._asked(
                        self.network, measurement, estimate.ahead, numbers, sign
                    )
                    lasts = jnp.full_like(sign, jnp.nan)
                else:
                    end = self.predicted(
                        time, measurement, estimate.ahead, numbers, sign, in_space=True
                    )
                    place, known, lasts = end.state, end.has_end, end.time
                _, reached = ground_track(planet, aim.origin, place)
                error = jnp.where(
                    known, reached - aim.crossrange, unknown.crossrange_error
                )
                return PredictedPassage(error, lasts)

            unknown = PredictedPassage(jnp.full_like(sign, jnp.nan), 0.0 * sign)
            return where_due(senses, predict, unknown)

        destination = Destination(
            planet, aim.origin, aim.downrange, aim.crossrange, passage
        )
        side = self.lateral.update(time, measurement, held.side, destination)
        since = self.index.value(planet, time, state)
        bounds = held.bounds
        if self.limits is not None:

            def banked(state: EntryState) -> Controls:
                here = self.index.value(planet, time, state)
                sign = self.lateral.sign(side)
                return self._banked(
                    self.model,
                    here,
                    since,
                    measurement,
                    numbers,
                    sign,
                    state,
                    factors,
                )

            factors = estimate.factors
            bounds = self.limits.bounds(self.model, measurement, factors, banked)
        return (), Corrected(
            numbers=numbers,
            since=since,
            side=side,
            bounds=jax.tree.map(
                lambda a, b: jnp.where(senses, a, b), bounds, held.bounds
            ),
            estimate=estimate,
            wind=held.wind,
            decisions=held.decisions + jnp.where(senses, 1.0, 0.0),
            without_prediction=held.without_prediction + lacks,
        )

    def __call__(
        self,
        time: Scalar,
        measurement: Measurement,
        memory: tuple[()],
        held: Corrected,
    ) -> tuple[Controls, tuple[()]]:
        if self.wind is not None:
            return self._in_wind(held.wind)(time, measurement, memory, held)
        state, factors = measurement.state, held.estimate.factors
        here = self.index.value(self.model.planet, time, state)
        sign, _ = self._side(time, held)
        wanted = self._banked(
            self.model,
            here,
            held.since,
            measurement,
            held.numbers,
            sign,
            state,
            factors,
        )
        if self.limits is None:
            return wanted, ()
        cosine = held.bounds.kept(wanted.cos_bank)
        return _banked_to(cosine, wanted.angle_of_attack, sign), ()

    def caveats(self, held: Corrected) -> dict[str, Scalar]:
        """Share of the corrections without a prediction, and caveats of the estimate."""
        share = held.without_prediction / jnp.maximum(held.decisions, 1.0)
        return {"decisions_without_prediction": share} | held.estimate.caveats()

    def predicted(
        self,
        time: Scalar,
        measurement: Measurement,
        factors: AbstractFactors,
        numbers: Numbers,
        sign: Scalar | float,
        in_space: bool,
        reverses_in: Scalar | float = math.inf,
    ) -> Prediction:
        """Rest of the flight as predicted with the onboard model, for given shape numbers.

        **Arguments:**

        - `sign`: sign of the bank; in the vertical plane it only matters for a bank that
          takes time to turn.
        - `in_space`: whether to predict in three dimensions, or in the vertical plane from
          longitude zero.
        - `reverses_in`: time to a reversal, for a bank that takes time to turn, s.
        """
        model, state = self.model, measurement.state
        now = self.index.value(model.planet, time, state)
        dynamics: AbstractDynamics = EntryDynamics()
        if not in_space:
            require_still_air(
                model.planet,
                "a prediction in the vertical plane",
                ", or take in_space=True",
            )
            model, state = along_equator(model, state)
            dynamics = EquatorialDynamics()
        planet = model.planet

        def banked(elapsed: Scalar, known: Factors, state: EntryState) -> Controls:
            here = self.index.value(planet, time + elapsed, state)
            return self._banked(
                model, here, now, measurement, numbers, sign, state, known
            )

        def flown(
            bounds: BankBounds | None, elapsed: Scalar, state: EntryState
        ) -> Controls:
            wanted = banked(elapsed, factors.at(state.altitude), state)
            if bounds is not None:
                cosine = bounds.kept(wanted.cos_bank)
                wanted = _banked_to(cosine, wanted.angle_of_attack, sign)
            if self.turning is None:
                return wanted
            bank = self.turning.flown(
                _sensed(measurement.bank),
                sign * _bank_of(wanted.cos_bank),
                elapsed,
                reverses_in,
            )
            return Controls.from_bank(bank, wanted.angle_of_attack)

        command = functools.partial(flown, None)
        if self.predicts_limits and self.limits is not None:
            limits = self.limits

            def within_limits(elapsed: Scalar, state: EntryState) -> Command:
                there = dataclasses.replace(measurement, state=state)
                known = factors.at(state.altitude)
                wish = functools.partial(banked, elapsed, known)
                bounds = limits.bounds(model, there, known, wish, dynamics)
                return functools.partial(flown, bounds)

            command = SampledCommand(within_limits)

        return propagate(
            model,
            state,
            command,
            self.end.margins(planet),
            step=self.step,
            steps=self.steps,
            factors=factors,
            dynamics=dynamics,
        )

    def _seen(
        self, wind: WindEstimator, measurement: Measurement, before: WindEstimate | None
    ) -> WindEstimate:
        if measurement.air_velocity is None:
            raise ValueError(
                "the PredictorCorrector estimates the wind, and no sensor measures the "
                "flow: give the scenario flow_sensors, such as FlowSensors(), or leave "
                "wind at None"
            )
        assert before is not None
        require_sphere(self.model.planet, "the estimation of the wind")
        mean, state = self.model.planet.wind, measurement.state
        return wind.update(before, mean, state, measurement.air_velocity)

    def _in_wind(self, learnt: WindEstimate | None) -> "PredictorCorrector":
        """The law with the estimated wind in its model."""
        assert self.wind is not None and learnt is not None
        planet = self.model.planet
        blows = dataclasses.replace(planet, wind=self.wind.wind(planet.wind, learnt))
        model = dataclasses.replace(self.model, planet=blows)
        return dataclasses.replace(self, model=model, wind=None)

    def range_to_go(self, state: EntryState) -> Scalar:
        """Arc to the target, m; negative if the target lies behind."""
        radius, aim = self.model.planet.radius, known_aim(self.aim)
        downrange, crossrange = ground_track(self.model.planet, aim.origin, state)
        # By half angles: the cosine of a small distance would lose it in rounding.
        along = sincos(0.5 * (aim.downrange - downrange) / radius)[0]
        across = sincos(0.5 * (aim.crossrange - crossrange) / radius)[0]
        _, here = sincos(crossrange / radius)
        _, there = sincos(aim.crossrange / radius)
        half = safe_sqrt(across * across + here * there * along * along)
        return jnp.where(along < 0.0, -2.0, 2.0) * radius * arcsin(half)

    def _side(
        self, time: Scalar, held: Corrected
    ) -> tuple[Scalar | float, Scalar | float]:
        """Sign of the bank at a time, and the time until it changes."""
        sign = self.lateral.sign(held.side)
        at = self.lateral.reverses_at(held.side)
        if isinstance(at, float):
            return sign, at
        done = time >= at
        return jnp.where(done, -sign, sign), jnp.where(done, jnp.inf, at - time)

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

    def _correct(
        self,
        time: Scalar,
        measurement: Measurement,
        factors: AbstractFactors,
        numbers: Numbers,
        sign: Scalar | float,
        reverses_in: Scalar | float,
    ) -> tuple[Numbers, Scalar]:
        """Numbers after the corrections of a cycle, and 1 if the last prediction had no
        result, else 0."""
        planet, shape, most = self.model.planet, self.shape, self.largest_step
        aim = known_aim(self.aim)
        to_go = self.range_to_go(measurement.state)
        least, largest = (
            jnp.array(bounds) for bounds in zip(*shape.bounds, strict=True)
        )

        def too_far(place: EntryState) -> Scalar:
            if not self.in_space:
                return planet.radius * place.longitude - to_go
            reached, _ = ground_track(planet, aim.origin, place)
            return reached - aim.downrange

        def missed(numbers: Numbers) -> tuple[Numbers, _End]:
            if self.network is not None:
                place, known = self._asked(
                    self.network, measurement, factors, numbers, sign
                )
                skips = jnp.zeros_like(known)
                return jnp.stack([too_far(place)]), _End(known, skips)
            end = self.predicted(
                time, measurement, factors, numbers, sign, self.in_space, reverses_in
            )
            high = self.model.planet.geodetic_altitude(
                end.state.altitude, end.state.latitude
            )
            high = high - aim.altitude
            both = too_far(end.state), self.altitude_weight * high
            goes_on = end.time > (self.steps - 1) * self.step
            skips = self.end.is_skip(end.ended_by)
            is_there = end.has_end & jnp.logical_not(skips)
            skips = skips | (jnp.logical_not(end.has_end) & goes_on)
            return jnp.stack(both[: numbers.shape[0]]), _End(is_there, skips)

        def improve(carry, _):
            numbers, _ = carry
            misses, effects, end = _with_effects(
                missed, numbers, in_turn=self.predicts_limits
            )
            missed_by, effect = misses[0], effects[0, 0]
            ends, skips = end
            # On both sides of the `where`, so that the unused branch has no derivative.
            tells = ends & (effect > self.least_effect)
            best = least_squares_step(
                jnp.where(tells, misses, 0.0),
                jnp.where(tells, effects, jnp.eye(numbers.shape[0])),
                jnp.maximum(least - numbers, -most),
                jnp.minimum(largest - numbers, most),
            )
            far = skips | (jnp.abs(missed_by) > _FAR * self.least_effect)
            blind = jnp.where(skips | (missed_by > 0.0), -most, most)
            blind = jnp.where(far, blind, 0.0) * jnp.eye(numbers.shape[0])[0]
            known = (ends | skips) & jnp.all(jnp.isfinite(misses))
            step = jnp.where(known, jnp.where(tells, best, blind), 0.0)
            numbers = within_bounds(numbers + step, least, largest)
            return (numbers, jnp.where(known, 0.0, 1.0)), None

        carry = numbers, jnp.zeros_like(to_go)
        return jax.lax.scan(improve, carry, length=self.corrections)[0]

    def _asked(
        self,
        network: RangeNetwork,
        measurement: Measurement,
        factors: AbstractFactors,
        numbers: Numbers,
        sign: Scalar | float,
    ) -> tuple[EntryState, Flag]:
        """End of the flight by the network, and whether the network has an answer."""
        state, angle = measurement.state, measurement.trim_angle_of_attack
        # Number of a shape whose largest bank is half a turn, as the network was trained.
        nothing = jnp.zeros_like(numbers[0])
        number = 0.5 * (1.0 + self.shape.cos_bank(numbers, nothing, nothing))
        known, end = factors.at(state.altitude), self.end.first()
        found = network(self.model, state, angle, known, number, end)
        return network.place(self.model.planet, state, found, sign), found.knows

    def _banked(
        self,
        model: OnboardModel,
        here: Scalar,
        since: Scalar,
        measurement: Measurement,
        numbers: Numbers,
        sign: Scalar | float,
        state: EntryState,
        factors: Factors,
    ) -> Controls:
        angle = measurement.trim_angle_of_attack
        if self.angle_of_attack is not None:
            angle = self.angle_of_attack(here)
        cosine = self.shape.cos_bank(numbers, here, since)
        if self.damping is not None:
            cosine = self.damping.cos_bank(model, factors, state, angle, cosine)
        return _banked_to(cosine, angle, sign)


_INSIDE = 1.0 - 1e-6
"""Cosine of 0.08 degrees. Beyond it the derivative of the angle is held at its value there,
since that of the arccosine grows without bound"""


def _bank_of(cosine: Scalar) -> Scalar:
    """Magnitude of the bank, rad. It has a derivative also at a cosine of 1, such that
    cos(bank) has the derivative 1. Otherwise a number at its bound would stay there."""
    inside = clamp(cosine, -_INSIDE, _INSIDE)
    return arccos(cosine + lax.stop_gradient(inside - cosine))


def _sensed(bank: Swing | None) -> Swing:
    if bank is None:
        raise ValueError(
            "the vehicle flies its commands at once, and the PredictorCorrector has a "
            "turning: leave it at None, or give the scenario an attitude that takes its "
            "time"
        )
    return bank


def _banked_to(cosine: Scalar, angle: Scalar, sign: Scalar | float) -> Controls:
    return Controls(angle, cosine, sign * safe_sqrt(1.0 - cosine * cosine))


def _with_effects(
    missed: Callable[[Numbers], tuple[Numbers, _End]],
    numbers: Numbers,
    in_turn: bool,
) -> tuple[Numbers, Float[Array, "numbers numbers"], _End]:
    """The misses, and how each number (columns) changes them.

    The motion is propagated once for all the numbers, or with `in_turn` once for each. A
    computation that is long beside the equations of motion would otherwise be repeated
    with each operation on the derivatives.
    """

    def along(direction: Numbers) -> tuple[Numbers, Numbers, _End]:
        return jax.jvp(missed, (numbers,), (direction,), has_aux=True)

    every = jnp.eye(numbers.shape[0])
    if numbers.shape[0] == 1:
        misses, effects, end = along(every[0])
        return misses, effects[:, None], end
    if not in_turn:
        return jax.vmap(along, out_axes=(None, 1, None))(every)
    misses, effects, end = lax.map(along, every)
    return misses[0], effects.T, jax.tree.map(lambda x: x[0], end)
