"""Numerical predictor-corrector: the bank with which the rest of the flight ends there.

In each guidance cycle the onboard model is flown to the end under a bank that is a function
of one number, and Newton's method corrects the number so that it ends at the range of the
target. There is no reference to track.

After P. Lu, "Entry Guidance: A Unified Method", Journal of Guidance, Control, and Dynamics
37(3), 2014, and what it stands on. What is our own: the derivative of the prediction is
exact, and so the derivative of the flight.
"""

import math
from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from .._batching import where_due
from .._interpolation import clamp
from .._math import safe_sqrt, sincos
from ..fields import Count, Flag, Scalar, optional_scalar, scalar
from ..motion.dynamics import AbstractDynamics, EntryDynamics
from ..motion.index import AbstractIndex, EnergyIndex
from ..motion.quantities import energy, ground_track
from ..motion.state import Controls, EntryState
from ..onboard.estimation import (
    AbstractFactorEstimate,
    AbstractFactorEstimator,
    AbstractFactors,
    FactorEstimator,
)
from ..onboard.longitudinal import LongitudinalState
from ..onboard.model import OnboardModel
from ..onboard.navigation import Measurement, measure
from ..onboard.profiles import AbstractProfile
from ..onboard.propagation import Margin, Prediction, propagate
from ..units import degree
from ..world.planet import Planet
from .cycle import FixedCycle
from .lateral import AbstractLateralLogic, Destination
from .law import AbstractSampledLaw


class AbstractBankShape(eqx.Module):
    """The bank over the rest of the flight, told by one number.

    The number is such that more of it flies farther: it is corrected between `least` and
    `most`, and so always is a bank. What the number cannot reach it saturates at.
    """

    first: eqx.AbstractVar[Scalar]
    """The number at the start, before there is anything to predict with"""
    least: eqx.AbstractVar[float]
    most: eqx.AbstractVar[float]

    @abstractmethod
    def cos_bank(self, number: Scalar, index: Scalar, since: Scalar) -> Scalar:
        """Cosine of the bank at a value of the index of the law, from -1 to 1.

        **Arguments:**

        - `number`: as it is corrected.
        - `index`: there.
        - `since`: its value at the decision.
        """


class ConstantBank(AbstractBankShape):
    """One bank for the rest of the flight; the number is its cosine. For capsules."""

    first: Scalar = scalar(0.5)
    least: float = eqx.field(default=-1.0, static=True)
    most: float = eqx.field(default=1.0, static=True)

    def __check_init__(self):
        if not -1.0 <= self.least < self.most <= 1.0:
            raise ValueError(
                f"the cosine of the bank is to be from {self.least} to {self.most}: "
                "these must be increasing, and from -1 to 1"
            )

    def cos_bank(self, number: Scalar, index: Scalar, since: Scalar) -> Scalar:
        return number


class LinearBank(AbstractBankShape):
    """A bank that goes linearly over the index to a given one at the end. For gliders.

    The number is the bank now, as share of the way from `largest`, where it is 0, to wings
    level, where it is 1.
    """

    final: Scalar = scalar(unit="rad")
    """Magnitude of the bank at the end"""
    end: Scalar = scalar()
    """Value of the index at the end"""
    first: Scalar = scalar(0.5)
    largest: Scalar = scalar(90.0 * degree, unit="rad", positive=True)
    """Magnitude of the bank now at which the number is zero"""
    least: float = eqx.field(default=0.0, static=True)
    most: float = eqx.field(default=1.0, static=True)

    def cos_bank(self, number: Scalar, index: Scalar, since: Scalar) -> Scalar:
        left = self.end - since
        there = left != 0.0
        way = (index - since) / jnp.where(there, left, 1.0)
        way = jnp.where(there, clamp(way, 0.0, 1.0), 1.0)
        start = self.largest * (1.0 - number)
        return sincos(start + way * (self.final - start))[1]


