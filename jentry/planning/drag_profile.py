"""Plans the drag of an entry over the velocity, within the limits of the corridor.

Reference: D.-W. Lee, K.-R. Cho, H. Yan, "Re-Entry Trajectory Tracking Via an Inverse
Dynamics Method", KSME International Journal 18(9), 2004.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._collocation import interpolate, legendre_gauss_lobatto
from .._math import derivatives_along
from .._printed import as_text
from .._programs import cached
from .._setup import needs_float64
from ..fields import Flag, Scalar, Vector, output, scalar, table
from ..motion.constraints import AbstractConstraint, Constraints, PathPoint
from ..motion.corridor import bounding, corridor_point
from ..motion.state import Controls, EntryState
from ..onboard.profiles import AbstractProfile
from ..units import km
from ..world.planet import Planet
from ..world.vehicle import Vehicle
from ._constrained import NoOptimumError, minimise


class CollocatedProfile(AbstractProfile):
    """The polynomial through values at the Legendre-Gauss-Lobatto nodes of an interval.

    Outside the interval it has the values at the ends, with derivatives of zero: a
    polynomial of high degree cannot be extrapolated.
    """

    values: Vector = table()
    """Values at the nodes, from the first end to the last"""
    first: Scalar = scalar()
    last: Scalar = scalar()

    def _on_nodes(self, index: Scalar) -> Scalar:
        """Coordinate of the nodes, from -1 at the first end to 1 at the last."""
        return (2.0 * index - self.first - self.last) / (self.last - self.first)

    def with_derivatives(self, index: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        def value(index: Scalar) -> Scalar:
            x = self._on_nodes(index)
            # Not `clip`: exactly at the ends it has half of the derivative.
            return interpolate(
                self.values, jnp.where(jnp.abs(x) <= 1.0, x, jnp.sign(x))
            )

        return derivatives_along(jnp.ones_like, value, index)


class DragPlan(eqx.Module):
    """A planned drag over the velocity, with its limits and Lagrange multipliers."""

    drag: CollocatedProfile
    """Drag, m/s2, over the velocity, m/s; node 0 is the entry"""
    velocity: Vector = output(unit="m/s")
    """Velocity at the nodes, shape (nodes,)"""
    roughness: Scalar = output(unit="m/s3")
    """J of equation (13), the integral of D'(V)^2"""
    distance: Scalar = output(unit="m")
    """The range by equation (60)"""
    multiplier_of_distance: Scalar = output(unit="1/s3")
    """Multiplier of (60): the derivative of J with respect to the range"""
    limits: dict[str, Vector] = eqx.field(default_factory=dict)
    """Drag (m/s2) at which each path constraint binds, at the nodes; NaN where there is no
    such drag"""
    multipliers: dict[str, Vector] = eqx.field(default_factory=dict)
    """Multipliers of the limits, 1/s: the derivative of J with respect to each limit at
    each node. They are positive where a lower limit binds, negative where an upper limit
    binds, and zero elsewhere"""

    __str__ = as_text

    @property
    def active(self) -> dict[str, list[int]]:
        """The nodes at which limits bind, by the name of the limit."""
        nodes = {n: np.flatnonzero(np.asarray(x)) for n, x in self.multipliers.items()}
        return {name: list(map(int, x)) for name, x in nodes.items() if x.size}


