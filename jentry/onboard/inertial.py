"""Strapdown inertial navigation: its state, its errors and its equations.

The errors of the attitude are small angles: terms of their square are left out, one part
in a million for 1 mrad.

Reference: D. H. Titterton, J. L. Weston, *Strapdown Inertial Navigation Technology*,
2nd edition, 2004, chapters 3 and 12.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from .._apart import apart
from .._math import sincos
from ..fields import Range, Scalar, scalar
from ..motion.axes import Components, LocalAxes, SineCosine, VelocityAxes, cross
from ..motion.dynamics import rates_under
from ..motion.forces import AirData, about_velocity, air_data, wind_at
from ..motion.quantities import ground_track
from ..motion.state import Controls, EntryState
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ..world.wind import AbstractWind
from .flow_sensing import FlowSensors
from .measurement import AbstractAccelerometers, BodyAccelerometers, SpecificForce


SMALL: Range = (-0.1, 0.1)
"""Range of a tilt, rad: at its ends what is left out is half a percent of a force"""


class Navigated(eqx.Module):
    """State of the navigation, or its time derivative."""

    state: EntryState
    """What the vehicle believes of its position and velocity"""
    tilt: Components
    """Rotation from the actual axes of the vehicle to those that it believes, rad: its
    components along axes that turn with the planet. The first axis points from its centre
    to longitude zero on the equator, the third to the north pole"""


class Directions(eqx.Module):
    """Sines and cosines of angles of a flight with navigation, or their time derivatives.

    Within a step they are integrated beside the angles. This takes less time than to
    compute them in each stage. Their error is that of the step, and ends with it.
    """

    actual_longitude: SineCosine
    longitude: SineCosine
    """Believed, as the two below"""
    latitude: SineCosine
    heading: SineCosine

    @classmethod
    def of(cls, actual: EntryState, believed: EntryState) -> "Directions":
        """The sines and cosines of two states."""
        return cls(
            sincos(actual.longitude),
            sincos(believed.longitude),
            sincos(believed.latitude),
            sincos(believed.heading),
        )

    @apart
    def rate(self, actual: EntryState, believed: EntryState) -> "Directions":
        """Their time derivative, from those of the two states."""
        return Directions(
            _turning(self.actual_longitude, actual.longitude),
            _turning(self.longitude, believed.longitude),
            _turning(self.latitude, believed.latitude),
            _turning(self.heading, believed.heading),
        )


def _turning(known: SineCosine, rate: Scalar) -> SineCosine:
    sine, cosine = known
    return cosine * rate, -sine * rate


class KnowledgeError(eqx.Module):
    """What the vehicle believes minus what is, or standard deviations of that.

    The delivery error, by which the vehicle itself is off, is a dispersion of
    `initial_state`: the knowledge error does not move it. A tilt is at most 0.1 rad,
    since the navigation leaves out its square.
    """

    east: Scalar = scalar(0.0, unit="m")
    north: Scalar = scalar(0.0, unit="m")
    up: Scalar = scalar(0.0, unit="m")
    velocity_east: Scalar = scalar(0.0, unit="m/s")
    velocity_north: Scalar = scalar(0.0, unit="m/s")
    velocity_up: Scalar = scalar(0.0, unit="m/s")
    tilt_east: Scalar = scalar(0.0, unit="rad", range=SMALL)
    """Rotation of the believed axes of the vehicle about the direction to the east"""
    tilt_north: Scalar = scalar(0.0, unit="rad", range=SMALL)
    tilt_up: Scalar = scalar(0.0, unit="rad", range=SMALL)


class TrackError(eqx.Module):
    """What the vehicle believes minus what is, along and across the track, or standard
    deviations of that."""

    downrange: Scalar = scalar(unit="m")
    """Along the heading, as an arc on the ground"""
    crossrange: Scalar = scalar(unit="m")
    """To the left of it, as an arc on the ground"""
    altitude: Scalar = scalar(unit="m")
    velocity: Scalar = scalar(unit="m/s")


class Gyroscopes(eqx.Module):
    """Drift of three gyroscopes that are fixed to the vehicle: sensed rate minus actual."""

    drift_roll: Scalar = scalar(0.0, unit="rad/s")
    """About the axis forward"""
    drift_pitch: Scalar = scalar(0.0, unit="rad/s")
    """About the axis to the right"""
    drift_yaw: Scalar = scalar(0.0, unit="rad/s")
    """About the axis down"""


class Actual(NamedTuple):
    """The actual flight at an instant, which the instruments sense."""

    planet: Planet
    vehicle: Vehicle
    state: EntryState
    controls: Controls
    accelerometers: AbstractAccelerometers
    flow_sensors: FlowSensors | None = None
    angle_of_attack_error: Scalar | None = None
    """Measured minus actual angle of attack, rad; None if there is none"""
    directions: Directions | None = None
    """Sines and cosines that are known; None if there are none"""


class LiftAxes(NamedTuple):
    """Axes along the velocity over the air, along the lift and to the right of both."""

    state: EntryState
    wind: AbstractWind
    cos_bank: Scalar
    sin_bank: Scalar
    velocity: VelocityAxes
    place: LocalAxes

    def to_planet(
        self, along: Scalar, lifted: Scalar, side: Scalar | float
    ) -> Components:
        """Components in axes of the planet of a vector in these axes."""
        above = lifted * self.cos_bank - side * self.sin_bank
        right = lifted * self.sin_bank + side * self.cos_bank
        ahead = about_velocity(self.wind, self.state, along, above, right)
        return self.place.to_planet(*self.velocity.to_local(*ahead))


class BodyAxes(NamedTuple):
    """Axes of the vehicle, in axes of the planet.

    Forward is above the velocity over the air by the angle of attack.
    """

    forward: Components
    right: Components
    down: Components

    def turned(self, tilt: Components) -> "BodyAxes":
        """The axes after a small rotation, rad."""
        return BodyAxes(*(added(axis, cross(tilt, axis)) for axis in self))

    def to_planet(self, forward: Scalar, right: Scalar, down: Scalar) -> Components:
        """Components in axes of the planet of a vector in these axes."""
        x, y, z = (
            forward * f + right * r + down * d
            for f, r, d in zip(self.forward, self.right, self.down, strict=True)
        )
        return x, y, z

    def of_vector(self, vector: Components) -> Components:
        """Components forward, to the right and down of a vector in axes of the planet."""
        forward, right, down = (
            sum(a * v for a, v in zip(axis, vector, strict=True)) for axis in self
        )
        return forward, right, down


class Sensed(NamedTuple):
    """What the accelerometers sense, with the directions of the actual flight."""

    actual: Actual
    air: AirData
    """The actual flow"""
    force: SpecificForce
    velocity: VelocityAxes
    place: LocalAxes

    @classmethod
    def of(cls, actual: Actual) -> "Sensed":
        state, angle = actual.state, actual.controls.angle_of_attack
        air = air_data(actual.planet, actual.vehicle, state, angle)
        force = actual.accelerometers.read(air, None)
        if actual.directions is None:
            place = LocalAxes.of(state)
        else:
            longitude = actual.directions.actual_longitude
            place = LocalAxes(*longitude, *sincos(state.latitude))
        return cls(actual, air, force, VelocityAxes.of(state), place)

    def corrected(self, found: BodyAccelerometers) -> "Sensed":
        """What is sensed, less the errors of the accelerometers that have been found."""
        lift, drag, side = self.force
        # The errors are small: those of the sensed force are those of the actual one.
        air = dataclasses.replace(self.air, lift=lift, drag=drag)
        off = found.read(air, None)
        force = SpecificForce(
            2.0 * lift - off.lift, 2.0 * drag - off.drag, side - off.side
        )
        return self._replace(force=force)

    @property
    def axes(self) -> LiftAxes:
        """The axes in which forces are sensed."""
        state, controls = self.actual.state, self.actual.controls
        bank = controls.cos_bank, controls.sin_bank
        wind = wind_at(self.actual.planet, state)
        return LiftAxes(state, wind, *bank, self.velocity, self.place)

    def sensed_force(self) -> Components:
        """The sensed specific force in these axes, m/s2."""
        lift, drag, side = self.force
        return -drag, lift, jnp.asarray(side)

    def sensed_drift(self, drift: Gyroscopes) -> Components:
        """The drift in these axes, rad/s."""
        sine, cosine = sincos(self.air.angle_of_attack)
        return (
            drift.drift_roll * cosine + drift.drift_yaw * sine,
            drift.drift_roll * sine - drift.drift_yaw * cosine,
            drift.drift_pitch,
        )

    def body_axes(self) -> BodyAxes:
        """The actual axes of the vehicle."""
        sine, cosine = sincos(self.air.angle_of_attack)
        nothing, one = jnp.zeros_like(sine), jnp.ones_like(sine)
        axes = self.axes
        return BodyAxes(
            forward=axes.to_planet(cosine, sine, nothing),
            right=axes.to_planet(nothing, nothing, one),
            down=axes.to_planet(sine, -cosine, nothing),
        )


@apart
def believed_motion(
    planet: Planet,
    state: EntryState,
    force: Components,
    directions: Directions | None = None,
) -> EntryState:
    """Time derivative of a state under a specific force in axes of the planet, m/s2.

    `directions` are those of the state, where they are known.
    """
    if directions is None:
        directions = Directions.of(state, state)
    latitude, heading = directions.latitude, directions.heading
    here = LocalAxes(*directions.longitude, *latitude).from_planet(*force)
    course = VelocityAxes(*sincos(state.flight_path_angle), *heading)
    return rates_under(
        planet,
        state,
        *course.from_local(*here),
        rotation_rate=planet.rotation_rate,
        heading=heading,
        latitude=latitude,
    )


def tilting(planet: Planet, drift: Components, tilt: Components) -> Components:
    """Time derivative of the tilt under a drift, both in axes of the planet, rad/s."""
    x, y, _ = tilt
    rotation = planet.rotation_rate
    return drift[0] + rotation * y, drift[1] - rotation * x, drift[2]


def displaced(planet: Planet, state: EntryState, off: KnowledgeError) -> Navigated:
    """What a vehicle at a state believes with a knowledge error."""
    per_radius = 1.0 / (planet.radius + state.altitude)
    _, cos_latitude = sincos(state.latitude)
    moved = EntryState(
        altitude=state.altitude + off.up,
        longitude=state.longitude + off.east * per_radius / cos_latitude,
        latitude=state.latitude + off.north * per_radius,
        velocity=state.velocity,
        flight_path_angle=state.flight_path_angle,
        heading=state.heading,
    )
    east, north, up = local_velocity(state)
    believed = with_velocity(
        moved,
        east + off.velocity_east,
        north + off.velocity_north,
        up + off.velocity_up,
    )
    tilt = LocalAxes.of(state).to_planet(off.tilt_east, off.tilt_north, off.tilt_up)
    return Navigated(believed, tilt)


def in_equator(navigated: Navigated) -> Navigated:
    """The navigation of a vehicle that knows that it flies due east over the equator.

    What it believes to do across this plane is left out; the tilt stays.
    """
    east, _, up = local_velocity(navigated.state)
    nothing = jnp.zeros_like(up)
    state = dataclasses.replace(
        navigated.state, latitude=nothing, heading=nothing + 0.5 * jnp.pi
    )
    return Navigated(with_velocity(state, east, nothing, up), navigated.tilt)


def rate_in_equator(rate: Navigated) -> Navigated:
    """The rate of a navigation that `in_equator` has returned, which stays in the plane."""
    nothing = jnp.zeros_like(rate.state.altitude)
    state = dataclasses.replace(rate.state, latitude=nothing, heading=nothing)
    return Navigated(state, rate.tilt)


def difference(
    planet: Planet, state: EntryState, navigated: Navigated
) -> KnowledgeError:
    """The knowledge error of a navigation at a state: the inverse of `displaced`."""
    believed, tilt = navigated.state, navigated.tilt
    radius = planet.radius + state.altitude
    _, cos_latitude = sincos(state.latitude)
    east, north, up = local_velocity(state)
    seen_east, seen_north, seen_up = local_velocity(believed)
    turn = believed.longitude - state.longitude
    turn = turn - 2.0 * jnp.pi * jnp.round(turn / (2.0 * jnp.pi))
    tilt_east, tilt_north, tilt_up = LocalAxes.of(state).from_planet(*tilt)
    return KnowledgeError(
        east=turn * (radius * cos_latitude),
        north=(believed.latitude - state.latitude) * radius,
        up=believed.altitude - state.altitude,
        velocity_east=seen_east - east,
        velocity_north=seen_north - north,
        velocity_up=seen_up - up,
        tilt_east=tilt_east,
        tilt_north=tilt_north,
        tilt_up=tilt_up,
    )


def track_difference(
    planet: Planet, state: EntryState, believed: EntryState
) -> TrackError:
    """The error of what a vehicle at a state believes, along and across its track."""
    downrange, crossrange = ground_track(planet, state, believed)
    return TrackError(
        downrange,
        crossrange,
        believed.altitude - state.altitude,
        believed.velocity - state.velocity,
    )


def local_velocity(state: EntryState) -> Components:
    """Velocity to the east, to the north and up, m/s."""
    nothing = jnp.zeros_like(state.velocity)
    return VelocityAxes.of(state).to_local(state.velocity, nothing, nothing)


def with_velocity(
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


def added(a: Components, b: Components) -> Components:
    """Sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
