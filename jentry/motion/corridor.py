"""The entry corridor: altitude and drag at which path constraints bind, over velocity."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._newton import by_jvp, newton
from .._printed import as_text
from ..fields import Scalar, Vector, output
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
"""Bisections of the altitudes that are searched: down to rounding"""


class CorridorPoint(eqx.Module):
    """Altitude and drag of level flight at which a path constraint is at its limit."""

    altitude: Scalar = output(unit="m")
    drag: Scalar = output(unit="m/s2")

    __str__ = as_text


def corridor_point(
    constraint: AbstractPathConstraint,
    planet: Planet,
    vehicle: Vehicle,
    state: EntryState,
    angle_of_attack: Scalar,
    dynamics: AbstractDynamics = EntryDynamics(),
    altitudes: tuple[float, float] = (0.0, 150.0 * km),
) -> CorridorPoint:
    """Altitude and drag of level flight where a constraint is at its limit.

    Bisection finds the altitude at which the constraint is at its limit, so the quantity
    must rise or fall with the altitude throughout. Any atmosphere and any aerodynamics
    will do. The result is differentiable in all numbers of the arguments.

    **Arguments:**

    - `state`: gives velocity and direction; its altitude and flight-path angle are not
      used.
    - `angle_of_attack`: rad.
    - `altitudes`: the two altitudes between which the search takes place, m.

    **Returns:** altitude (m) and drag (m/s2), or NaN if the quantity is at its limit at no
    altitude between these.

    **Raises:** `ValueError` for a constraint without a value at a point, such as an
    integral, and for a constraint without a limit.
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
    # The search is not differentiated. One step of Newton's method is differentiated: it
    # hardly changes the altitude and gives it its derivative.
    altitude = newton(by_jvp(excess), found, 1).x
    binds = excess(low) * excess(high) <= 0.0
    return CorridorPoint(
        jnp.where(binds, altitude, jnp.nan),
        jnp.where(binds, at(altitude).air.drag, jnp.nan),
    )


def entry_corridor(
    constraints: Constraints,
    planet: Planet,
    vehicle: Vehicle,
    start: EntryState,
    velocity: Vector,
    angle_of_attack: Vector,
    dynamics: AbstractDynamics = EntryDynamics(),
) -> dict[str, CorridorPoint]:
    """Altitude and drag over velocity at which each constraint is at its limit, by name.

    Heat rate, dynamic pressure and load factors bound the drag from above and the altitude
    from below. The equilibrium glide bounds the drag from below and the altitude from
    above. Constraints without a limit and integrals are left out: they bound nothing at a
    point.

    **Arguments:**

    - `start`: gives latitude and heading, which matter over a rotating planet.
    - `velocity`: m/s, shape (n,).
    - `angle_of_attack`: rad at each velocity, shape (n,).

        s = scenario
        curves = entry_corridor(
            s.constraints, s.planet, s.vehicle, s.initial_state, velocity, angle
        )

    Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
    Dynamics Method", 2004, equations (6)-(9).
    """

    def at(velocity: Scalar, angle: Scalar) -> dict[str, CorridorPoint]:
        state = dataclasses.replace(start, velocity=velocity)
        return {
            name: corridor_point(each, planet, vehicle, state, angle, dynamics)
            for name, each in bounding(constraints).items()
        }

    return jax.vmap(at)(velocity, angle_of_attack)


def bounding(constraints: Constraints) -> Constraints:
    """Path constraints that bound the corridor: with a limit and a value at each point."""
    return {
        name: each
        for name, each in constraints.items()
        if each.limit is not None and isinstance(each, AbstractConstraint)
    }
