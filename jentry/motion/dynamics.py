"""Equations of motion of a point mass over a rotating planet."""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .._math import sincos
from ..fields import Flag, Scalar
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .axes import SineCosine
from .forces import aerodynamic_acceleration
from .singularities import (
    SingularPoint,
    at_poles,
    at_rest,
    at_vertical_flight,
    step_is_too_long,
)
from .state import Controls, EntryState
from .vectors import VectorState, vector_rates


Motion = EntryState | VectorState
"""Position and velocity in the coordinates in which a flight integrates them, or their time
derivative"""

Y = TypeVar("Y", bound=PyTree)


class AbstractDynamics(eqx.Module):
    """The equations of motion of a scenario, with their singular points.

    Your own class defines the rates, and overrides the two constants below if they
    differ.
    """

    constant: ClassVar[Mapping[str, float]] = {}
    """Components of the state that never change, with the value that each must have at the
    start"""

    singular_points: ClassVar[tuple[SingularPoint, ...]] = (
        at_rest,
        at_vertical_flight,
        at_poles,
    )
    """Points where the equations are singular: see `jentry.motion.singularities`"""

    @abstractmethod
    def rates(
        self, planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
    ) -> EntryState:
        """Time derivative of the state."""

    def integrated(self, state: EntryState) -> Motion:
        """What a flight integrates, in a state: the state itself by default."""
        return state

    def motion_rates(
        self, planet: Planet, vehicle: Vehicle, motion: Any, controls: Controls
    ) -> Motion:
        """Time derivative of what a flight integrates: `rates` by default."""
        return self.rates(planet, vehicle, motion, controls)

    @property
    def has_crossrange(self) -> bool:
        """Whether a flight can leave the great circle on which it starts."""
        return "heading" not in self.constant

    def is_singular(self, before: EntryState, after: EntryState) -> Flag:
        """Whether a step between two states comes too close to a singular point."""
        return step_is_too_long(before, after, self.singular_points)

    def is_beyond(self, state: EntryState) -> Flag:
        """Whether a flight has passed over a singular point, which adaptive steps can
        miss."""
        return self.is_singular(state, state)


class EntryDynamics(AbstractDynamics):
    """Three-dimensional entry over a rotating planet: `entry_dynamics`."""

    def rates(
        self, planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
    ) -> EntryState:
        return entry_dynamics(planet, vehicle, state, controls)


class VectorDynamics(AbstractDynamics):
    """Three-dimensional entry over a rotating planet, without singular points.

    The motion is that of `EntryDynamics`, integrated as vectors of position and velocity:
    see `vector_rates`. A flight may pass over a pole, through the vertical and through
    rest, and may start there. Laws, ends, constraints and results read an `EntryState`,
    which is computed from the vectors. A flight takes longer than with `EntryDynamics`.

    At a pole the longitude, and in the vertical the heading, are those of the step before.
    A wind towards east or north has no direction at a pole, and jumps there.
    """

    singular_points = ()

    def rates(
        self, planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
    ) -> EntryState:
        motion = VectorState.of(state)
        rates = vector_rates(planet, vehicle, motion, controls)
        _, rate = jax.jvp(lambda m: m.entry_state, (motion,), (rates,))
        return rate

    def integrated(self, state: EntryState) -> Motion:
        return VectorState.of(state)

    def motion_rates(
        self, planet: Planet, vehicle: Vehicle, motion: Any, controls: Controls
    ) -> Motion:
        return vector_rates(planet, vehicle, motion, controls)


class EquatorialDynamics(AbstractDynamics):
    """Flight due east in the plane of the equator: `equatorial_dynamics`.

    The lateral component of lift is left out. The only singular point is at rest. Gravity
    may have zonal harmonics of even degree; others are refused.
    """

    constant = {"latitude": 0.0, "heading": 0.5 * math.pi}
    singular_points = (at_rest,)

    def rates(
        self, planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
    ) -> EntryState:
        return equatorial_dynamics(planet, vehicle, state, controls)


def entry_dynamics(
    planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
) -> EntryState:
    """Time derivative of the state.

    Reference: N. X. Vinh, A. Busemann, R. D. Culp, *Hypersonic and Planetary Entry
    Flight Mechanics*, 1980, chapter 2, with the heading counted from north.
    """
    force = aerodynamic_acceleration(planet, vehicle, state, controls)
    return rates_under(planet, state, *force, rotation_rate=planet.rotation_rate)