class ShapedBank(AbstractBankShape):
    """The cosine of a given bank, moved towards wings level or towards the largest bank.

    With the number 0 it is as given, with 1 the wings are level all the way, with -1 the
    bank is the largest, and the cosine is linear in between. A bank that was planned will
    do, of which nothing else is tracked.
    """

    shape: AbstractProfile
    """Cosine of the bank over the index of the law"""
    lowest: Scalar = scalar(-1.0, range=(-1.0, 1.0))
    """Cosine of the largest bank"""
    first: Scalar = scalar(0.0)
    least: float = eqx.field(default=-1.0, static=True)
    most: float = eqx.field(default=1.0, static=True)

    def cos_bank(self, number: Scalar, index: Scalar, since: Scalar) -> Scalar:
        cosine = clamp(self.shape(index), self.lowest, 1.0)
        room = jnp.where(number > 0.0, 1.0 - cosine, cosine - self.lowest)
        return cosine + number * room


class GuidedEnd(eqx.Module):
    """Where guided flight ends, as the law believes it: at the first that is given.

    The ground ends a flight as well. A flight that has risen to the ceiling has skipped
    out, and would come down too far away.
    """

    velocity: Scalar | None = optional_scalar(unit="m/s")
    altitude: Scalar | None = optional_scalar(unit="m")
    energy: Scalar | None = optional_scalar(unit="J/kg")
    ceiling: Scalar | None = optional_scalar(unit="m")

    def __check_init__(self):
        if self.velocity is None and self.altitude is None and self.energy is None:
            raise ValueError(
                "GuidedEnd has no velocity, no altitude and no energy: give what ends "
                "guided flight"
            )

    def margins(self, planet: Planet) -> tuple[Margin, ...]:
        """The ends of a prediction; with a ceiling it is the last one."""
        found: list[Margin] = []
        if self.velocity is not None:
            found.append(lambda state: state.velocity - self.velocity)
        if self.altitude is not None:
            found.append(lambda state: state.altitude - self.altitude)
        else:
            found.append(lambda state: state.altitude)
        if self.energy is not None:
            found.append(lambda state: energy(planet, state) - self.energy)
        if self.ceiling is not None:
            found.append(lambda state: self.ceiling - state.altitude)
        return tuple(found)

    def is_skip(self, ended_by: Count) -> Flag:
        """Whether a prediction ended at the ceiling."""
        if self.ceiling is None:
            return jnp.zeros_like(ended_by, dtype=bool)
        given = self.velocity is not None, True, self.energy is not None
        return ended_by == sum(given)


class Corrected(eqx.Module):
    """What is decided at a guidance cycle."""

    number: Scalar
    """That of the shape"""
    since: Scalar
    """Value of the index at the decision, from which the shape is counted"""
    side: object
    """What the lateral logic decided"""
    estimate: AbstractFactorEstimate
    decisions: Scalar
    """How many corrections there have been"""
    without_prediction: Scalar
    """How many of them found no end, and left the number as it was"""


