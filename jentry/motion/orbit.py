"""Orbits: the conic of a state without air, and the burns from it to a target orbit."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from .._math import safe_arccos, safe_sqrt, sincos
from .._printed import as_text
from ..fields import NOT_NEGATIVE, Flag, Scalar, optional_scalar, output, scalar
from ..units import km
from ..world.gravity import InverseSquareGravity
from ..world.planet import Planet
from .state import EntryState


_HALF_TURN = 0.0, jnp.pi


class InertialVelocity(NamedTuple):
    """Velocity in axes that do not rotate with the planet, by its components, m/s."""

    up: Scalar
    north: Scalar
    east: Scalar

    @property
    def level(self) -> Scalar:
        """Horizontal component, m/s."""
        return safe_sqrt(self.north * self.north + self.east * self.east)

    @property
    def speed(self) -> Scalar:
        """Magnitude, m/s."""
        return safe_sqrt(self.up * self.up + self.level * self.level)


class Orbit(eqx.Module):
    """The orbit on which a vehicle moves without air, ellipse or hyperbola.

    Altitudes are above the sphere of the planet.
    """

    semi_major_axis: Scalar = output(unit="m")
    """Negative for a hyperbola, and infinite for a parabola"""
    eccentricity: Scalar = output(unit="1")
    inclination: Scalar = output(unit="rad")
    """Angle between the orbital plane and the equator, from 0 to pi"""
    periapsis_altitude: Scalar = output(unit="m")
    apoapsis_altitude: Scalar = output(unit="m")
    """Infinite, with derivative zero, if the orbit is not bound"""
    inverse_apoapsis_radius: Scalar = output(unit="1/m")
    """Reciprocal of the distance of the apoapsis from the centre of the planet. It falls
    smoothly through zero where the orbit ceases to be bound"""
    energy: Scalar = output(unit="J/kg")
    """Inertial energy per unit mass; negative if the orbit is bound"""

    @property
    def is_bound(self) -> Flag:
        """Whether the orbit is an ellipse."""
        return self.energy < 0.0


class OrbitTarget(eqx.Module):
    """The orbit that an aerocapture should reach, as the target of a scenario.

    Misses of such a scenario are those of the orbit after the exit: see `Misses`.
    """

    apoapsis_altitude: Scalar = scalar(unit="m", range=NOT_NEGATIVE)
    periapsis_altitude: Scalar = scalar(unit="m", range=NOT_NEGATIVE)
    inclination: Scalar | None = optional_scalar(unit="rad", range=_HALF_TURN)
    """Desired inclination; None if there is none"""

    __str__ = as_text

    def __check_init__(self):
        apses = self.apoapsis_altitude, self.periapsis_altitude
        if any(isinstance(x, Tracer) or np.ndim(x) for x in apses):
            return
        high, low = map(float, apses)
        if high < low:
            raise ValueError(
                f"apoapsis_altitude is {high / km:g} km and periapsis_altitude "
                f"{low / km:g} km: the apoapsis must not be below the periapsis"
            )

    @property
    def origin(self) -> None:
        """There is no place from which a range is counted."""
        return None

    @property
    def counted_from(self) -> str:
        """Text that describes from what downrange and crossrange count."""
        return "not counted, since the target is an orbit"


class Burns(NamedTuple):
    """Velocity increments of impulsive burns from an orbit to a target orbit, m/s.

    Each is a magnitude. It is infinite if the orbit is not bound.
    """

    periapsis_raise: Scalar
    """At the apoapsis, from the periapsis of the orbit to that of the target"""
    apoapsis_correction: Scalar
    """At the periapsis of the target, from the apoapsis of the orbit to that of the
    target; zero if the apoapsis is met, so that one burn is enough"""
    plane_change: Scalar
    """At the apoapsis of the target, by the error of the inclination, as if it were at a
    node; zero if the target has no inclination"""

    @property
    def total(self) -> Scalar:
        """Sum of the burns, m/s."""
        return self.periapsis_raise + self.apoapsis_correction + self.plane_change


def gravitational_parameter(planet: Planet) -> Scalar:
    """Gravitational parameter of a planet, m3/s2.

    **Raises:** `ValueError` for a gravity that does not follow the inverse square law,
    under which a flight without air is no conic.
    """
    gravity = planet.gravity
    if not isinstance(gravity, InverseSquareGravity):
        raise ValueError(
            f"gravity is {type(gravity).__name__}: orbits are those of an inverse square "
            "law; take InverseSquareGravity(gravitational_parameter)"
        )
    return gravity.gravitational_parameter


def inertial_velocity(planet: Planet, state: EntryState) -> InertialVelocity:
    """Inertial velocity of a state, whose velocity is relative to the rotating planet."""
    sin_path, cos_path = sincos(state.flight_path_angle)
    sin_heading, cos_heading = sincos(state.heading)
    _, cos_latitude = sincos(state.latitude)
    level = state.velocity * cos_path
    carried = planet.rotation_rate * (planet.radius + state.altitude) * cos_latitude
    return InertialVelocity(
        up=state.velocity * sin_path,
        north=level * cos_heading,
        east=level * sin_heading + carried,
    )


def orbit_of(planet: Planet, state: EntryState) -> Orbit:
    """The orbit of a state, about a planet that may rotate.

    **Raises:** `ValueError` for a gravity that does not follow the inverse square law.
    """
    parameter = gravitational_parameter(planet)
    radius = planet.radius + state.altitude
    velocity = inertial_velocity(planet, state)
    momentum = radius * velocity.level
    latus = momentum * momentum / parameter
    # The eccentricity vector, towards the vehicle and against the motion.
    towards, across = latus / radius - 1.0, momentum * velocity.up / parameter
    eccentricity = safe_sqrt(towards * towards + across * across)
    energy = 0.5 * velocity.speed * velocity.speed - parameter / radius
    bound = energy < 0.0
    parabola = energy == 0.0
    # In place of latus / (1 - e^2), which loses digits near a parabola.
    axis = -0.5 * parameter / jnp.where(parabola, 1.0, energy)
    # 1 - e = (1 - e^2) / (1 + e), with 1 - e^2 = -2 energy latus / parameter.
    inverse = -2.0 * energy / (parameter * (1.0 + eccentricity))
    apoapsis = 1.0 / jnp.where(bound, inverse, 1.0) - planet.radius
    _, cos_latitude = sincos(state.latitude)
    level = jnp.where(velocity.level > 0.0, velocity.level, 1.0)
    return Orbit(
        semi_major_axis=jnp.where(parabola, jnp.inf, axis),
        eccentricity=eccentricity,
        inclination=safe_arccos(cos_latitude * velocity.east / level),
        periapsis_altitude=latus / (1.0 + eccentricity) - planet.radius,
        apoapsis_altitude=jnp.where(bound, apoapsis, jnp.inf),
        inverse_apoapsis_radius=inverse,
        energy=energy,
    )


def burns_to(planet: Planet, orbit: Orbit, target: OrbitTarget) -> Burns:
    """Burns from an orbit after an aerocapture to its target orbit.

    The first burn, at the apoapsis, raises the periapsis. The second one, at the new
    periapsis, corrects the apoapsis. A change of the plane is a burn of its own.

    Reference: P. Lu, C. Cerimele, M. Tigges, D. Matz, "Optimal Aerocapture Guidance",
    Journal of Guidance, Control, and Dynamics 38(4), 2015, for the two burns.
    """
    parameter = gravitational_parameter(planet)
    bound = orbit.is_bound
    # On both sides of the selection, so that no derivative comes from a hyperbola.
    high = jnp.where(bound, orbit.apoapsis_altitude, target.apoapsis_altitude)
    low = jnp.where(bound, orbit.periapsis_altitude, target.periapsis_altitude)
    high, low, highest, lowest = (
        planet.radius + x
        for x in (high, low, target.apoapsis_altitude, target.periapsis_altitude)
    )

    def speed(at: Scalar, other: Scalar) -> Scalar:
        """Speed at one apsis of an orbit with another apsis."""
        return safe_sqrt(2.0 * parameter * other / (at * (at + other)))

    raised = jnp.abs(speed(high, lowest) - speed(high, low))
    corrected = jnp.abs(speed(lowest, highest) - speed(lowest, high))
    turned = jnp.zeros_like(raised)
    if target.inclination is not None:
        half, _ = sincos(0.5 * (orbit.inclination - target.inclination))
        turned = 2.0 * speed(highest, lowest) * jnp.abs(half)
    found = (jnp.where(bound, x, jnp.inf) for x in (raised, corrected, turned))
    return Burns(*found)