@needs_float64
def plan_drag_profile(
    planet: Planet,
    vehicle: Vehicle,
    angle_of_attack: AbstractProfile,
    constraints: Constraints,
    first: tuple[float, float],
    last: tuple[float, float],
    distance: float,
    degree: int = 30,
) -> DragPlan:
    """The smoothest drag over the velocity that gives a range within the corridor.

    It minimises the integral of D'(V)^2, (13), with the range (60), between the limits (6)
    to (9) at the nodes, with fixed ends. The unknowns are the values of the drag at the
    Legendre-Gauss-Lobatto nodes. The flight-path angle is assumed to be small, as in (12).

    **Arguments:**

    - `angle_of_attack`: rad, over the velocity in m/s.
    - `constraints`: constraints with a limit count. The planner determines whether a limit
      bounds the drag from below or from above.
    - `first`, `last`: velocity (m/s) and drag (m/s2) at entry and at the end.
    - `distance`: the range, m.
    - `degree`: degree of the polynomial, one less than the number of nodes.

    The limits hold at the nodes only. If a limit binds at some of the nodes, the profile
    has a corner at either side, and the range of the polynomial differs slightly from (60):
    by half a kilometre in the case of the paper, with a first drag of 1 m/s2.

    A further lower limit of the drag, `least_drag`, is a hundredth of the smaller drag at
    the ends. It ensures a finite range.

    **Raises:** `ValueError` if no drag can be planned: for limits that exclude each other,
    with the velocity; for ends outside the limits; and for a range outside the corridor,
    with the longest or shortest range and the limits that bind.

    Reference: D.-W. Lee, K.-R. Cho, H. Yan, 2004, section 2 and equations (59), (60).
    """
    _check_ends(first, last, distance)
    if degree < 3:
        raise ValueError(f"degree is {degree}: a profile takes 3 or more")
    made = legendre_gauss_lobatto(degree)
    (v0, drag0), (vf, drag_f) = first, last
    half = 0.5 * (v0 - vf)
    velocity = vf + half * (1.0 - made.nodes)
    straight = drag0 + 0.5 * (drag_f - drag0) * (1.0 + made.nodes)

    bound = bounding(constraints)
    found = _limits(bound, planet, vehicle, angle_of_attack, jnp.asarray(velocity))
    limits = {name: np.asarray(drag) for name, (drag, _, _) in found.items()}
    is_lower = {name: np.asarray(below) for name, (_, below, _) in found.items()}
    for name, (_, _, broken) in found.items():
        if np.any(broken):
            raise ValueError(
                f"{name} is beyond its limit at {velocity[np.argmax(broken)]:.0f} m/s, "
                "whatever the drag: raise the limit"
            )
    limits[LEAST_DRAG] = np.full_like(velocity, 0.01 * min(drag0, drag_f))
    is_lower[LEAST_DRAG] = np.ones(degree + 1, bool)
    bounds = _bounds(limits, is_lower)
    _check_corridor(bounds, velocity, first, last)
    shares = half * made.weights * velocity
    _check_range(bounds, shares, straight, distance)

    scale, inside = 0.5 * (drag0 + drag_f), slice(1, degree)
    problem = {
        "ends": jnp.array([drag0, drag_f]) / scale,
        "first": jnp.asarray(made.first),
        "weights": jnp.asarray(made.weights),
        "flown": jnp.asarray(shares / (scale * distance)),
    }
    lower, upper = bounds.lower[inside] / scale, bounds.upper[inside] / scale
    try:
        optimum = minimise(
            _smoothness, _range_error, problem, straight[inside] / scale, lower, upper
        )
    except NoOptimumError as error:
        raise ValueError(
            f"no drag profile is found for a range of {distance / km:g} km: {error}"
        ) from error
    drag = np.concatenate([[drag0], scale * optimum.x, [drag_f]])
    price = np.concatenate([[0.0], optimum.bounds * scale / half, [0.0]])
    binding = np.where(
        price > 0.0, bounds.below, np.where(price < 0.0, bounds.above, "")
    )
    multiplier_of_distance = optimum.constraints[0] / distance * scale**2 / half
    return DragPlan(
        drag=CollocatedProfile(jnp.asarray(drag), v0, vf),
        velocity=jnp.asarray(velocity),
        roughness=jnp.asarray(optimum.value * scale**2 / half),
        distance=jnp.asarray(np.sum(shares / drag)),
        multiplier_of_distance=jnp.asarray(multiplier_of_distance),
        limits={name: jnp.asarray(x) for name, x in limits.items()},
        multipliers={
            n: jnp.asarray(np.where(binding == n, price, 0.0)) for n in limits
        },
    )


def _whole(problem, inside):
    ends = problem["ends"]
    return jnp.concatenate([ends[:1], inside, ends[1:]])


def _smoothness(problem, inside):
    """Equation (13), over the coordinate of the nodes, with scaled drag."""
    slopes = problem["first"] @ _whole(problem, inside)
    return jnp.sum(problem["weights"] * slopes**2)


def _range_error(problem, inside):
    """Error of the range (60), as a share of the required range."""
    return jnp.sum(problem["flown"] / _whole(problem, inside))[None] - 1.0