class PredictorCorrector(AbstractSampledLaw[tuple[()], Corrected]):
    """Flies the bank with which the onboard model ends at the range of the target.

    At the start of a cycle the sensed lift and drag are compared with those of the model,
    at the angle of attack that is flown. Under these factors the rest of the flight is
    predicted to the first of the ends that guided flight has, from the measured state. A
    few safeguarded Newton steps, with the exact derivative of the prediction, correct the
    number of the bank's shape. Each goes at most `largest_step`, in the direction in which
    the miss tells it to go even where the slope does not, and stays within the bounds of
    the shape. A prediction that skips out is one that goes too far. One that does not end,
    or is not finite, leaves the number as it is.

    The range is counted from `origin`, as in `ground_track`. In three dimensions
    (`EntryDynamics`) the prediction keeps the side of the bank, over a rotating planet as
    well; with `EquatorialDynamics` it is one in the vertical plane, at half of the price.

    What the derivative of a flight means: between two flights that are near each other
    guidance cycles come at the same times, and steps are clipped or not in the same
    cycles. Where a number saturates it has no derivative, as it should. Reversals of the
    bank and the cycle at which `gate` or `last` is passed are discrete: see `Smooth`.
    """

    model: OnboardModel
    shape: AbstractBankShape
    end: GuidedEnd
    origin: EntryState
    """Where downrange and crossrange are counted from"""
    downrange: Scalar = scalar(unit="m")
    """Of the target"""
    crossrange: Scalar = scalar(unit="m")
    """Of the target, positive to the left"""
    lateral: AbstractLateralLogic
    angle_of_attack: AbstractProfile | None = None
    """rad, over the index; None for the angle of attack at which the vehicle trims, which
    is then taken for the rest of the flight too"""
    index: AbstractIndex = EnergyIndex()
    """Of the shape and of the angle of attack"""
    dynamics: AbstractDynamics = EntryDynamics()
    """Of the prediction"""
    estimator: AbstractFactorEstimator = eqx.field(default_factory=FactorEstimator)
    gate: Scalar = scalar(0.2, unit="m/s2", positive=True)
    """Sensed drag below which the number stays: there is nothing to steer by"""
    least_effect: Scalar = scalar(100.0, unit="m", positive=True)
    """Change of the range for one of the number, below which the number stays. Towards the
    end it can do less and less, and then the opposite: more lift ends sooner, higher"""
    largest_step: Scalar = scalar(0.3, positive=True)
    """Of the number, in one correction"""
    cycle: FixedCycle = FixedCycle(2.0)
    corrections: int = eqx.field(default=2, static=True)
    """In one guidance cycle; each is a prediction"""
    step: float = eqx.field(default=3.0, static=True)
    """Of a prediction, s"""
    steps: int = eqx.field(default=200, static=True)
    """At most, in a prediction"""

    def __check_init__(self):
        if self.corrections < 1:
            raise ValueError(f"corrections is {self.corrections}: it must be 1 or more")
        if not 0.0 < self.step < math.inf or self.steps < 1:
            raise ValueError(
                f"a prediction has {self.steps} steps of {self.step} s: both must be "
                "positive"
            )
        turns = self.model.planet.rotation_rate
        at_rest = isinstance(turns, Tracer) or not eqx.is_array(turns) or turns == 0.0
        if not self.dynamics.has_crossrange and not at_rest:
            raise ValueError(
                f"dynamics is {type(self.dynamics).__name__} and the planet turns: a "
                "prediction in the vertical plane is one over a planet at rest; take "
                "dynamics=EntryDynamics()"
            )

    def init(self, measurement: Measurement) -> tuple[tuple[()], Corrected]:
        nothing = 0.0 * measurement.drag
        number = self.shape.first + nothing
        return (), Corrected(
            number=number,
            since=self.index.value(self.model.planet, nothing, measurement.state),
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
        held: Corrected,
    ) -> tuple[tuple[()], Corrected]:
        state, planet = measurement.state, self.model.planet
        senses = measurement.drag > self.gate
        estimate = self._estimate(measurement, held.estimate, senses)
        sign = self.lateral.sign(held.side)

        def correct(before: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            return self._correct(time, measurement, estimate.ahead, before[0], sign)

        before = held.number, jnp.zeros_like(held.number)
        number, lacks = where_due(senses, correct, before)

        def crossrange_at_end(sign: Scalar) -> Scalar:
            end = self.predicted(time, measurement, estimate.ahead, number, sign)
            _, reached = ground_track(planet, self.origin, end.state)
            return jnp.where(end.has_end, reached - self.crossrange, jnp.nan)

        destination = Destination(
            planet,
            self.origin,
            self.downrange,
            self.crossrange,
            crossrange_at_end if self.dynamics.has_crossrange else None,
        )
        side = self.lateral.update(time, measurement, held.side, destination)
        return (), Corrected(
            number=number,
            since=self.index.value(planet, time, state),
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
        held: Corrected,
    ) -> tuple[Controls, tuple[()]]:
        here = self.index.value(self.model.planet, time, measurement.state)
        sign = self.lateral.sign(held.side)
        return self._banked(here, held.since, measurement, held.number, sign), ()

    def caveats(self, held: Corrected) -> dict[str, Scalar]:
        """Share of the corrections without a prediction, and those of the estimate."""
        share = held.without_prediction / jnp.maximum(held.decisions, 1.0)
        return {"decisions_without_prediction": share} | held.estimate.caveats()

    def predicted(
        self,
        time: Scalar,
        measurement: Measurement,
        factors: AbstractFactors,
        number: Scalar,
        sign: Scalar | float,
    ) -> Prediction:
        """The rest of the flight as the model flies it, with a number of the shape.

        **Arguments:**

        - `sign`: of the bank; without meaning in the vertical plane.
        """
        planet, state = self.model.planet, measurement.state
        now = self.index.value(planet, time, state)
        if not self.dynamics.has_crossrange:
            state = LongitudinalState.of(planet, state).eastward()

        def command(elapsed: Scalar, state: EntryState) -> Controls:
            here = self.index.value(planet, time + elapsed, state)
            return self._banked(here, now, measurement, number, sign)

        return propagate(
            self.model,
            state,
            command,
            self.end.margins(planet),
            step=self.step,
            steps=self.steps,
            factors=factors,
            dynamics=self.dynamics,
        )

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
        number: Scalar,
        sign: Scalar | float,
    ) -> tuple[Scalar, Scalar]:
        """The number after the corrections of a cycle, and 1 if the last prediction told
        nothing, else 0."""
        planet = self.model.planet
        downrange, _ = ground_track(planet, self.origin, measurement.state)
        most = self.largest_step

        def too_far(number: Scalar) -> tuple[Scalar, Prediction]:
            end = self.predicted(time, measurement, factors, number, sign)
            if self.dynamics.has_crossrange:
                flown, _ = ground_track(planet, self.origin, end.state)
            else:
                flown = downrange + planet.radius * end.state.longitude
            return flown - self.downrange, end

        def improve(carry, _):
            number, _ = carry
            one = jnp.ones_like(number)
            miss, slope, end = jax.jvp(too_far, (number,), (one,), has_aux=True)
            ends = end.has_end & jnp.logical_not(self.end.is_skip(end.ended_by))
            goes_on = end.time > (self.steps - 1) * self.step
            skips = self.end.is_skip(end.ended_by) | (~end.has_end & goes_on)
            # On both sides of the `where`, so that no derivative comes from there.
            tells = ends & (slope > self.least_effect)
            newton = -jnp.where(tells, miss, 0.0) / jnp.where(tells, slope, 1.0)
            blind = jnp.where(skips | (miss > 0.0), -most, most)
            blind = jnp.where(skips | (jnp.abs(miss) > self.least_effect), blind, 0.0)
            step = jnp.where(tells, clamp(newton, -most, most), blind)
            known = (ends | skips) & jnp.isfinite(miss)
            step = jnp.where(known, step, 0.0)
            number = clamp(number + step, self.shape.least, self.shape.most)
            return (number, jnp.where(known, 0.0, one)), None

        carry = number, jnp.zeros_like(number)
        return jax.lax.scan(improve, carry, length=self.corrections)[0]

    def _banked(
        self,
        here: Scalar,
        since: Scalar,
        measurement: Measurement,
        number: Scalar,
        sign: Scalar | float,
    ) -> Controls:
        angle = measurement.trim_angle_of_attack
        if self.angle_of_attack is not None:
            angle = self.angle_of_attack(here)
        cosine = self.shape.cos_bank(number, here, since)
        sine = sign * safe_sqrt(1.0 - cosine * cosine)
        return Controls(angle, cosine, sine)
