"""Where the equations of motion are singular, and steps that come too close to it."""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp

from ..fields import Flag, Scalar
from .state import EntryState


_LARGEST_TURN = 0.25
"""rad within a step. A Runge-Kutta step of fourth order that passes a singular point at
four times its own length turns by this much, and its end is off by 5e-5 of its length;
at half of that distance by 4e-4, at its own length by 9e-3, at a tenth by ten lengths.
The curve is that of polar coordinates in a plane and holds for all three points:
`tests/test_singularities.py` measures it."""

_NO_TURN = 1e-6
"""rad; less is no turn, so that a straight way to or from the singular point is flown."""

_PASSED = 1e-9
"""rad or m/s beyond the singular point: more than rounding."""


class Polar(NamedTuple):
    """A step in the polar coordinates of which a singular point is the origin."""

    distance: Scalar
    """Distance from the point after the step; negative beyond it"""
    approach: Scalar
    """Change of the distance in the step"""
    turn: Scalar
    """Change of the angle in the step, rad"""

    def excess(self) -> Scalar:
        """How far the step is too long: positive if it is."""
        # Away from a start close by, the turn is a small one that ends within the step.
        near = jnp.abs(self.approach) > _LARGEST_TURN * self.distance
        allowed = jnp.where(near, _NO_TURN, _LARGEST_TURN)
        return jnp.maximum(self.turn - allowed, -_PASSED - self.distance)


SingularPoint = Callable[[EntryState, EntryState], Polar]
"""A step from one state to another, in polar coordinates about a singular point"""


def _change(name: str, before: EntryState, after: EntryState) -> Scalar:
    return getattr(after, name) - getattr(before, name)


def at_rest(before: EntryState, after: EntryState) -> Polar:
    """The step about rest, where the flight-path angle has no meaning."""
    path = _change("flight_path_angle", before, after)
    return Polar(after.velocity, _change("velocity", before, after), jnp.abs(path))


def at_vertical_flight(before: EntryState, after: EntryState) -> Polar:
    """The step about vertical flight, where the heading has no meaning."""
    to_vertical = 0.5 * jnp.pi - jnp.abs(after.flight_path_angle)
    # Convergence of the meridians turns the heading by no more than the longitude.
    around = jnp.abs(_change("heading", before, after))
    around = around - jnp.abs(_change("longitude", before, after))
    return Polar(to_vertical, _change("flight_path_angle", before, after), around)


def at_poles(before: EntryState, after: EntryState) -> Polar:
    """The step about the poles, where the longitude has no meaning."""
    to_pole = 0.5 * jnp.pi - jnp.abs(after.latitude)
    around = jnp.abs(_change("longitude", before, after))
    return Polar(to_pole, _change("latitude", before, after), around)


def step_is_too_long(
    before: EntryState, after: EntryState, points: Sequence[SingularPoint]
) -> Flag:
    """Whether a step comes too close to a singular point of the equations of motion.

    The equations of an entry state are in polar coordinates three times: flight-path
    angle about rest, heading about vertical flight, and longitude about the poles. A way
    past one of them turns the angle by up to half a turn: it takes either several steps
    that resolve the turn, or one that turns too far, or one over the point itself. The
    second and the third are wrong, and are seen here; how close is too close depends on
    the length of the step.

    **Arguments:**

    - `before`, `after`: the states at the start and at the end of the step.
    - `points`: the singular points that concern the motion; with none, no step is too
      long.
    """
    excesses = [point(before, after).excess() for point in points]
    if not excesses:
        return jnp.zeros_like(after.velocity, bool)
    return functools.reduce(jnp.maximum, excesses) > 0.0