@cached
def _limits(
    constraints: Constraints,
    planet: Planet,
    vehicle: Vehicle,
    angle_of_attack: AbstractProfile,
    velocity: Vector,
) -> dict[str, tuple[Any, Any, Any]]:
    """Limits of the drag by each constraint, at each velocity.

    **Returns:** by name, the drag at which the constraint binds in level flight, NaN if
    there is none; whether it is a lower limit; and whether any drag exceeds the constraint.
    """

    def at(velocity: Scalar) -> dict[str, tuple[Scalar, Flag, Flag]]:
        angle = angle_of_attack(velocity)
        nothing = jnp.zeros_like(velocity)
        east = 0.5 * jnp.pi + nothing
        level = EntryState(nothing, nothing, nothing, velocity, nothing, east)
        controls = Controls.from_bank(nothing, angle)
        found = {}
        for name, constraint in constraints.items():
            assert isinstance(constraint, AbstractConstraint)
            assert constraint.limit is not None
            limit = constraint.limit
            point = corridor_point(constraint, planet, vehicle, level, angle)

            def excess(altitude: Scalar, value=constraint.value, limit=limit) -> Scalar:
                state = dataclasses.replace(level, altitude=altitude)
                here = PathPoint.of(planet, vehicle, state, controls)
                return value(here) - limit

            somewhere = jnp.where(jnp.isnan(point.drag), 50.0 * km, point.altitude)
            here, slope = jax.jvp(excess, (somewhere,), (jnp.ones_like(somewhere),))
            broken = jnp.isnan(point.drag) & (here > 0.0)
            found[name] = point.drag, slope > 0.0, broken
        return found

    return jax.vmap(at)(velocity)


class _Bounds(NamedTuple):
    """The tightest limits at the nodes, with their names."""

    lower: np.ndarray
    upper: np.ndarray
    below: np.ndarray
    above: np.ndarray


LEAST_DRAG = "least_drag"
"""Name of a lower limit that every plan has: a hundredth of the smaller drag at the ends.
It ensures a finite range during the search"""


def _bounds(
    limits: Mapping[str, np.ndarray], is_lower: Mapping[str, np.ndarray]
) -> _Bounds:
    names = np.array(list(limits))
    drags = np.array([limits[name] for name in limits])
    lower_side = np.array([is_lower[name] for name in limits])
    known = ~np.isnan(drags)
    lower = np.where(known & lower_side, drags, -np.inf)
    upper = np.where(known & ~lower_side, drags, np.inf)
    low, high = np.argmax(lower, 0), np.argmin(upper, 0)
    return _Bounds(np.max(lower, 0), np.min(upper, 0), names[low], names[high])


def _check_ends(first: tuple[float, float], last: tuple[float, float], distance: float):
    for name, (velocity, drag) in (("first", first), ("last", last)):
        if not (0.0 < velocity < math.inf and 0.0 < drag < math.inf):
            raise ValueError(
                f"{name} is ({velocity} m/s, {drag} m/s2): velocity and drag must be "
                "positive and finite"
            )
    if first[0] <= last[0]:
        raise ValueError(
            f"first is at {first[0]} m/s and last at {last[0]} m/s: the velocity must fall"
        )
    if not 0.0 < distance < math.inf:
        raise ValueError(f"distance is {distance} m: it must be positive and finite")


def _check_corridor(bounds: _Bounds, velocity: np.ndarray, first, last) -> None:
    gap = bounds.upper - bounds.lower
    if np.any(gap < 0.0):
        node = int(np.argmin(gap))
        raise ValueError(
            f"the corridor is closed at {velocity[node]:.0f} m/s: {bounds.below[node]} "
            f"requires {bounds.lower[node]:.4g} m/s2 of drag or more, {bounds.above[node]} "
            f"requires {bounds.upper[node]:.4g} or less; raise one of their limits"
        )
    for name, node, drag in (("first", 0, first[1]), ("last", -1, last[1])):
        low, high = bounds.lower[node], bounds.upper[node]
        if not low <= drag <= high:
            which = bounds.below[node] if drag < low else bounds.above[node]
            raise ValueError(
                f"{name} is {drag:g} m/s2 of drag at {velocity[node]:g} m/s: {which} "
                f"allows {low:.4g} to {high:.4g}"
            )


def _check_range(
    bounds: _Bounds, shares: np.ndarray, drag: np.ndarray, distance: float
) -> None:
    """Refuse a range that the corridor does not contain.

    The range is the sum of `shares` over the drag.
    """
    for edge, names, few in (
        (bounds.lower, bounds.below, "at most"),
        (bounds.upper, bounds.above, "at least"),
    ):
        there = drag.copy()
        there[1:-1] = edge[1:-1]
        extreme = float(np.sum(shares / there))
        beyond = distance > extreme if few == "at most" else distance < extreme
        if beyond:
            named = sorted(set(names[1:-1][np.isfinite(edge[1:-1])]))
            raise ValueError(
                f"a range of {distance / km:g} km is not in the corridor, which holds "
                f"{few} {extreme / km:.1f} km: {' and '.join(named)} bind everywhere then"
            )
