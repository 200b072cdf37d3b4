"""Equations of motion of a point mass over a rotating sphere."""

from collections.abc import Callable

import jax

from .._math import sincos
from .._types import Scalar
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .forces import aerodynamic_acceleration
from .state import Controls, EntryState


def entry_dynamics(
    planet: Planet, vehicle: Vehicle, state: EntryState, controls: Controls
) -> EntryState:
    """Time derivative of the state.

    Reference: N. X. Vinh, A. Busemann, R. D. Culp, *Hypersonic and Planetary Entry
    Flight Mechanics*, 1980, chapter 2, with the heading counted from north.
    """
    sin_path, cos_path = sincos(state.flight_path_angle)
    sin_heading, cos_heading = sincos(state.heading)
    sin_latitude, cos_latitude = sincos(state.latitude)
    velocity = state.velocity
    radius = planet.radius + state.altitude
    gravity = planet.gravity.acceleration(radius)
    along, above, right = aerodynamic_acceleration(planet, vehicle, state, controls)

    rotation = planet.rotation_rate
    centrifugal = rotation * rotation * radius * cos_latitude
    coriolis = 2.0 * rotation * velocity
    ground_rate = velocity * cos_path / radius

    return EntryState(
        altitude=velocity * sin_path,
        longitude=ground_rate * sin_heading / cos_latitude,
        latitude=ground_rate * cos_heading,
        velocity=along
        - gravity * sin_path
        + centrifugal
        * (sin_path * cos_latitude - cos_path * sin_latitude * cos_heading),
        flight_path_angle=(
            above
            - gravity * cos_path
            + coriolis * cos_latitude * sin_heading
            + centrifugal
            * (cos_path * cos_latitude + sin_path * sin_latitude * cos_heading)
        )
        / velocity
        + ground_rate,
        heading=(
            right
            - coriolis
            * (sin_path * cos_latitude * cos_heading - cos_path * sin_latitude)
            + centrifugal * sin_latitude * sin_heading
        )
        / (velocity * cos_path)
        + ground_rate * sin_heading * sin_latitude / cos_latitude,
    )


def with_respect_to(
    flow: Callable[[EntryState], EntryState], quantity: Callable[[EntryState], Scalar]
) -> Callable[[EntryState], EntryState]:
    """The same motion with another independent variable than time: energy, velocity, ...

    `flow(state)` is the time derivative; the result divides it by the rate of
    `quantity(state)`, and is singular where that rate is zero.

        over_energy = with_respect_to(flow, lambda state: energy(planet, state))
    """

    def rate_form(state: EntryState) -> EntryState:
        rates = flow(state)
        _, rate = jax.jvp(quantity, (state,), (rates,))
        return jax.tree.map(lambda x: x / rate, rates)

    return rate_form
