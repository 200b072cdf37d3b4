"""Where the equations of motion are singular, and steps that come too close to it."""

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


class _Polar(NamedTuple):
    """A step in the polar coordinates of which a singular point is the origin."""

    distance: Scalar
    """From the point after the step; negative beyond it"""
    approach: Scalar
    """Change of the distance"""
    turn: Scalar
    """By how much the angle changes, rad"""

    def excess(self) -> Scalar:
        """Positive if the step is too long."""
        # Away from a start close by, the turn is a small one that ends within the step.
        near = jnp.abs(self.approach) > _LARGEST_TURN * self.distance
        allowed = jnp.where(near, _NO_TURN, _LARGEST_TURN)
        return jnp.maximum(self.turn - allowed, -_PASSED - self.distance)


def step_is_too_long(before: EntryState, after: EntryState, in_plane: bool) -> Flag:
    """Whether a step comes too close to a singular point of the equations of motion.

    These are in polar coordinates three times: longitude about the poles, heading about
    vertical flight, and flight-path angle about rest. A way past one of them turns the
    angle by up to half a turn: it takes either several steps that resolve the turn, or
    one that turns too far, or one over the point itself. The second and the third are
    wrong, and are seen here; how close is too close depends on the length of the step.
    Only the last of the three points concerns a flight in the plane of the equator.
    """

    def change(name: str) -> Scalar:
        return getattr(after, name) - getattr(before, name)

    path = change("flight_path_angle")
    excess = _Polar(after.velocity, change("velocity"), jnp.abs(path)).excess()
    if in_plane:
        return excess > 0.0
    to_vertical = 0.5 * jnp.pi - jnp.abs(after.flight_path_angle)
    to_pole = 0.5 * jnp.pi - jnp.abs(after.latitude)
    around_pole = jnp.abs(change("longitude"))
    # Convergence of the meridians turns the heading by no more than the longitude.
    around_vertical = jnp.abs(change("heading")) - around_pole
    vertical = _Polar(to_vertical, path, around_vertical)
    pole = _Polar(to_pole, change("latitude"), around_pole)
    for other in (vertical, pole):
        excess = jnp.maximum(excess, other.excess())
    return excess > 0.0


def is_beyond(state: EntryState, in_plane: bool) -> Flag:
    """Whether a flight has gone over a singular point: what adaptive steps can miss."""
    return step_is_too_long(state, state, in_plane)
