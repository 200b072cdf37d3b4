"""The entry corridor: the drag at which each path constraint binds, over the velocity."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from .._newton import by_jvp, newton
from ..fields import Scalar, Vector
from ..units import km
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from .constraints import (
    AbstractConstraint,
    AbstractPathConstraint,
    Constraints,
    PathPoint,
)
from .dynamics import AbstractDynamics, EntryDynamics
from .state import Controls, EntryState


_HALVINGS = 60
"""Of the altitudes searched: down to the rounding of one"""


def drag_at_limit(
    constraint: AbstractPathConstraint,
    planet: Planet,
    vehicle: Vehicle,
    state: EntryState,
    angle_of_attack: Scalar,
    dynamics: AbstractDynamics = EntryDynamics(),
    altitudes: tuple[float, float] = (0.0, 150.0 * km),
) -> Scalar:
    """Drag (m/s2) of level flight where a constraint is at its limit.

    The altitude at which it binds is found by bisection, so that the quantity must rise
    or fall with the altitude; the air and the coefficients may be any. The result is
    differentiable in all numbers that it is made of.

    **Arguments:**

    - `state`: gives velocity and direction; its altitude and its path angle do not count.
    - `angle_of_attack`: rad.
    - `altitudes`: between which the limit is sought, m.

    **Returns:** the drag, or NaN where the limit is met at no altitude between these.

    **Raises:** `ValueError` for a constraint that has no value at a point, such as an
    integral, or no limit.
    """
    limit = constraint.limit
    if limit is None or not isinstance(constraint, AbstractConstraint):
        what = "has no limit" if limit is None else "is no quantity of a point"
        raise ValueError(
            f"{type(constraint).__name__} {what}: it binds at no drag; give it a limit, "
            "or leave it out of the corridor"
        )
    controls = Controls.from_bank(0.0 * angle_of_attack, angle_of_attack)

    def at(altitude: Scalar) -> PathPoint:
        level = dataclasses.replace(state, altitude=altitude, flight_path_angle=0.0)
        return PathPoint.of(planet, vehicle, level, controls, dynamics)

    def excess(altitude: Scalar) -> Scalar:
        return constraint.value(at(altitude)) - limit

    low, high = (jnp.asarray(altitude) for altitude in altitudes)
    falls = excess(low) > excess(high)

    def halved(_, between):
        low, high = between
        middle = 0.5 * (low + high)
        above = (excess(middle) > 0.0) == falls
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    found, _ = lax.stop_gradient(lax.fori_loop(0, _HALVINGS, halved, (low, high)))
    # The search is not differentiated: a step of Newton's method, of next to nothing, is.
    altitude = newton(by_jvp(excess), found, 1).x
    binds = excess(low) * excess(high) <= 0.0
    return jnp.where(binds, at(altitude).air.drag, jnp.nan)


def drag_limits(
    constraints: Constraints,
    planet: Planet,
    vehicle: Vehicle,
    start: EntryState,
    velocity: Vector,
    angle_of_attack: Vector,
    dynamics: AbstractDynamics = EntryDynamics(),
) -> dict[str, Any]:
    """Drag (m/s2) over velocity at which each constraint with a limit binds, by name.

    Those of heat rate, dynamic pressure and load factors bound the drag from above, the
    one of the equilibrium glide from below. Integrals bound no drag and are left out.

    **Arguments:**

    - `start`: gives latitude and heading, which matter over a planet that rotates.
    - `velocity`: m/s, shape (n,).
    - `angle_of_attack`: rad at each of these, shape (n,).

        s = scenario
        curves = drag_limits(
            s.constraints, s.planet, s.vehicle, s.initial_state, velocity, angle
        )

    Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
    Dynamics Method", 2004, equations (6)-(9).
    """

    def at(velocity: Scalar, angle: Scalar) -> dict[str, Scalar]:
        state = dataclasses.replace(start, velocity=velocity)
        return {
            name: drag_at_limit(each, planet, vehicle, state, angle, dynamics)
            for name, each in constraints.items()
            if each.limit is not None and isinstance(each, AbstractConstraint)
        }

    return jax.vmap(at)(velocity, angle_of_attack)
