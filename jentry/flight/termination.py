"""End conditions: a flight ends at the first one that is met."""

import enum
from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._math import sincos
from ..fields import QUARTER, Scalar, scalar
from ..motion.orbit import orbit_of
from ..motion.quantities import arc_to, direction_to, energy
from ..motion.state import EntryState
from ..onboard.track import Track
from ..world.planet import Planet


class Outcome(enum.IntEnum):
    """How a flight ended: the code in `Flight.outcome` and in result files."""

    REACHED = 0
    SKIPPED_OUT = 1
    CRASHED = 2
    TIMED_OUT = 3
    NOT_FINITE = 4
    BEGAN_BEYOND_END = 5
    SINGULAR = 6
    NOT_A_BANK = 7
    BEYOND_TABLE = 8

    @property
    def message(self) -> str:
        return _MESSAGES[self]


_MESSAGES = {
    Outcome.REACHED: "reached the end of guided flight",
    Outcome.SKIPPED_OUT: "skipped out of the atmosphere",
    Outcome.CRASHED: "met the surface",
    Outcome.TIMED_OUT: "was still flying at the time limit",
    Outcome.NOT_FINITE: (
        "stopped where its numbers were no longer finite, or where the adaptive solver did "
        "not meet its tolerance"
    ),
    Outcome.BEGAN_BEYOND_END: "began where an end condition was met already",
    Outcome.SINGULAR: (
        "stopped where its steps were too long for the equations of motion, which are "
        "singular over the poles, in vertical flight and at rest; take "
        "dynamics=VectorDynamics() to fly on"
    ),
    Outcome.NOT_A_BANK: (
        "stopped where its law commanded a cosine and a sine of the bank whose squares do "
        "not add up to one; Controls.from_bank takes an angle"
    ),
    Outcome.BEYOND_TABLE: (
        "stopped at the edge of a table of the planet or the vehicle that refuses to go on "
        "(refuse_beyond=True)"
    ),
}

_WITHOUT_END = (
    Outcome.NOT_FINITE,
    Outcome.BEGAN_BEYOND_END,
    Outcome.SINGULAR,
    Outcome.NOT_A_BANK,
    Outcome.BEYOND_TABLE,
)


def has_end(outcome: Any) -> Any:
    """Whether a flight flew to one of its end conditions or to the time limit.

    It takes one outcome or an array of their codes. The end state, misses and peaks of
    other flights have no meaning: statistics, losses and derivatives leave them out.
    """
    flown = outcome != _WITHOUT_END[0]
    for other in _WITHOUT_END[1:]:
        flown = flown & (outcome != other)
    return flown


_STATES = "truth", "navigation"
"""States of which the margin of an end condition may be"""


class AbstractEndCondition(eqx.Module):
    """A condition that ends a flight where its margin falls through zero.

    The flight continues while the margin is positive. A flight that begins where the margin
    is zero or negative is not flown, unless the condition is a `Crossing`.
    """

    counts_from_start: ClassVar[bool] = True
    """Whether the condition can end the flight from the start. If not, it can as soon as
    its margin has been positive"""

    outcome: eqx.AbstractVar[Outcome]

    by: str = eqx.field(default="truth", static=True, kw_only=True)
    """Which state the margin is of: the actual one, "truth", or the one that the vehicle
    believes, "navigation", by which it opens its parachute"""

    def __check_init__(self):
        if self.by not in _STATES:
            raise ValueError(f"by is {self.by!r}: it must be {' or '.join(_STATES)}")

    @abstractmethod
    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        """Smooth function of the state, positive until the condition is met.

        `planet` is the planet of the scenario.
        """


class VelocityBelow(AbstractEndCondition):
    """Ends a flight when the velocity has fallen to a value."""

    velocity: Scalar = scalar(unit="m/s", positive=True)
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return state.velocity - self.velocity


class AltitudeBelow(AbstractEndCondition):
    """Ends a flight when the altitude has fallen to a value.

    On an ellipsoid it is the geodetic altitude: see `Planet.shape`.
    """

    altitude: Scalar = scalar(unit="m")
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return planet.geodetic_altitude(state.altitude, state.latitude) - self.altitude


