"""By how much a flight missed its target."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._printed import as_text
from ..fields import Scalar, in_unit, output
from ..motion.quantities import ground_track
from .flight import Flight
from .scenario import Scenario


class Misses(eqx.Module):
    """Differences at the end of the flight, actual minus desired."""

    downrange: Scalar = output(unit="m")
    """Error along the entry direction; positive is too far"""
    crossrange: Scalar = output(unit="m")
    """Error across the entry direction; positive is to the left"""
    altitude: Scalar = output(unit="m")
    velocity: Scalar = output(unit="m/s")
    flight_path_angle: Scalar | None = output(unit="rad", default=None)
    """Error of the flight-path angle; None if the target has none"""
    heading: Scalar | None = output(unit="rad", default=None)
    """Error of the heading; None if the target has none"""

    __str__ = as_text

    @property
    @in_unit("m")
    def distance(self) -> Array:
        """Distance from the target, m, of one flight or of many."""
        square = sum(
            jnp.square(x) for x in (self.downrange, self.crossrange, self.altitude)
        )
        missed = square != 0.0  # NaN too, which is no hit
        return jnp.where(missed, jnp.sqrt(jnp.where(missed, square, 1.0)), 0.0)


def misses(scenario: Scenario, flight: Flight) -> Misses:
    """Misses of a flight of this scenario, along and across its entry direction.

    Downrange and heading are counted the nearer way around. Those of a flight that does
    not have an end (`has_end(flight.outcome)`) say nothing.
    """
    target, end = scenario.target, flight.state
    downrange, crossrange = ground_track(scenario.planet, scenario.initial_state, end)
    circumference = 2.0 * jnp.pi * scenario.planet.radius
    return Misses(
        downrange=_nearest(downrange - target.downrange, circumference),
        crossrange=crossrange - target.crossrange,
        altitude=end.altitude - target.altitude,
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
