"""Lateral logic: the side of the bank, and the times of bank reversals."""

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer

from .._math import sincos
from ..fields import NOT_NEGATIVE, QUARTER, Scalar, Vector, scalar, table
from ..motion.quantities import arc_to, direction_to, ground_track
from ..motion.state import Controls, EntryState
from ..onboard.measurement import Measurement
from ..world.planet import Planet
from .switching import AbstractSwitching, Sharp


Side = TypeVar("Side")


class PredictedPassage(eqx.Module):
    """Predicted crossrange error and time at the end, as computed by a law."""

    crossrange_error: Scalar
    """Crossrange error at the end, m; NaN if there is no prediction"""
    time: Scalar
    """Time from now to the end, s; NaN if unknown"""


class Destination(eqx.Module):
    """The point on the ground that a law steers to, in the onboard model."""

    planet: Planet
    origin: EntryState
    """Origin from which downrange and crossrange are counted, as in `ground_track`"""
    downrange: Scalar
    """m"""
    crossrange: Scalar
    """m, positive to the left"""
    predicted: Callable[[Scalar], PredictedPassage] | None = None
    """Prediction for a sign of the bank from now on; None if the law does not predict the
    crossrange"""


class AbstractLateralLogic(eqx.Module, Generic[Side]):
    """Selects the side to which a law banks; every law that commands the bank has one.

    It decides at the start of a guidance cycle. Its memory, called the side, is a pytree
    of numbers that is held until the next decision. It is separate from what the law
    tracks. A logic whose side is None decides nothing and needs no guidance cycle.
    """

    @abstractmethod
    def init(self, measurement: Measurement) -> Side:
        """The side at the start of guidance, before the first decision."""

    @abstractmethod
    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: Side,
        destination: Destination | None,
    ) -> Side:
        """Decision at the start of a guidance cycle.

        **Arguments:**

        - `time`: s since the start.
        - `side`: the previous decision.
        - `destination`: point that the law steers to; None if it has no such point.
        """

    @abstractmethod
    def sign(self, side: Side) -> Scalar | float:
        """1 if the bank is to the right, -1 if it is to the left."""

    def reverses_at(self, side: Side) -> Scalar | float:
        """Time of the next expected reversal, s since the start.

        Infinite if no reversal is expected, or if the logic does not look ahead. A law that
        uses this time, such as `PredictorCorrector`, reverses the bank at it, also within
        a guidance cycle. The logic counts the reversal as done at the next decision.
        """
        return math.inf


class FixedSide(AbstractLateralLogic[None]):
    """Banks to one side for the whole flight: to the right by default."""

    to_the_left: bool = eqx.field(default=False, static=True)

    def init(self, measurement: Measurement) -> None:
        return None

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: None,
        destination: Destination | None,
    ) -> None:
        return None

    def sign(self, side: None) -> float:
        return -1.0 if self.to_the_left else 1.0


class AbstractCorridor(AbstractLateralLogic[Scalar]):
    """Reverses the bank at the limits of a corridor; the side is the sign of the bank."""

    first_sign: eqx.AbstractVar[Scalar]
    """Sign of the bank at the start: 1 to the right, -1 to the left"""
    switching: eqx.AbstractVar[AbstractSwitching]
    """Switching of the sign at a limit"""

    def __check_init__(self):
        _check_sign(self.first_sign)

    def init(self, measurement: Measurement) -> Scalar:
        return self.first_sign + 0.0 * measurement.drag

    def sign(self, side: Scalar) -> Scalar:
        return side


