"""Singular points of the equations of motion, and steps that come too close to them."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from ..fields import Flag, Scalar
from .state import EntryState


_LARGEST_TURN = 0.25
"""Largest change of the angle in a step, rad. A Runge-Kutta step of fourth order that
passes a singular point at four times its own length turns by this angle. Its error is then
5e-5 of its length; at half of that distance 4e-4, at its own length 9e-3, at a tenth of it
ten lengths. The errors are those of polar coordinates in a plane and hold for all three
points: `tests/test_singularities.py` measures them."""

_NO_TURN = 1e-6
"""rad; a smaller change counts as none, so that a straight path to the point is allowed."""

_PASSED = 1e-9
"""Distance beyond the singular point, rad or m/s, that is more than rounding."""


class Polar(NamedTuple):
    """A step in polar coordinates about a singular point."""

    distance: Scalar
    """Distance from the point after the step; negative beyond it"""
    approach: Scalar
    """Change of the distance in the step"""
    turn: Scalar
    """Change of the angle in the step, rad"""

    def excess(self) -> Scalar:
        """Excess of the step over the allowed length: positive if it is too long."""
        # In a step away from a point close by, any turn ends within the step.
        near = jnp.abs(self.approach) > _LARGEST_TURN * self.distance
        allowed = jnp.where(near, _NO_TURN, _LARGEST_TURN)
        return jnp.maximum(self.turn - allowed, -_PASSED - self.distance)


SingularPoint = Callable[[EntryState, EntryState], Polar]
"""A step from one state to another, in polar coordinates about a singular point"""


def _change(name: str, before: EntryState, after: EntryState) -> Scalar:
    return getattr(after, name) - getattr(before, name)


def at_rest(before: EntryState, after: EntryState) -> Polar:
    """The step in coordinates about rest, where the flight-path angle has no meaning."""
    path = _change("flight_path_angle", before, after)
    return Polar(after.velocity, _change("velocity", before, after), jnp.abs(path))


def at_vertical_flight(before: EntryState, after: EntryState) -> Polar:
    """The step in coordinates about vertical flight, where the heading has no meaning."""
    to_vertical = 0.5 * jnp.pi - jnp.abs(after.flight_path_angle)
    # Convergence of the meridians changes the heading by at most the change of longitude.
    around = jnp.abs(_change("heading", before, after))
    around = around - jnp.abs(_change("longitude", before, after))
    return Polar(to_vertical, _change("flight_path_angle", before, after), around)


def at_poles(before: EntryState, after: EntryState) -> Polar:
    """The step in coordinates about the poles, where the longitude has no meaning."""
    to_pole = 0.5 * jnp.pi - jnp.abs(after.latitude)
    around = jnp.abs(_change("longitude", before, after))
    return Polar(to_pole, _change("latitude", before, after), around)


def step_is_too_long(
    before: EntryState, after: EntryState, points: Sequence[SingularPoint]
) -> Flag:
    """Whether a step comes too close to a singular point of the equations of motion.

    The equations contain polar coordinates three times: the flight-path angle about rest,
    the heading about vertical flight, and the longitude about the poles. A path past such
    a point changes the angle by up to half a turn. Several steps may resolve this change;
    or one step changes the angle too much; or one step goes over the point itself. The
    second and the third are wrong, and are detected here. The smallest allowed distance
    depends on the length of the step.

    **Arguments:**

    - `before`, `after`: the states at the start and at the end of the step.
    - `points`: the singular points of the motion; without any, no step is too long.
    """
    excesses = [point(before, after).excess() for point in points]
    if not excesses:
        return jnp.zeros_like(after.velocity, bool)
    return functools.reduce(jnp.maximum, excesses) > 0.0
