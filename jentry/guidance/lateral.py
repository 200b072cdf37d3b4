"""Lateral logic: to which side a law banks, and when it reverses the bank."""

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
from ..motion.quantities import ground_track
from ..motion.state import Controls, EntryState
from ..onboard.navigation import Measurement
from ..world.planet import Planet
from .switching import AbstractSwitching, Sharp


Side = TypeVar("Side")


class PredictedPassage(eqx.Module):
    """How a law predicts that its destination will be passed."""

    crossrange_error: Scalar
    """At the end, m; NaN where the law cannot predict"""
    time: Scalar
    """From now to the end, s; NaN where the law cannot tell"""


class Destination(eqx.Module):
    """The point on the ground that a law steers to, as the law believes it."""

    planet: Planet
    origin: EntryState
    """Where downrange and crossrange are counted from, as in `ground_track`"""
    downrange: Scalar
    """m"""
    crossrange: Scalar
    """m, positive to the left"""
    predicted: Callable[[Scalar], PredictedPassage] | None = None
    """If the bank is of a sign from now on; None for a law that predicts no crossrange"""


class AbstractLateralLogic(eqx.Module, Generic[Side]):
    """The choice of the side to which a law banks; every law that turns a bank has one.

    It decides at the start of a guidance cycle. Its memory, called the side, is a pytree
    of numbers that is held until the next decision; what the law tracks has no part in it.
    A logic whose side is None has nothing to decide, and can be flown without a cycle.
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
        """The decision at the start of a guidance cycle.

        **Arguments:**

        - `time`: s since the start.
        - `side`: what was decided before.
        - `destination`: where the law steers to; None if it has no such point.
        """

    @abstractmethod
    def sign(self, side: Side) -> Scalar | float:
        """1 if the bank is to the right, -1 if it is to the left."""

    def reverses_at(self, side: Side) -> Scalar | float:
        """Time of the reversal that is expected next, s since the start.

        Infinite where none is, or where the logic does not look ahead. A law that heeds it,
        `PredictorCorrector`, reverses the bank at this time, within a guidance cycle too:
        the logic counts it as done at the next decision.
        """
        return math.inf


class FixedSide(AbstractLateralLogic[None]):
    """Banks to one side for the whole flight: to the right if not told otherwise."""

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
    """Reverses the bank at the edges of a corridor; the side is the sign of the bank."""

    first_sign: eqx.AbstractVar[Scalar]
    """Of the bank at the start: 1 to the right, -1 to the left"""
    switching: eqx.AbstractVar[AbstractSwitching]
    """Of the sign, at an edge"""

    def __check_init__(self):
        _check_sign(self.first_sign)

    def init(self, measurement: Measurement) -> Scalar:
        return self.first_sign + 0.0 * measurement.drag

    def sign(self, side: Scalar) -> Scalar:
        return side


class CrossrangeCorridor(AbstractCorridor):
    """Reverses the bank when the flight would pass the destination of its law too far off.

    The crossrange there is predicted along the great circle that is flown now. It is left
    alone where |crossrange error| <= floor + widening V^2. This corridor narrows along the
    flight as what one bank can still change does, so that the reversals spread over the
    flight: a wide corridor has few, a low floor ends close.
    """

    floor: Scalar = scalar(unit="m", positive=True)
    widening: Scalar = scalar(0.0, unit="s2/m")
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""
    switching: AbstractSwitching = Sharp()

    def half_width(self, velocity: Scalar) -> Scalar:
        """m"""
        return self.floor + self.widening * velocity * velocity

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
    """Reverses the bank when the heading is too far off the bearing of a target.

    The heading error is left alone up to a half width that is a piecewise linear function
    of the velocity, constant beyond its ends; two points make it a straight line.
    """

    longitude: Scalar = scalar(unit="rad")
    """Of the target"""
    latitude: Scalar = scalar(unit="rad", range=QUARTER)
    """Of the target"""
    radius: Scalar = scalar(unit="m", positive=True)
    """Radius of the planet. Only a surrogate needs it, which shares a reversal out over the
    distance by which the target would be passed"""
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
        """rad"""
        return jnp.interp(velocity, self.velocities, self.half_widths)

    def heading_error(self, state: EntryState) -> Scalar:
        """Bearing of the target less the heading, rad in [-pi, pi].

        Positive if the target is to the right.
        """
        ahead, right, _ = self._direction(state)
        return jnp.arctan2(right, ahead)

    def update(
        self,
        time: Scalar,
        measurement: Measurement,
        side: Scalar,
        destination: Destination | None,
    ) -> Scalar:
        state = measurement.state
        ahead, right, down = self._direction(state)
        distance = self.radius * jnp.arctan2(
            jnp.sqrt(ahead * ahead + right * right), down
        )
        # As a length, in which the surrogates measure how far a limit is exceeded.
        miss = jnp.arctan2(right, ahead) * distance
        half_width = self.half_width(state.velocity) * distance
        return reverse_bank(side, miss, half_width, self.switching)

    def _direction(self, state: EntryState) -> tuple[Scalar, Scalar, Scalar]:
        """Unit vector to the target: along the heading, to its right, and upwards."""
        sin_there, cos_there = sincos(self.latitude)
        sin_here, cos_here = sincos(state.latitude)
        sin_between, cos_between = sincos(self.longitude - state.longitude)
        sin_heading, cos_heading = sincos(state.heading)
        east = cos_there * sin_between
        north = sin_there * cos_here - cos_there * sin_here * cos_between
        up = sin_there * sin_here + cos_there * cos_here * cos_between
        ahead = east * sin_heading + north * cos_heading
        return ahead, east * cos_heading - north * sin_heading, up


class CountedSide(eqx.Module):
    """The side, and how often it has changed."""

    sign: Scalar
    """1 to the right, -1 to the left"""
    reversals: Scalar
    reverses_at: Scalar | None = None
    """Time of the next one that is expected, s; infinite for none"""


class PredictedCrossrange(AbstractLateralLogic[CountedSide]):
    """Reverses the bank when that is predicted to end much nearer in crossrange.

    In each guidance cycle the law predicts the crossrange error at the end for a bank that
    keeps its side and for one that is reversed now. It is reversed where the second is
    smaller by a factor. A reversal leaves at most that share of the error to the next one:
    few of them are needed, and the last ones come late. Their number is limited.

    The error kept, e, becomes that of a bank that is reversed now, e_r, the later it is
    reversed, the less so: after a time t of the T to the end it is

        e + (e_r - e) (1 - t / T)^2

    under a constant push to the side. A logic that `foresees` tells by it when the bank
    will be reversed next, for a law that predicts what its turning does to the range, and
    when within a guidance cycle.

    After K. M. Smith, "Predictive Lateral Logic for Numerical Entry Guidance Algorithms",
    AAS/AIAA Space Flight Mechanics Meeting, 2016. It is for a law that predicts in three
    dimensions.
    """

    factor: Scalar = scalar(3.0, range=(1.0, math.inf))
    """By which the error of the reversed bank must be the smaller one"""
    tolerance: Scalar = scalar(0.0, unit="m", range=NOT_NEGATIVE)
    """Error below which the bank is left alone"""
    most: Scalar = scalar(6.0, range=NOT_NEGATIVE)
    """Number of reversals"""
    first_sign: Scalar = scalar(1.0)
    """Side of the bank at the start: 1 to the right, -1 to the left"""
    foresees: bool = eqx.field(default=False, static=True)
    """Whether it is told when the next reversal comes"""

    def __check_init__(self):
        _check_sign(self.first_sign)

    def init(self, measurement: Measurement) -> CountedSide:
        nothing = 0.0 * measurement.drag
        never = nothing + jnp.inf if self.foresees else None
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
                "PredictorCorrector with dynamics=EntryDynamics(): take a "
                "CrossrangeCorridor"
            )
        if side.reverses_at is not None:
            done = time >= side.reverses_at
            side = CountedSide(
                jnp.where(done, -side.sign, side.sign),
                side.reversals + jnp.where(done, 1.0, 0.0),
            )
        # A loop: written twice, the prediction is most of what there is to compile.
        sides = jnp.stack([side.sign, -side.sign])
        passages = lax.map(destination.predicted, sides)
        kept, reversed_now = passages.crossrange_error
        # What is not a number is not smaller.
        better = self.factor * jnp.abs(reversed_now) < jnp.abs(kept)
        turns = better & (jnp.abs(kept) > self.tolerance)
        turns &= side.reversals < self.most
        reversals = side.reversals + jnp.where(turns, 1.0, 0.0)
        sign = jnp.where(turns, -side.sign, side.sign)
        if not self.foresees:
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
        """When the error of a reversed bank will be the share of the kept one, beyond the
        destination; infinite where that will not be."""
        change = kept - reversed_now
        moves = change != 0.0
        square = (1.0 + 1.0 / self.factor) * kept / jnp.where(moves, change, 1.0)
        comes = moves & (square > 0.0) & (square <= 1.0)
        comes &= (jnp.abs(kept) > self.tolerance) & (reversals < self.most)
        # On both sides of the `where`, so that no derivative comes from there.
        root = jnp.sqrt(jnp.where(comes, square, 1.0))
        return jnp.where(comes, time * (1.0 - root), jnp.inf)


class Reversals(eqx.Module):
    """What is remembered of reversals at given velocities."""

    sign: Scalar
    """Side of the bank: 1 to the right, -1 to the left"""
    stages: Vector
    """State of each reversal: `_WAITING`, `_AHEAD` or `_DONE`"""


_WAITING, _AHEAD, _DONE = 0.0, 1.0, 2.0
"""The velocity has not been above that of the reversal; it has; it has fallen to it"""


class VelocityReversals(AbstractLateralLogic[Reversals]):
    """Reverses the bank each time that the velocity has fallen to one of given values.

    Each value counts once, in the first guidance cycle that begins at or below it, and
    only where the velocity has been above it before: so neither an entry that first
    becomes faster nor one that begins below some of the values reverses too often. Two
    values that are passed within one cycle are two reversals, which leave the side as it
    was.
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
    """A command that banks to the right, on the side of a sign of the bank."""
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

    Inside the corridor the sign stays. Outside it turns back: to the right, which is
    positive, if the miss is to the left. A discrete choice, and so without derivative,
    unless the switching is `Smooth` or `SmoothReversals`; then the sign takes values
    between the two.
    """
    turning_back = jnp.where(crossrange > 0.0, 1.0, -1.0)
    return switching.reversed(sign, turning_back, jnp.abs(crossrange) - half_width)


def predicted_crossrange(
    planet: Planet, origin: EntryState, state: EntryState, distance: Scalar
) -> Scalar:
    """Crossrange after a distance (m) along the great circle that is flown now, m.

    Counted from the origin as in `ground_track`; to first order in the crossrange, which
    is small beside the planet's radius.
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