class CrossrangeCorridor(AbstractCorridor):
    """Reverses the bank if the predicted crossrange error at the destination is too large.

    The crossrange is predicted along the present great circle. The corridor is
    |crossrange error| <= floor + widening V^2, within which the bank is not reversed. It
    narrows along the flight as the remaining crossrange capability does, so that the
    reversals spread over the flight. A wide corridor gives few reversals; a low floor gives
    a small final error.
    """

    floor: Scalar = scalar(unit="m", positive=True)
    widening: Scalar = scalar(0.0, unit="s2/m", range=NOT_NEGATIVE)
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""
    switching: AbstractSwitching = Sharp()

    def half_width(self, velocity: Scalar) -> Scalar:
        """Half width of the corridor, m."""
        return self.floor + self.widening * velocity * velocity

    def narrowed(self, factor: Scalar) -> "CrossrangeCorridor":
        """The corridor with its width times a factor."""
        return dataclasses.replace(
            self, floor=factor * self.floor, widening=factor * self.widening
        )

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: Scalar,
        destination: Destination | None,
    ) -> Scalar:
        if destination is None:
            raise ValueError(
                "a CrossrangeCorridor is about the destination of its law, and this law "
                "has none: take a HeadingCorridor, which has a target of its own"
            )
        planet, origin, state = (
            destination.planet,
            destination.origin,
            measurement.state,
        )
        downrange, _ = ground_track(planet, origin, state)
        to_go = destination.downrange - downrange
        passing = predicted_crossrange(planet, origin, state, to_go)
        half_width = self.half_width(state.velocity)
        miss = passing - destination.crossrange
        return reverse_bank(side, miss, half_width, self.switching)


class HeadingCorridor(AbstractCorridor):
    """Reverses the bank when the heading error to a target is too large.

    The bank is not reversed up to a half width, which is a piecewise linear function of the
    velocity, constant beyond its ends. Two points make it a straight line.
    """

    longitude: Scalar = scalar(unit="rad")
    """Longitude of the target"""
    latitude: Scalar = scalar(unit="rad", range=QUARTER)
    """Latitude of the target"""
    radius: Scalar = scalar(unit="m", positive=True)
    """Radius of the planet. Only a smooth switching needs it: it distributes a reversal
    over the distance by which the target would be missed"""
    velocities: Vector = table(unit="m/s", positive=True, increasing=True)
    half_widths: Vector = table(unit="rad", positive=True)
    """Half widths of the corridor at the velocities"""
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""
    switching: AbstractSwitching = Sharp()

    def __check_init__(self):
        shapes = jnp.shape(self.velocities), jnp.shape(self.half_widths)
        if shapes[0] != shapes[1] or len(shapes[0]) != 1 or shapes[0][0] == 0:
            raise ValueError(
                f"velocities and half_widths have the shapes {shapes[0]} and {shapes[1]}: "
                "they must be two lists of one length"
            )

    def half_width(self, velocity: Scalar) -> Scalar:
        """Half width of the corridor, rad."""
        return jnp.interp(velocity, self.velocities, self.half_widths)

    def heading_error(self, state: EntryState) -> Scalar:
        """Bearing of the target minus the heading, rad in [-pi, pi].

        Positive if the target is to the right.
        """
        ahead, right, _ = direction_to(self.longitude, self.latitude, state)
        return jnp.arctan2(right, ahead)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: Scalar,
        destination: Destination | None,
    ) -> Scalar:
        state = measurement.state
        ahead, right, up = direction_to(self.longitude, self.latitude, state)
        distance = self.radius * arc_to(ahead, right, up)
        # As a length, in which smooth switching measures how far a limit is exceeded.
        miss = jnp.arctan2(right, ahead) * distance
        half_width = self.half_width(state.velocity) * distance
        return reverse_bank(side, miss, half_width, self.switching)


class CountedSide(eqx.Module):
    """The side, and the number of its changes."""

    sign: Scalar
    """1 to the right, -1 to the left"""
    reversals: Scalar
    reverses_at: Scalar | None = None
    """Time of the next expected reversal, s; infinite for none"""


