"""Navigation: what the vehicle believes of its position and velocity."""

import math
from abc import abstractmethod
from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp

from .._math import sincos
from ..fields import NOT_NEGATIVE, Scalar, scalar
from ..motion.axes import Components, LocalAxes, VelocityAxes, cross
from ..motion.dynamics import rates_under
from ..motion.forces import about_velocity, air_data
from ..motion.state import Controls, EntryState
from ..world.gravity import AbstractGravity
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .measurement import AbstractAccelerometers
from .sampling import normal_sample


class Navigated(eqx.Module):
    """State of the navigation, or its time derivative."""

    state: EntryState
    """What the vehicle believes of its position and velocity"""
    tilt: Components
    """Rotation from the actual axes of the vehicle to those that it believes, rad: its
    components along axes that turn with the planet. The first axis points from its centre
    to longitude zero on the equator, the third to the north pole"""


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
    def update(self, navigated: State, at: Scalar) -> State:
        """The navigation after an update at a time, s, which is a multiple of the cycle."""

    @abstractmethod
    def rate(
        self,
        planet: Planet,
        vehicle: Vehicle,
        accelerometers: AbstractAccelerometers,
        state: EntryState,
        controls: Controls,
        navigated: State,
    ) -> State:
        """Time derivative of the navigation.

        `planet`, `vehicle`, `state` and `controls` are the actual ones. They give what the
        instruments sense.
        """


class PerfectNavigation(AbstractNavigation[None]):
    """The vehicle knows where it is. This costs nothing."""

    def start(self, planet: Planet, state: EntryState) -> None:
        return None

    def rate(self, planet, vehicle, accelerometers, state, controls, navigated) -> None:
        return None

    @property
    def cycle(self) -> None:
        return None

    def update(self, navigated: None, at: Scalar) -> None:
        return None

    @property
    def knowledge(self) -> "KnowledgeError":
        """There is none: for a dispersion of it the error says what to do."""
        raise AttributeError(
            "navigation is PerfectNavigation, which has no knowledge error: give the "
            "scenario navigation=InertialNavigation()"
        )


class KnowledgeError(eqx.Module):
    """What the vehicle believes at the start minus what is: the knowledge error.

    The delivery error, by which the vehicle itself is off, is a dispersion of
    `initial_state`: the knowledge error does not move it.
    """

    east: Scalar = scalar(0.0, unit="m")
    north: Scalar = scalar(0.0, unit="m")
    up: Scalar = scalar(0.0, unit="m")
    velocity_east: Scalar = scalar(0.0, unit="m/s")
    velocity_north: Scalar = scalar(0.0, unit="m/s")
    velocity_up: Scalar = scalar(0.0, unit="m/s")
    tilt_east: Scalar = scalar(0.0, unit="rad")
    """Rotation of the believed axes of the vehicle about the direction to the east"""
    tilt_north: Scalar = scalar(0.0, unit="rad")
    tilt_up: Scalar = scalar(0.0, unit="rad")


class Gyroscopes(eqx.Module):
    """Drift of three gyroscopes that are fixed to the vehicle: sensed rate minus actual."""

    drift_roll: Scalar = scalar(0.0, unit="rad/s")
    """About the axis forward"""
    drift_pitch: Scalar = scalar(0.0, unit="rad/s")
    """About the axis to the right"""
    drift_yaw: Scalar = scalar(0.0, unit="rad/s")
    """About the axis down"""