def rates_under(
    planet: Planet,
    state: EntryState,
    along: Scalar,
    above: Scalar | None = None,
    right: Scalar | None = None,
    rotation_rate: Scalar | None = None,
    heading: SineCosine | None = None,
    latitude: SineCosine | None = None,
) -> EntryState:
    """Time derivative of the state under gravity and a specific force, m/s2.

    **Arguments:**

    - `along`, `above`, `right`: components of the force with respect to the velocity, as
      in `aerodynamic_acceleration`. A component of None costs nothing; a zero would.
    - `rotation_rate`: rotation rate of the planet, rad/s. With None the planet is at rest.
    - `heading`, `latitude`: sines and cosines of these angles where they are known.
    """
    sin_path, cos_path = sincos(state.flight_path_angle)
    sin_heading, cos_heading = heading or sincos(state.heading)
    sin_latitude, cos_latitude = latitude or sincos(state.latitude)
    velocity = state.velocity
    radius = planet.radius + state.altitude
    # One division by each quantity, then products: these are eight times as fast.
    per_velocity = 1.0 / velocity
    gravity, north = planet.gravity.components(radius, state.latitude)
    ground_rate = velocity * cos_path * (1.0 / radius)
    turn = ground_rate * sin_heading * (1.0 / cos_latitude)

    along = along - gravity * sin_path
    above = -gravity * cos_path if above is None else above - gravity * cos_path
    if north is not None:
        along = along + north * (cos_path * cos_heading)
        above = above - north * (sin_path * cos_heading)
        right = (0.0 if right is None else right) - north * sin_heading
    if rotation_rate is not None:
        centrifugal = rotation_rate * rotation_rate * radius * cos_latitude
        coriolis = 2.0 * rotation_rate * velocity
        along = along + centrifugal * (
            sin_path * cos_latitude - cos_path * sin_latitude * cos_heading
        )
        above = (
            above
            + coriolis * cos_latitude * sin_heading
            + centrifugal
            * (cos_path * cos_latitude + sin_path * sin_latitude * cos_heading)
        )
        right = (
            (0.0 if right is None else right)
            - coriolis
            * (sin_path * cos_latitude * cos_heading - cos_path * sin_latitude)
            + centrifugal * sin_latitude * sin_heading
        )
    turning = turn * sin_latitude
    if right is not None:
        turning = right * (per_velocity * (1.0 / cos_path)) + turning
    return EntryState(
        altitude=velocity * sin_path,
        longitude=turn,
        latitude=ground_rate * cos_heading,
        velocity=along,
        flight_path_angle=above * per_velocity + ground_rate,
        heading=turning,
    )


def equatorial_dynamics(
    planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
) -> EntryState:
    """Time derivative of the state in the plane of the equator, flying due east.

    This is `entry_dynamics` at latitude 0 and heading 90 degrees without the lateral
    forces, so that latitude and heading are constant. It is half the work. Over a sphere at
    rest, coordinates can be chosen so that any flight in a plane has this form.
    """
    sin_path, cos_path = sincos(state.flight_path_angle)
    velocity = state.velocity
    radius = planet.radius + state.altitude
    along, above, _ = aerodynamic_acceleration(planet, vehicle, state, controls)
    rotation = planet.rotation_rate
    weight = planet.gravity.in_equator(radius) - rotation * rotation * radius
    ground_rate = velocity * cos_path * (1.0 / radius)
    none = jnp.zeros_like(velocity)
    return EntryState(
        altitude=velocity * sin_path,
        longitude=ground_rate,
        latitude=none,
        velocity=along - weight * sin_path,
        flight_path_angle=(above - weight * cos_path) * (1.0 / velocity)
        + 2.0 * rotation
        + ground_rate,
        heading=none,
    )


def require_angles(dynamics: AbstractDynamics, state: EntryState, what: str) -> None:
    """Refuse dynamics that integrate something else than an `EntryState`.

    `what` says what is done with the angles, for the message of the `ValueError`.
    """
    if not isinstance(dynamics.integrated(state), EntryState):
        raise ValueError(
            f"dynamics is {type(dynamics).__name__}, and {what}: take "
            "dynamics=EntryDynamics()"
        )


def with_respect_to(
    flow: Callable[[Y], Y], quantity: Callable[[Y], Scalar]
) -> Callable[[Y], Y]:
    """Rates of the motion over a variable other than time: energy, velocity, ...

    `flow(state)` is the time derivative. The result divides it by the rate of
    `quantity(state)`, and is singular where that rate is zero.

        over_energy = with_respect_to(flow, lambda state: energy(planet, state))
    """

    def rate_form(state: Y) -> Y:
        rates = flow(state)
        _, rate = jax.jvp(quantity, (state,), (rates,))
        return jax.tree.map(lambda x: x / rate, rates)

    return rate_form