class PredictedCrossrange(AbstractLateralLogic[CountedSide]):
    """Reverses the bank when this is predicted to reduce the crossrange error by a factor.

    In each guidance cycle the law predicts the crossrange error at the end for a bank
    without reversal and for a bank that is reversed now. The bank is reversed if the second
    error is smaller by `factor`. A reversal leaves at most that share of the error to the
    next one: few are needed, and the last ones come late. Their number is limited.

    Let e be the error without a reversal and e_r that of a reversal now. A reversal after a
    time t of the time T to the end leads to the error

        e + (e_r - e) (1 - t / T)^2

    under a constant lateral acceleration. With `predicts_reversals` the logic computes
    from this the time of the next reversal, for a law that predicts the effect of the
    reversal on the range and that reverses the bank within a guidance cycle.

    Source: K. M. Smith, "Predictive Lateral Logic for Numerical Entry Guidance Algorithms",
    AAS/AIAA Space Flight Mechanics Meeting, 2016. The law must predict in three dimensions.
    """

    factor: Scalar = scalar(3.0, range=(1.0, math.inf))
    """Factor by which the error of the reversed bank must be smaller"""
    tolerance: Scalar = scalar(0.0, unit="m", range=NOT_NEGATIVE)
    """Error below which the bank is not reversed"""
    most: Scalar = scalar(6.0, range=NOT_NEGATIVE)
    """Largest number of reversals"""
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""
    predicts_reversals: bool = eqx.field(default=False, static=True)
    """Whether the time of the next reversal is computed"""

    def __check_init__(self):
        _check_sign(self.first_sign)

    def init(self, measurement: Measurement) -> CountedSide:
        nothing = 0.0 * measurement.drag
        never = nothing + jnp.inf if self.predicts_reversals else None
        return CountedSide(self.first_sign + nothing, nothing, never)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: CountedSide,
        destination: Destination | None,
    ) -> CountedSide:
        if destination is None or destination.predicted is None:
            raise ValueError(
                "PredictedCrossrange needs a law that predicts its crossrange, such as a "
                "PredictorCorrector: with this law take a CrossrangeCorridor"
            )
        if side.reverses_at is not None:
            done = time >= side.reverses_at
            side = CountedSide(
                jnp.where(done, -side.sign, side.sign),
                side.reversals + jnp.where(done, 1.0, 0.0),
            )
        # A loop: two copies of the prediction would nearly double what is compiled.
        sides = jnp.stack([side.sign, -side.sign])
        passages = lax.map(destination.predicted, sides)
        kept, reversed_now = passages.crossrange_error
        # NaN compares as not smaller.
        better = self.factor * jnp.abs(reversed_now) < jnp.abs(kept)
        turns = better & (jnp.abs(kept) > self.tolerance)
        turns &= side.reversals < self.most
        reversals = side.reversals + jnp.where(turns, 1.0, 0.0)
        sign = jnp.where(turns, -side.sign, side.sign)
        if not self.predicts_reversals:
            return CountedSide(sign, reversals)
        after = jnp.where(turns, reversed_now, kept)
        other = jnp.where(turns, kept, reversed_now)
        comes_in = self._expected(after, other, passages.time[0], reversals)
        return CountedSide(sign, reversals, time + comes_in)

    def sign(self, side: CountedSide) -> Scalar:
        return side.sign

    def reverses_at(self, side: CountedSide) -> Scalar | float:
        return math.inf if side.reverses_at is None else side.reverses_at

    def _expected(
        self, kept: Scalar, reversed_now: Scalar, time: Scalar, reversals: Scalar
    ) -> Scalar:
        """Time until a reversal leads to an error of opposite sign that is smaller by
        `factor`, s; infinite if this does not occur."""
        change = kept - reversed_now
        moves = change != 0.0
        square = (1.0 + 1.0 / self.factor) * kept / jnp.where(moves, change, 1.0)
        comes = moves & (square > 0.0) & (square <= 1.0)
        comes &= (jnp.abs(kept) > self.tolerance) & (reversals < self.most)
        # On both sides of the `where`, so that no derivative comes from there.
        root = jnp.sqrt(jnp.where(comes, square, 1.0))
        return jnp.where(comes, time * (1.0 - root), jnp.inf)


class Reversals(eqx.Module):
    """Memory of reversals at prescribed velocities."""

    sign: Scalar
    """Side of the bank: 1 to the right, -1 to the left"""
    stages: Vector
    """State of each reversal: `_WAITING`, `_AHEAD` or `_DONE`"""


