"""Sensors that aid inertial navigation: altimeter, terrain, Doppler, drag and flow."""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ..fields import NOT_NEGATIVE, Flag, Scalar, as_float_array, optional_scalar, scalar
from ..motion.axes import Components, LocalAxes
from ..motion.forces import air_data
from ..motion.state import EntryState
from ..world.planet import Planet
from .inertial import BodyAxes, Sensed, local_velocity
from .measurement import BodyAccelerometers
from .model import OnboardModel, require_still_air


Values = tuple[Scalar, ...]

Drawn = Callable[[int], Scalar]
"""Independent standard normal numbers by their axis, from 0"""

MOST_VALUES = 3
"""Largest number of values of one sensor"""


class Believed(NamedTuple):
    """What the vehicle believes when a sensor measures."""

    planet: Planet
    """Its radius is known; air and wind are not read from it"""
    state: EntryState
    axes: BodyAxes
    """Axes of the vehicle"""
    accelerometers: BodyAccelerometers
    """Estimated errors"""
    angle_of_attack: Scalar
    """Measured, rad"""


class AbstractNavigationSensor(eqx.Module):
    """A sensor whose measurements correct the navigation.

    Your own one states what it measures (`measured`), what the vehicle expects it to
    measure (`expected`), and the standard deviations of the difference (`deviations`): each
    a tuple of up to three numbers. Derivatives of `expected` are taken by JAX.
    """

    cycle: float = eqx.field(default=math.nan, static=True, kw_only=True)
    """Time from one measurement to the next, s: a multiple of the cycle of the filter"""
    gate: Scalar = eqx.field(
        default=5.0,
        kw_only=True,
        converter=as_float_array,
        metadata={"unit": "1", "positive": True, "range": None},
    )
    """A measurement is rejected if it is farther from the expected one than so many of the
    standard deviations of their difference"""

    def __check_init__(self):
        if not 0.0 < self.cycle < math.inf:
            raise ValueError(
                f"cycle of the {type(self).__name__} is {self.cycle} s: give the time from "
                f"one measurement to the next, such as {type(self).__name__}(..., "
                "cycle=1.0)"
            )

    @abstractmethod
    def senses(self, sensed: Sensed) -> Flag:
        """Whether the sensor measures in the actual flight."""

    @abstractmethod
    def measured(self, sensed: Sensed, drawn: Drawn, at: Scalar) -> Values:
        """The measurement in the actual flight at a time, s."""

    @abstractmethod
    def expected(self, believed: Believed) -> Values:
        """The measurement that the vehicle expects."""

    @abstractmethod
    def deviations(self, believed: Believed) -> Values:
        """Standard deviations of the measurement that the filter assumes."""


def _altitude(sensed: Sensed) -> Scalar:
    """Actual altitude, m; the geodetic one on an ellipsoid."""
    state = sensed.actual.state
    return sensed.actual.planet.geodetic_altitude(state.altitude, state.latitude)


def _assumed(noise: Scalar, assumed: Scalar | None) -> Scalar:
    return noise if assumed is None else assumed


class Altimeter(AbstractNavigationSensor):
    """Measures the altitude, below an altitude: on an ellipsoid the geodetic one."""

    noise: Scalar = scalar(unit="m", range=NOT_NEGATIVE)
    """Standard deviation of a measurement"""
    largest_altitude: Scalar = scalar(unit="m")
    """Altitude above which nothing is measured"""
    bias: Scalar = scalar(0.0, unit="m")
    """Measured minus actual altitude, such as that of the terrain. The filter does not
    know of it"""
    assumed: Scalar | None = optional_scalar(unit="m", range=NOT_NEGATIVE)
    """Standard deviation that the filter assumes; None for `noise`"""

    def senses(self, sensed: Sensed) -> Flag:
        return _altitude(sensed) <= self.largest_altitude

    def measured(self, sensed: Sensed, drawn: Drawn, at: Scalar) -> Values:
        return (_altitude(sensed) + self.bias + self.noise * drawn(0),)

    def expected(self, believed: Believed) -> Values:
        state = believed.state
        return (believed.planet.geodetic_altitude(state.altitude, state.latitude),)

    def deviations(self, believed: Believed) -> Values:
        return (_assumed(self.noise, self.assumed),)


class TerrainPosition(AbstractNavigationSensor):
    """Measures longitude and latitude by comparing images of the terrain with a map.

    The error of the attitude is not part of its measurement.
    """

    noise: Scalar = scalar(unit="m", range=NOT_NEGATIVE)
    """Standard deviation of each component over the ground"""
    largest_altitude: Scalar = scalar(unit="m")
    """Altitude above which nothing is measured"""
    bias_east: Scalar = scalar(0.0, unit="m")
    """Error of the map: measured minus actual place. The filter does not know of it"""
    bias_north: Scalar = scalar(0.0, unit="m")
    assumed: Scalar | None = optional_scalar(unit="m", range=NOT_NEGATIVE)
    """Standard deviation that the filter assumes; None for `noise`"""

    def senses(self, sensed: Sensed) -> Flag:
        return _altitude(sensed) <= self.largest_altitude

    def measured(self, sensed: Sensed, drawn: Drawn, at: Scalar) -> Values:
        state, radius = sensed.actual.state, sensed.actual.planet.radius
        east = self.bias_east + self.noise * drawn(0)
        north = self.bias_north + self.noise * drawn(1)
        return (
            state.longitude + east / (radius * sensed.place.cos_latitude),
            state.latitude + north / radius,
        )

    def expected(self, believed: Believed) -> Values:
        return believed.state.longitude, believed.state.latitude

    def deviations(self, believed: Believed) -> Values:
        noise = _assumed(self.noise, self.assumed) / believed.planet.radius
        return noise / jnp.cos(believed.state.latitude), noise