class AltitudeAbove(AbstractEndCondition):
    """Ends a flight when the altitude has risen to a value.

    On an ellipsoid it is the geodetic altitude: see `Planet.shape`.
    """

    altitude: Scalar = scalar(unit="m")
    outcome: Outcome = eqx.field(default=Outcome.SKIPPED_OUT, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return self.altitude - planet.geodetic_altitude(state.altitude, state.latitude)


class CapturedAbove(AbstractEndCondition):
    """Ends an aerocapture when the altitude has risen to a value, on a bound orbit.

    The orbit is that of the inertial velocity. A vehicle that leaves the air on a hyperbola
    is ended by `EscapedAbove`: give a scenario both, with one altitude.
    """

    altitude: Scalar = scalar(unit="m", positive=True)
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return _exit_margin(self.altitude, state, planet, bound=True)


class EscapedAbove(AbstractEndCondition):
    """Ends an aerocapture that has failed: it leaves the air, and its orbit is not bound.

    See `CapturedAbove`.
    """

    altitude: Scalar = scalar(unit="m", positive=True)
    outcome: Outcome = eqx.field(default=Outcome.SKIPPED_OUT, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return _exit_margin(self.altitude, state, planet, bound=False)


def _exit_margin(
    altitude: Scalar, state: EntryState, planet: Planet, bound: bool
) -> Scalar:
    """Margin to an altitude for orbits that are bound, or for those that are not.

    For the other ones it is the altitude, which is positive and constant. It jumps where
    the orbit becomes bound. There it is positive on both sides.
    """
    counts = orbit_of(planet, state).is_bound == bound
    risen = planet.geodetic_altitude(state.altitude, state.latitude)
    return jnp.where(counts, altitude - risen, altitude)


class VelocityAbove(AbstractEndCondition):
    """Ends a flight when the velocity has risen to a value."""

    velocity: Scalar = scalar(unit="m/s", positive=True)
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return self.velocity - state.velocity


class EnergyBelow(AbstractEndCondition):
    """Ends a flight when the energy, V^2/2 + potential, has fallen to a value."""

    energy: Scalar = scalar(unit="J/kg")
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return energy(planet, state) - self.energy


def _climb_rate(state: EntryState) -> Scalar:
    """Rate of the altitude, m/s. It passes zero smoothly in a flight through rest, where
    the flight-path angle jumps."""
    sine, _ = sincos(state.flight_path_angle)
    return state.velocity * sine


class Apoapsis(AbstractEndCondition):
    """Ends a flight at a highest point: where its climb rate falls through zero.

    A flight that begins in descent first has to climb.
    """

    counts_from_start: ClassVar[bool] = False

    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return _climb_rate(state)


class Periapsis(AbstractEndCondition):
    """Ends a flight at a lowest point: where its climb rate rises through zero.

    A skip begins there. A flight that begins in a climb first has to descend.
    """

    counts_from_start: ClassVar[bool] = False

    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return -_climb_rate(state)


class Crossing(AbstractEndCondition):
    """A condition that can end a flight only after its margin has been positive.

    A flight may begin where the margin of `condition` is negative. It ends where the margin
    then falls through zero. So a condition has a direction:
    `Crossing(AltitudeAbove(120 * km))` ends a flight that climbs through 120 km, also one
    that begins at 125 km and first descends.

    The margin is checked at the start of each step (of each guidance cycle with the
    `Adaptive` solver). A margin that is positive only within a step is not detected.
    """

    counts_from_start: ClassVar[bool] = False

    condition: AbstractEndCondition

    def __check_init__(self):
        if self.by != "truth":
            raise ValueError(
                f"by of a Crossing is {self.by!r}: its condition says by which state, such "
                f"as Crossing(AltitudeAbove(120e3, by={self.by!r}))"
            )

    @property
    def outcome(self) -> Outcome:
        return self.condition.outcome

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return self.condition.margin(state, planet)


class TargetPassed(AbstractEndCondition):
    """Ends a flight in the plane through the target and across its track."""

    track: Track
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        return planet.radius * self.track.to_go(state)


class RangeToGoBelow(AbstractEndCondition):
    """Ends a flight when the range to a place over the ground has fallen to a value.

    The place must be the target of the scenario: see `check`. A flight that passes it at a
    larger distance is not ended.
    """

    range: Scalar = scalar(unit="m", positive=True)
    longitude: Scalar = scalar(unit="rad")
    latitude: Scalar = scalar(unit="rad", range=QUARTER)
    outcome: Outcome = eqx.field(default=Outcome.REACHED, static=True)

    def margin(self, state: EntryState, planet: Planet) -> Scalar:
        arc = arc_to(*direction_to(self.longitude, self.latitude, state))
        return planet.radius * arc - self.range


def _margin(
    condition: AbstractEndCondition,
    state: EntryState,
    believed: EntryState,
    planet: Planet,
) -> Scalar:
    """Margin of a condition, of the state by which it is judged."""
    read = condition
    while isinstance(read, Crossing):
        read = read.condition
    return condition.margin(believed if read.by == "navigation" else state, planet)


Counting = Bool[Array, " conditions"] | None
"""Which of the end conditions and the time limit can end the flight now; None for all"""


class Termination(eqx.Module):
    """The end conditions of a scenario, by name, and its time limit.

    Conditions are checked after each step of the solver. A condition that is met only
    within a step is not detected.
    """

    conditions: dict[str, AbstractEndCondition] = eqx.field(
        converter=lambda conditions: dict(sorted(conditions.items()))
    )
    time_limit: float = eqx.field(static=True)
    """Latest end of the flight, s after its start. It is static, since it bounds the length
    of the loop"""
    at_time_limit: Outcome = eqx.field(default=Outcome.TIMED_OUT, static=True)
    """Outcome at the time limit; `Outcome.REACHED` for flights of a fixed duration"""

    def __check_init__(self):
        if not 0.0 < self.time_limit < float("inf"):
            raise ValueError(
                f"time_limit is {self.time_limit} s: it must be positive and finite"
            )

    def margins(
        self, flown: Scalar, state: EntryState, believed: EntryState, planet: Planet
    ) -> Float[Array, " conditions"]:
        """Margins of all conditions, and last that of the time limit.

        `flown` is in s. `believed` is the state of the navigation.
        """
        values = [_margin(c, state, believed, planet) for c in self.conditions.values()]
        return jnp.stack([*values, self.time_limit - flown])

    @property
    def always(self) -> Counting:
        """Which conditions can end the flight from the start; None if all of them can."""
        counts = [c.counts_from_start for c in self.conditions.values()]
        return None if all(counts) else jnp.array([*counts, True])

    def counting(
        self, flown: Scalar, state: EntryState, believed: EntryState, planet: Planet
    ) -> Counting:
        """Which conditions can end a step from a state; None if all of them can."""
        if self.always is None:
            return None
        return self.always | (self.margins(flown, state, believed, planet) > 0.0)

    def smallest_margin(
        self,
        flown: Scalar,
        state: EntryState,
        believed: EntryState,
        planet: Planet,
        counting: Counting,
    ) -> Scalar:
        """Smallest of the margins: positive in flight, and zero where the flight ends.

        `counting` is that of the state before the step. A condition whose margin is
        positive after the step is included as well.
        """
        margins = self.margins(flown, state, believed, planet)
        if counting is not None:
            margins = jnp.where(counting | (margins > 0.0), margins, jnp.inf)
        return jnp.min(margins)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the conditions and of the time limit, in the order of the margins."""
        return (*self.conditions, "time_limit")

    @property
    def outcomes(self) -> tuple[Outcome, ...]:
        """Outcomes of the conditions and of the time limit, in the order of the margins."""
        ends = [condition.outcome for condition in self.conditions.values()]
        return (*ends, self.at_time_limit)
