"""Navigation: what the vehicle believes of its position and velocity."""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from .._apart import apart
from ..fields import NOT_NEGATIVE, Flag, Scalar, scalar
from ..motion.axes import Components, cross
from ..motion.state import EntryState
from ..world.gravity import AbstractGravity
from ..world.planet import Planet
from .inertial import (
    Actual,
    Gyroscopes,
    KnowledgeError,
    LiftAxes,
    Navigated,
    Sensed,
    added,
    believed_motion,
    difference,
    displaced,
    local_velocity,
    tilting,
    with_velocity,
)
from .navigation_filter import Aiding, Knowledge, NavigationFilter
from .sampling import normal_sample


State = TypeVar("State", bound=Navigated | None)


class AbstractNavigation(eqx.Module, Generic[State]):
    """What the vehicle believes of its position and velocity, and how it comes to that."""

    @abstractmethod
    def start(self, planet: Planet, state: EntryState) -> State:
        """Navigation at the start of a flight; None where the belief is the truth."""

    @property
    @abstractmethod
    def cycle(self) -> float | None:
        """Time from one `update` to the next, s; None if there is none."""

    @abstractmethod
    def begin(self, actual: Actual, navigated: State) -> Any:
        """What the navigation holds from one `update` to the next, at the start of a
        flight; None if it holds nothing."""

    @abstractmethod
    def update(
        self,
        actual: Callable[[], Actual],
        navigated: State,
        aiding: Any,
        at: Scalar,
        due: Flag,
    ) -> tuple[State, Any]:
        """The navigation, and what it holds, after an update at a time.

        **Arguments:**

        - `actual`: returns the flight, of which the sensors measure.
        - `at`: time, s, a multiple of the cycle.
        - `due`: whether the flight goes on; if not, nothing may change.
        """

    @abstractmethod
    def rate(self, actual: Actual, navigated: State, aiding: Any) -> State:
        """Time derivative of the navigation.

        `actual` gives what the instruments sense.
        """

    def caveats(self, aiding: Any) -> dict[str, Scalar]:
        """Caveats of the updates of a flight: see `Flight.caveats`."""
        return {}


class PerfectNavigation(AbstractNavigation[None]):
    """The vehicle knows where it is. This costs nothing."""

    def start(self, planet: Planet, state: EntryState) -> None:
        return None

    def rate(self, actual: Actual, navigated: None, aiding: None) -> None:
        return None

    @property
    def cycle(self) -> None:
        return None

    def begin(self, actual: Actual, navigated: None) -> None:
        return None

    def update(self, actual, navigated: None, aiding: None, at: Scalar, due: Flag):
        return None, None

    @property
    def knowledge(self) -> "KnowledgeError":
        """There is none: for a dispersion of it the error says what to do."""
        raise AttributeError(
            "navigation is PerfectNavigation, which has no knowledge error: give the "
            "scenario navigation=InertialNavigation()"
        )


class InertialNoise(eqx.Module):
    """White noise of accelerometers and gyroscopes: random walks of velocity and attitude.

    The noise of a whole cycle is added at its end.
    """

    velocity_random_walk: Scalar = scalar(0.0, unit="m/s^1.5", range=NOT_NEGATIVE)
    """Standard deviation of each component of the believed velocity after 1 s, m/s; it
    grows with the square root of time"""
    angle_random_walk: Scalar = scalar(0.0, unit="rad/s^0.5", range=NOT_NEGATIVE)
    """Standard deviation of each component of the tilt after 1 s, rad"""
    cycle: float = eqx.field(default=1.0, static=True)
    """Time from one sample to the next, s. Where the guidance cycle varies, it must be a
    multiple of the longest, and a sample is added at the first decision that is not before
    its time"""

    def __check_init__(self):
        if not 0.0 < self.cycle < math.inf:
            raise ValueError(f"cycle is {self.cycle} s: it must be positive and finite")


_FIRST_AXIS = 5
"""First noise axis, after those of accelerometers and flow sensors: the noise differs for
equal seeds"""