_WAITING, _AHEAD, _DONE = 0.0, 1.0, 2.0
"""The velocity has not yet been above that of the reversal; has been above; has fallen to
it"""


class VelocityReversals(AbstractLateralLogic[Reversals]):
    """Reverses the bank each time the velocity falls to one of the prescribed values.

    Each value counts once, in the first guidance cycle that begins at or below it, and only
    if the velocity has been above it before. So neither an entry whose velocity increases
    at first nor one that begins below some of the values has too many reversals. Two values
    that are passed within one cycle are two reversals, which leave the side unchanged.
    """

    velocities: Vector = table(unit="m/s", positive=True)
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""

    def __check_init__(self):
        _check_sign(self.first_sign)
        if jnp.ndim(self.velocities) != 1:
            raise ValueError(
                f"velocities have the shape {jnp.shape(self.velocities)}: they must be "
                "a list"
            )
        if isinstance(self.velocities, Tracer):
            return
        values, counts = np.unique(np.asarray(self.velocities), return_counts=True)
        if np.any(counts > 1):
            raise ValueError(
                f"velocities have {values[np.argmax(counts)]:g} m/s more than once: two "
                "reversals at the same velocity are none"
            )

    def init(self, measurement: Measurement) -> Reversals:
        above = measurement.state.velocity > self.velocities
        return Reversals(
            self.first_sign + 0.0 * measurement.drag, jnp.where(above, _AHEAD, _WAITING)
        )

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: Reversals,
        destination: Destination | None,
    ) -> Reversals:
        above = measurement.state.velocity > self.velocities
        passed = (side.stages == _AHEAD) & jnp.logical_not(above)
        begins = (side.stages == _WAITING) & above
        stages = jnp.where(begins, _AHEAD, jnp.where(passed, _DONE, side.stages))
        odd = jnp.sum(passed) % 2 == 1
        return Reversals(jnp.where(odd, -side.sign, side.sign), stages)

    def sign(self, side: Reversals) -> Scalar:
        return side.sign


def turned(controls: Controls, sign: Scalar | float) -> Controls:
    """A command that banks to the right, changed to the side of `sign`."""
    return Controls(
        controls.angle_of_attack, controls.cos_bank, sign * controls.sin_bank
    )


def reverse_bank(
    sign: Scalar,
    crossrange: Scalar,
    half_width: Scalar,
    switching: AbstractSwitching = Sharp(),
) -> Scalar:
    """Sign of the bank for a predicted crossrange miss (m, positive to the left).

    Inside the corridor the sign is unchanged. Outside it turns back: to the right, which is
    positive, if the miss is to the left. The choice is discrete and has no derivative,
    unless the switching is `Smooth` or `SmoothReversals`; then the sign takes values
    between the two.
    """
    turning_back = jnp.where(crossrange > 0.0, 1.0, -1.0)
    return switching.reversed(sign, turning_back, jnp.abs(crossrange) - half_width)


def predicted_crossrange(
    planet: Planet, origin: EntryState, state: EntryState, distance: Scalar
) -> Scalar:
    """Crossrange after a distance (m) along the present great circle, m.

    It is counted from the origin as in `ground_track`, to first order in the crossrange,
    which is small beside the planet's radius.
    """
    sin_heading, cos_heading = sincos(state.heading)
    _, cos_latitude = sincos(state.latitude)

    def crossrange(longitude, latitude):
        here = eqx.tree_at(
            lambda s: (s.longitude, s.latitude), state, (longitude, latitude)
        )
        return ground_track(planet, origin, here)[1]

    ahead = sin_heading / cos_latitude, cos_heading
    now, slope = jax.jvp(crossrange, (state.longitude, state.latitude), ahead)
    sine, cosine = sincos(distance / planet.radius)
    return now * cosine + slope * sine


def _check_sign(sign: Any) -> None:
    if isinstance(sign, Tracer) or not eqx.is_array(sign):
        return
    if jnp.ndim(sign) != 0 or abs(float(sign)) != 1.0:
        raise ValueError(
            f"first_sign is {np.asarray(sign)}: it must be 1, to the right, or -1"
        )