class DopplerVelocity(AbstractNavigationSensor):
    """Measures the velocity over the ground in axes of the vehicle."""

    noise: Scalar = scalar(unit="m/s", range=NOT_NEGATIVE)
    """Standard deviation of each component"""
    largest_altitude: Scalar = scalar(unit="m")
    """Altitude above which nothing is measured"""
    scale_error: Scalar = scalar(0.0)
    """Share of the velocity. The filter does not know of it"""
    assumed: Scalar | None = optional_scalar(unit="m/s", range=NOT_NEGATIVE)
    """Standard deviation that the filter assumes; None for `noise`"""

    def senses(self, sensed: Sensed) -> Flag:
        return _altitude(sensed) <= self.largest_altitude

    def measured(self, sensed: Sensed, drawn: Drawn, at: Scalar) -> Values:
        speed = sensed.actual.state.velocity, *2 * [jnp.zeros_like(sensed.air.airspeed)]
        velocity = sensed.place.to_planet(*sensed.velocity.to_local(*speed))
        scale = 1.0 + self.scale_error
        return tuple(
            scale * v + self.noise * drawn(axis)
            for axis, v in enumerate(sensed.body_axes().of_vector(velocity))
        )

    def expected(self, believed: Believed) -> Values:
        return _velocity_in_body(believed)

    def deviations(self, believed: Believed) -> Values:
        return 3 * (_assumed(self.noise, self.assumed),)


def _velocity_in_body(believed: Believed) -> Components:
    velocity = local_velocity(believed.state)
    in_planet = LocalAxes.of(believed.state).to_planet(*velocity)
    return believed.axes.of_vector(in_planet)


class DragAltitude(AbstractNavigationSensor):
    """Drag as a measurement of the altitude, by the density of an onboard model.

    It measures the logarithm of the sensed drag. Errors of the density are alike from one
    measurement to the next, and the filter assumes that they are independent: in air whose
    density is not that of the model it believes too much of its altitude.

    The Space Shuttle was navigated so before it received any radio signal: NASA CR-141765,
    1974.
    """

    model: OnboardModel
    """Planet, with its atmosphere and without wind, and vehicle as known on board"""
    noise: Scalar = scalar(range=NOT_NEGATIVE)
    """Standard deviation of a measurement, as a share of the drag"""
    least_drag: Scalar = scalar(unit="m/s2", positive=True)
    """Sensed drag below which nothing is measured"""
    assumed: Scalar | None = optional_scalar(range=NOT_NEGATIVE)
    """Share that the filter assumes, with its doubt of the density; None for `noise`"""

    def __check_init__(self):
        require_still_air(self.model.planet, "the altitude from drag")

    def senses(self, sensed: Sensed) -> Flag:
        return sensed.force.drag >= self.least_drag

    def measured(self, sensed: Sensed, drawn: Drawn, at: Scalar) -> Values:
        drag = jnp.where(self.senses(sensed), sensed.force.drag, self.least_drag)
        return (jnp.log(drag) + self.noise * drawn(0),)

    def expected(self, believed: Believed) -> Values:
        planet, vehicle = self.model.planet, self.model.vehicle
        angle = believed.angle_of_attack
        air = air_data(planet, vehicle, believed.state, angle)
        drag = believed.accelerometers.read(air, None).drag
        # Where the errors exceed the drag nothing is measured.
        return (jnp.log(jnp.maximum(drag, 0.5 * air.drag)),)

    def deviations(self, believed: Believed) -> Values:
        return (_assumed(self.noise, self.assumed),)


class FlowVelocity(AbstractNavigationSensor):
    """Velocity over the air, by the flow sensors of the scenario.

    The vehicle takes the air to be still: what it does not know of the wind is part of
    `assumed`.
    """

    assumed: Scalar = scalar(unit="m/s", positive=True)
    """Standard deviation of each component that the filter assumes, with that of the
    wind"""

    def senses(self, sensed: Sensed) -> Flag:
        flow = self._read(sensed, jnp.zeros_like(sensed.air.airspeed))
        return jnp.asarray(flow.is_sensed)

    def measured(self, sensed: Sensed, drawn: Drawn, at: Scalar) -> Values:
        flow = self._read(sensed, at)
        in_planet = sensed.place.to_planet(flow.east, flow.north, flow.up)
        return sensed.body_axes().of_vector(in_planet)

    def expected(self, believed: Believed) -> Values:
        return _velocity_in_body(believed)

    def deviations(self, believed: Believed) -> Values:
        return 3 * (self.assumed,)

    def _read(self, sensed: Sensed, at: Scalar):
        actual = sensed.actual
        if actual.flow_sensors is None:
            raise ValueError(
                "navigation.filter.sensors has a FlowVelocity, and the scenario no flow "
                "sensors: give it flow_sensors=FlowSensors()"
            )
        return actual.flow_sensors.read(actual.planet, actual.state, sensed.air, at)