class InertialNoise(eqx.Module):
    """White noise of accelerometers and gyroscopes: random walks of velocity and attitude.

    The noise of a whole cycle is added at its end.
    """

    velocity_random_walk: Scalar = scalar(0.0, unit="m/s^1.5", range=NOT_NEGATIVE)
    """Standard deviation of each component of the believed velocity after 1 s, m/s; it
    grows with the square root of time"""
    angle_random_walk: Scalar = scalar(0.0, unit="rad/s^0.5", range=NOT_NEGATIVE)
    """Standard deviation of each component of the tilt after 1 s, rad"""
    seed: Scalar = scalar(0.0, range=(0.0, 1.0), choice=True)
    """A number between 0 and 1 that selects the noise of this flight; disperse it with
    `Uniform(0, 1)`"""
    cycle: float = eqx.field(default=1.0, static=True)
    """Time from one sample to the next, s"""

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

    Reference: D. H. Titterton, J. L. Weston, *Strapdown Inertial Navigation Technology*,
    2nd edition, 2004, chapters 3 and 12.
    """

    knowledge: KnowledgeError = eqx.field(default_factory=KnowledgeError)
    gyroscopes: Gyroscopes = eqx.field(default_factory=Gyroscopes)
    gravity: AbstractGravity | None = None
    """Gravity that is known on board; None for the actual one"""
    noise: InertialNoise | None = None
    """Noise of the instruments; None if there is none"""

    @property
    def cycle(self) -> float | None:
        return None if self.noise is None else self.noise.cycle

    def update(self, navigated: Navigated, at: Scalar) -> Navigated:
        noise = self.noise
        if noise is None:
            return navigated
        drawn = normal_sample(noise.seed, at)
        root = math.sqrt(noise.cycle)
        kick, turn = root * noise.velocity_random_walk, root * noise.angle_random_walk
        state, (x, y, z) = navigated.state, navigated.tilt
        nothing = jnp.zeros_like(state.velocity)
        known = VelocityAxes.of(state).to_local(state.velocity, nothing, nothing)
        east, north, up = (
            v + kick * drawn(_FIRST_AXIS + i) for i, v in enumerate(known)
        )
        return Navigated(
            _with_velocity(state, east, north, up),
            (
                x + turn * drawn(_FIRST_AXIS + 3),
                y + turn * drawn(_FIRST_AXIS + 4),
                z + turn * drawn(_FIRST_AXIS + 5),
            ),
        )

    def start(self, planet: Planet, state: EntryState) -> Navigated:
        off = self.knowledge
        per_radius = 1.0 / (planet.radius + state.altitude)
        _, cos_latitude = sincos(state.latitude)
        nothing = jnp.zeros_like(state.velocity)
        velocity = state.velocity, nothing, nothing
        east, north, up = VelocityAxes.of(state).to_local(*velocity)
        believed = _with_velocity(
            EntryState(
                altitude=state.altitude + off.up,
                longitude=state.longitude + off.east * per_radius / cos_latitude,
                latitude=state.latitude + off.north * per_radius,
                velocity=state.velocity,
                flight_path_angle=state.flight_path_angle,
                heading=state.heading,
            ),
            east + off.velocity_east,
            north + off.velocity_north,
            up + off.velocity_up,
        )
        tilt = LocalAxes.of(state).to_planet(off.tilt_east, off.tilt_north, off.tilt_up)
        return Navigated(believed, tilt)

    def rate(
        self,
        planet: Planet,
        vehicle: Vehicle,
        accelerometers: AbstractAccelerometers,
        state: EntryState,
        controls: Controls,
        navigated: Navigated,
    ) -> Navigated:
        air = air_data(planet, vehicle, state, controls.angle_of_attack)
        force = accelerometers.read(air, None)
        sine, cosine = sincos(controls.angle_of_attack)
        drift = self.gyroscopes
        velocity, place = VelocityAxes.of(state), LocalAxes.of(state)
        # The axis forward is at the angle of attack above the velocity over the air.
        turning = (
            drift.drift_roll * cosine + drift.drift_yaw * sine,
            drift.drift_roll * sine - drift.drift_yaw * cosine,
            drift.drift_pitch,
        )

        def turned(along: Scalar, lifted: Scalar, side: Scalar | float) -> Components:
            """In axes of the planet, from along the velocity over the air, along the lift
            and to the right of both."""
            above = lifted * controls.cos_bank - side * controls.sin_bank
            right = lifted * controls.sin_bank + side * controls.cos_bank
            ahead = about_velocity(planet.wind, state, along, above, right)
            return place.to_planet(*velocity.to_local(*ahead))

        sensed = turned(-force.drag, force.lift, force.side)
        off = cross(navigated.tilt, sensed)
        believed = (f + error for f, error in zip(sensed, off, strict=True))
        here = navigated.state
        force_here = LocalAxes.of(here).from_planet(*believed)
        along, above, right = VelocityAxes.of(here).from_local(*force_here)
        known = planet
        if self.gravity is not None:
            known = eqx.tree_at(lambda p: p.gravity, planet, self.gravity)
        rates = rates_under(
            known, here, along, above, right, rotation_rate=planet.rotation_rate
        )
        x, y, _ = navigated.tilt
        wander = turned(*turning)
        tilt = (
            wander[0] + planet.rotation_rate * y,
            wander[1] - planet.rotation_rate * x,
            wander[2],
        )
        return Navigated(rates, tilt)


def _with_velocity(
    state: EntryState, east: Scalar, north: Scalar, up: Scalar
) -> EntryState:
    """The state with another velocity, m/s; its heading is nearest to that of `state`."""
    ground = jnp.sqrt(east * east + north * north)
    sine, cosine = sincos(state.heading)
    turn = jnp.arctan2(east * cosine - north * sine, north * cosine + east * sine)
    return EntryState(
        altitude=state.altitude,
        longitude=state.longitude,
        latitude=state.latitude,
        velocity=jnp.sqrt(ground * ground + up * up),
        flight_path_angle=jnp.arctan2(up, ground),
        heading=state.heading + turn,
    )
