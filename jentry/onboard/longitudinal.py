"""The motion in the vertical plane, a reference flight in that plane, and its linear
model."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._collocation import interpolate
from .._interpolation import interval
from .._math import sincos
from ..fields import Count, Scalar, Vector, scalar, table
from ..motion.dynamics import rates_under
from ..motion.quantities import ground_track
from ..motion.state import EntryState
from ..world.planet import Planet
from .measurement import measure
from .model import OnboardModel, require_sphere, require_still_air
from .profiles import AbstractProfile


EAST = 0.5 * jnp.pi


class LongitudinalState(eqx.Module):
    """Longitudinal state of a vehicle, or its rates."""

    altitude: Scalar = scalar(unit="m")
    velocity: Scalar = scalar(unit="m/s")
    flight_path_angle: Scalar = scalar(unit="rad")
    downrange: Scalar = scalar(0.0, unit="m")
    """Arc on the surface"""

    @classmethod
    def of(
        cls, planet: Planet, state: EntryState, origin: EntryState | None = None
    ) -> "LongitudinalState":
        """State of a flight; the downrange is from an origin (`ground_track`) or zero."""
        downrange = jnp.zeros_like(state.altitude)
        if origin is not None:
            downrange, _ = ground_track(planet, origin, state)
        return cls(state.altitude, state.velocity, state.flight_path_angle, downrange)

    def eastward(self) -> EntryState:
        """This state on the equator to the east, at longitude zero."""
        nothing = jnp.zeros_like(self.altitude)
        return EntryState(
            self.altitude,
            nothing,
            nothing,
            self.velocity,
            self.flight_path_angle,
            EAST + nothing,
        )


def along_equator(
    model: OnboardModel, state: EntryState
) -> tuple[OnboardModel, EntryState]:
    """Model and state of an equatorial flight in place of one along the great circle.

    The flight starts at longitude zero. The planet of the model has only that component of
    its rotation which is about the axis of the present great circle. The rest of the
    rotation, and a part of the centrifugal acceleration (0.02 m/s2 for the Earth), act to
    the side; bank reversals compensate for them.
    """
    require_sphere(
        model.planet, "a prediction in the vertical plane", ", or take in_space=True"
    )
    share = sincos(state.latitude)[1] * sincos(state.heading)[0]
    turned = eqx.tree_at(
        lambda m: m.planet.rotation_rate, model, model.planet.rotation_rate * share
    )
    return turned, LongitudinalState.of(model.planet, state).eastward()


class LongitudinalModel(eqx.Module):
    """The onboard motion in the vertical plane, over a planet at rest.

    The angle of attack is scheduled. The control is the upward lift, in units of the drag.
    """

    onboard: OnboardModel
    angle_of_attack: AbstractProfile
    """rad, over the velocity in m/s"""

    def lift_to_drag(self, state: LongitudinalState) -> Scalar:
        """Lift-to-drag ratio, the largest value of the upward one."""
        angle = self.angle_of_attack(state.velocity)
        return self.onboard.lift_to_drag(self._here(state), angle)

    def rates(
        self, state: LongitudinalState, lift_to_drag_up: Scalar
    ) -> LongitudinalState:
        """Equations (1) to (3) and (10), the last corrected by the factor r_E / r."""
        planet, here = self.onboard.planet, self._here(state)
        angle = self.angle_of_attack(state.velocity)
        drag = measure(planet, self.onboard.vehicle, here, angle).drag
        rates = rates_under(planet, here, -drag, lift_to_drag_up * drag)
        return LongitudinalState(
            rates.altitude,
            rates.velocity,
            rates.flight_path_angle,
            planet.radius * rates.longitude,
        )

    def _here(self, state: LongitudinalState) -> EntryState:
        """The state to the east; a wind would not be that of the actual heading."""
        require_still_air(self.onboard.planet, "the motion in the vertical plane")
        require_sphere(self.onboard.planet, "the motion in the vertical plane")
        return state.eastward()


class Units(eqx.Module):
    """Units in which the longitudinal motion has no dimensions."""

    length: Scalar
    """Radius of the planet, m"""
    time: Scalar
    """Square root of the radius over the gravity at the surface, s"""

    @classmethod
    def of(cls, planet: Planet) -> "Units":
        require_sphere(planet, "the motion in the vertical plane")
        gravity = planet.gravity.acceleration(planet.radius)
        return cls(planet.radius, jnp.sqrt(planet.radius / gravity))

    def vector(self, state: LongitudinalState) -> Float[Array, " 4"]:
        """Altitude, velocity, path angle and downrange without dimensions."""
        return jnp.stack(jax.tree.leaves(state)) / self._sizes

    def state(self, vector: Float[Array, " 4"]) -> LongitudinalState:
        return LongitudinalState(*(vector * self._sizes))

    @property
    def _sizes(self) -> Float[Array, " 4"]:
        one = jnp.ones_like(self.length)
        return jnp.stack([self.length, self.length / self.time, one, self.length])


def linearized(
    model: LongitudinalModel, state: LongitudinalState, lift_to_drag_up: Scalar
) -> tuple[Float[Array, "4 4"], Float[Array, "4 1"]]:
    """A and B of (24), without dimensions (`Units`), by forward differentiation.

    The control is independent of the state, and the drag has the slope of its coefficient
    over the velocity.
    """
    units = Units.of(model.onboard.planet)

    def rates(state: Vector, control: Scalar) -> Vector:
        return units.time * units.vector(model.rates(units.state(state), control))

    a, b = jax.jacfwd(rates, (0, 1))(units.vector(state), lift_to_drag_up)
    return a, b[:, None]


class ReferencePoint(eqx.Module):
    """State and control of the reference at a time."""

    state: LongitudinalState
    lift_to_drag_up: Scalar


class LongitudinalReference(eqx.Module):
    """A reference flight in the vertical plane over the time, in parts.

    The control may jump between parts. In each part the reference is a polynomial through
    the values at Legendre-Gauss-Lobatto nodes. Before the start and after the end it is
    constant.
    """

    ends: Vector = table(unit="s", increasing=True)
    """Ends of the parts, shape (parts + 1,)"""
    altitude: Float[Array, "parts nodes"] = table(unit="m")
    velocity: Float[Array, "parts nodes"] = table(unit="m/s")
    flight_path_angle: Float[Array, "parts nodes"] = table(unit="rad")
    downrange: Float[Array, "parts nodes"] = table(unit="m")
    lift_to_drag_up: Float[Array, "parts nodes"] = table()

    def __check_init__(self):
        parts = self.ends.shape[0] - 1
        for name in _COLUMNS:
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape != self.altitude.shape or shape[0] != parts:
                raise ValueError(
                    f"{name} has shape {shape}: expected (parts, nodes), the same of all, "
                    f"and ends, of shape {self.ends.shape}, has one more than there are "
                    "parts"
                )

    def part(self, time: Scalar) -> Count:
        """Number of the part at a time (s), from 0."""
        return interval(self.ends, time)

    def in_part(self, part: Count, time: Scalar) -> ReferencePoint:
        """Reference at a time (s) in a part; at the ends the values of this part."""
        x = on_nodes(self.ends[part], self.ends[part + 1], time)
        values = jnp.stack([getattr(self, name)[part] for name in _COLUMNS])
        *state, control = jnp.asarray(jax.vmap(interpolate, (0, None))(values, x))
        return ReferencePoint(LongitudinalState(*state), control)

    def at(self, time: Scalar) -> ReferencePoint:
        """Reference at a time, s."""
        return self.in_part(self.part(time), time)

    @property
    def end(self) -> LongitudinalState:
        """The last state."""
        return LongitudinalState(*(getattr(self, name)[-1, -1] for name in _STATE))


_STATE = tuple(field.name for field in dataclasses.fields(LongitudinalState))
_COLUMNS = (*_STATE, "lift_to_drag_up")


def on_nodes(start: Scalar, end: Scalar, time: Scalar) -> Scalar:
    """A time between two others as a place from -1 to 1; -1 if the two are equal."""
    length = end - start
    there = length > 0.0
    x = 2.0 * (time - start) / jnp.where(there, length, 1.0) - 1.0
    # Not `clip`, which at the ends has half of the derivative.
    return jnp.where(there, jnp.where(jnp.abs(x) <= 1.0, x, jnp.sign(x)), -1.0)
