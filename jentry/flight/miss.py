"""Errors of a flight with respect to its target."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._printed import as_text
from ..fields import Scalar, in_unit, output
from ..motion.orbit import OrbitTarget, burns_to, orbit_of
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from .flight import Flight
from .scenario import Scenario, Target


if TYPE_CHECKING:  # a program that reads a place has a scenario that flies to one
    OfPlace = Any
else:
    OfPlace = Scalar | None


class Misses(eqx.Module):
    """Errors at the end of the flight, actual minus desired.

    If the target of the scenario is an orbit, they are those of the orbit after the exit,
    and the errors of place and speed are None.

    Those of `believed_misses` are believed minus desired, and those of `navigation_errors`
    believed minus actual.
    """

    downrange: OfPlace = output(unit="m")
    """Error along the entry direction; positive is too far"""
    crossrange: OfPlace = output(unit="m")
    """Error across the entry direction; positive is to the left"""
    altitude: OfPlace = output(unit="m")
    velocity: OfPlace = output(unit="m/s")
    flight_path_angle: Scalar | None = output(unit="rad", default=None)
    """Error of the flight-path angle; None if the target has none"""
    heading: Scalar | None = output(unit="rad", default=None)
    """Error of the heading; None if the target has none"""
    apoapsis: Scalar | None = output(unit="m", default=None)
    """Error of the altitude of the apoapsis, infinite if the orbit is not bound; None if
    the target is a place"""
    inclination: Scalar | None = output(unit="rad", default=None)
    """Error of the inclination; None if the target has none"""
    velocity_increment: Scalar | None = output(unit="m/s", default=None)
    """Sum of the burns from the orbit to that of the target, see `burns_to`; infinite if
    the orbit is not bound, and None if the target is a place"""

    __str__ = as_text

    @property
    @in_unit("m")
    def distance(self) -> Array | None:
        """Miss: distance over the ground from the target, m, of one flight or of many.

        None if the target is an orbit.
        """
        if self.downrange is None:
            return None
        square = sum(
            jnp.square(x) for x in (self.downrange, self.crossrange, self.altitude)
        )
        missed = square != 0.0  # true for NaN as well
        return jnp.where(missed, jnp.sqrt(jnp.where(missed, square, 1.0)), 0.0)


def misses(scenario: Scenario, flight: Flight) -> Misses:
    """Errors of a flight of this scenario, along and across its entry direction.

    Errors of downrange and heading are wrapped to the shorter way around. The errors of a
    flight without an end (`has_end(flight.outcome)` is false) have no meaning.
    """
    return _errors(scenario, scenario.target, flight.state)


def believed_misses(scenario: Scenario, flight: Flight) -> Misses | None:
    """Errors that the vehicle would report: `misses` of the state that it believes.

    They are believed minus desired. None with perfect navigation, where they are the
    actual ones. A target without an origin is counted from the actual start.
    """
    if flight.navigated is None:
        return None
    return _errors(scenario, scenario.target, flight.navigated)


def navigation_errors(scenario: Scenario, flight: Flight) -> Misses | None:
    """Errors of the navigation at the end of a flight, believed minus actual.

    Downrange and crossrange are along and across the entry direction, as in `misses`.
    Flight-path angle and heading do not depend on the target. None with perfect navigation.
    """
    if flight.navigated is None:
        return None
    end, target = flight.state, scenario.target
    downrange, crossrange = ground_track(scenario.planet, _origin(scenario), end)
    actual = Target(
        altitude=scenario.planet.geodetic_altitude(end.altitude, end.latitude),
        velocity=end.velocity,
        downrange=downrange,
        crossrange=crossrange,
        flight_path_angle=end.flight_path_angle,
        heading=end.heading,
        origin=target.origin,
    )
    return _errors(scenario, actual, flight.navigated)


def _origin(scenario: Scenario) -> EntryState:
    origin = scenario.target.origin
    return scenario.initial_state if origin is None else origin


def misses_towards(target: Target | OrbitTarget) -> tuple[str, ...]:
    """Names of the misses that flights to a target have."""
    if isinstance(target, OrbitTarget):
        always, optional = ("apoapsis", "velocity_increment"), ("inclination",)
    else:
        always = "distance", "downrange", "crossrange", "altitude", "velocity"
        optional = "flight_path_angle", "heading"
    stated = (name for name in optional if getattr(target, name) is not None)
    return *always, *stated


def _orbit_errors(scenario: Scenario, target: OrbitTarget, end: EntryState) -> Misses:
    """Errors of the orbit of a state with respect to a target orbit."""
    orbit = orbit_of(scenario.planet, end)
    desired = target.inclination
    return Misses(
        downrange=None,
        crossrange=None,
        altitude=None,
        velocity=None,
        apoapsis=orbit.apoapsis_altitude - target.apoapsis_altitude,
        inclination=None if desired is None else orbit.inclination - desired,
        velocity_increment=burns_to(scenario.planet, orbit, target).total,
    )


def _errors(
    scenario: Scenario, target: Target | OrbitTarget, end: EntryState
) -> Misses:
    """Errors of a state, from the origin of the scenario, with respect to a target."""
    if isinstance(target, OrbitTarget):
        return _orbit_errors(scenario, target, end)
    downrange, crossrange = ground_track(scenario.planet, _origin(scenario), end)
    circumference = 2.0 * jnp.pi * scenario.planet.radius
    return Misses(
        downrange=_nearest(downrange - target.downrange, circumference),
        crossrange=crossrange - target.crossrange,
        altitude=scenario.planet.geodetic_altitude(end.altitude, end.latitude)
        - target.altitude,
        velocity=end.velocity - target.velocity,
        flight_path_angle=_difference(end.flight_path_angle, target.flight_path_angle),
        heading=_turn(end.heading, target.heading),
    )


def _difference(actual: Scalar, desired: Scalar | None) -> Scalar | None:
    return None if desired is None else actual - desired


def _turn(actual: Scalar, desired: Scalar | None) -> Scalar | None:
    return None if desired is None else _nearest(actual - desired, 2.0 * jnp.pi)


def _nearest(difference: Scalar, period: Scalar | float) -> Scalar:
    return difference - period * jnp.round(difference / period)