class InertialNavigation(AbstractNavigation[Navigated]):
    """Strapdown inertial navigation: integrates what accelerometers and gyroscopes sense.

    It begins at the actual state plus a knowledge error. The specific force that
    `Scenario.accelerometers` sense is turned by the error of the attitude, and moves the
    believed state over a planet whose radius and rotation are known, under the gravity
    that is known on board. The errors of the attitude are small angles: terms of their
    square are left out, one part in a million for 1 mrad.

    Without errors it is the truth, to rounding.

    With `EquatorialDynamics` the vehicle knows that it flies in the plane of the equator.
    What it would believe to do across it is left out: errors to the north at the start are
    refused, and so is a filter.

    Reference: D. H. Titterton, J. L. Weston, *Strapdown Inertial Navigation Technology*,
    2nd edition, 2004, chapters 3 and 12.
    """

    knowledge: KnowledgeError = eqx.field(default_factory=KnowledgeError)
    """Error at the start"""
    gyroscopes: Gyroscopes = eqx.field(default_factory=Gyroscopes)
    gravity: AbstractGravity | None = None
    """Gravity that is known on board; None for the actual one"""
    noise: InertialNoise | None = None
    """Noise of the instruments; None if there is none"""
    filter: NavigationFilter | None = None
    """Filter that corrects the navigation by other sensors; None if there are none"""
    seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1 that selects the noise of this flight, of the instruments
    and of the other sensors; disperse it with `Uniform(0, 1)`"""

    def __check_init__(self):
        if self.noise is None or self.filter is None:
            return
        if self.noise.cycle != self.filter.cycle:
            raise ValueError(
                f"the cycle of the noise is {self.noise.cycle} s and that of the filter "
                f"{self.filter.cycle} s: take one cycle for both"
            )

    @property
    def cycle(self) -> float | None:
        if self.filter is not None:
            return self.filter.cycle
        return None if self.noise is None else self.noise.cycle

    def start(self, planet: Planet, state: EntryState) -> Navigated:
        return displaced(planet, state, self.knowledge)

    def begin(self, actual: Actual, navigated: Navigated) -> Aiding | None:
        if self.filter is None:
            return None
        known = self._known(actual.planet)
        return self.filter.begin(known, navigated, Sensed.of(actual))

    def update(
        self,
        actual: Callable[[], Actual],
        navigated: Navigated,
        aiding: Aiding | None,
        at: Scalar,
        due: Flag,
    ) -> tuple[Navigated, Aiding | None]:
        if self.noise is not None:
            kicked = _kicked(self.noise, navigated, self.seed, at)
            navigated = jax.tree.map(
                lambda after, before: jnp.where(due, after, before), kicked, navigated
            )
        if self.filter is None or aiding is None:
            return navigated, aiding
        flight = actual()
        known, sensed = self._known(flight.planet), Sensed.of(flight)
        drawn = normal_sample(self.seed, at)
        return self.filter.update(known, navigated, aiding, sensed, at, due, drawn)

    def rate(
        self, actual: Actual, navigated: Navigated, aiding: Aiding | None
    ) -> Navigated:
        sensed, drift = Sensed.of(actual), self.gyroscopes
        if aiding is not None:
            sensed = sensed.corrected(aiding.accelerometers)
            drift = jax.tree.map(jnp.subtract, drift, aiding.gyroscopes)
        felt, turns = sensed.sensed_force(), sensed.sensed_drift(drift)
        force, turning = _believed(sensed.axes, felt, turns, navigated.tilt)
        planet = self._known(actual.planet)
        return Navigated(
            believed_motion(planet, navigated.state, force, actual.directions),
            tilting(planet, turning, navigated.tilt),
        )

    def caveats(self, aiding: Aiding | None) -> dict[str, Scalar]:
        if self.filter is None or aiding is None:
            return {}
        return self.filter.caveats(aiding)

    def knowledge_of(
        self,
        planet: Planet,
        actual: EntryState,
        navigated: Navigated,
        aiding: Aiding | None,
        at: Scalar,
    ) -> Knowledge:
        """The knowledge error of a flight at a time, s."""
        if self.filter is None or aiding is None:
            return Knowledge(difference(planet, actual, navigated))
        return self.filter.knowledge_at(planet, actual, navigated, aiding, at)

    def _known(self, planet: Planet) -> Planet:
        """The planet with the gravity that is known on board."""
        if self.gravity is None:
            return planet
        return eqx.tree_at(lambda p: p.gravity, planet, self.gravity)


@apart
def _believed(
    axes: LiftAxes, force: Components, drift: Components, tilt: Components
) -> tuple[Components, Components]:
    """Believed force and drift in axes of the planet, from those that are sensed."""
    force = axes.to_planet(*force)
    return added(force, cross(tilt, force)), axes.to_planet(*drift)


@apart
def _kicked(
    noise: InertialNoise, navigated: Navigated, seed: Scalar, at: Scalar
) -> Navigated:
    """The navigation after the noise of a cycle, which ends at a time, s."""
    drawn = normal_sample(seed, at)
    root = math.sqrt(noise.cycle)
    kick, turn = root * noise.velocity_random_walk, root * noise.angle_random_walk
    east, north, up = (
        v + kick * drawn(_FIRST_AXIS + i)
        for i, v in enumerate(local_velocity(navigated.state))
    )
    x, y, z = (
        angle + turn * drawn(_FIRST_AXIS + 3 + i)
        for i, angle in enumerate(navigated.tilt)
    )
    state = with_velocity(navigated.state, east, north, up)
    return Navigated(state, (x, y, z))
