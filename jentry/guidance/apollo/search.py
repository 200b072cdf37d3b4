"""Search for a skip that has the range to go, by the secant method."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ...fields import Scalar
from .phases import ConstantDrag, Seen
from .skip import SkipPlan, SkipPrediction


OPEN, LATER, FOUND, SLOW = map(float, range(4))
"""Ends of a search in a cycle: none yet; the range cannot be met now; a skip is found; the
vehicle is too slow for a skip"""

_LARGEST_RATIO = 1.0 - 1e-6
"""Bound of the lift-to-drag ratio, which is a fraction in the flight program"""


class Search(eqx.Module):
    """State of the search for a skip that has the range to go."""

    started: Scalar
    """1 after its start"""
    lift_to_drag: Scalar
    """Upward lift-to-drag ratio of the next skip (LEWD)"""
    change: Scalar
    """Last change of the ratio (DLEWD)"""
    error: Scalar
    """Range of a skip before, minus the range to go, rad (DIFFOLD)"""
    changed: Scalar
    """1 after the first change of the ratio (HIND)"""
    plan: SkipPlan
    """The last skip"""
    end: Scalar
    """`OPEN`, `LATER`, `FOUND` or `SLOW`"""

    @classmethod
    def start(cls, control: ConstantDrag, nothing: Scalar) -> "Search":
        """The search before its start."""
        return cls(
            started=nothing,
            lift_to_drag=control.first_lift_to_drag + nothing,
            change=control.first_change + nothing,
            error=nothing,
            changed=nothing,
            plan=SkipPlan.unknown(nothing),
            end=nothing + OPEN,
        )


def searched(
    control: ConstantDrag,
    prediction: SkipPrediction,
    seen: Seen,
    search: Search,
    lower: Scalar,
    trials: int,
) -> Search:
    """The search after the trials of a cycle, of which the first to end it is the last.

    `lower` is that of `SkipPrediction.plan`.
    """

    def attempt(search: Search, _: None) -> tuple[Search, None]:
        tried = _tried(control, prediction, seen, search, lower)
        going = search.end == OPEN
        after = jax.tree.map(lambda a, b: jnp.where(going, a, b), tried, search)
        return after, None

    fresh = eqx.tree_at(lambda s: s.end, search, jnp.zeros_like(search.end) + OPEN)
    return lax.scan(attempt, fresh, length=trials)[0]


def _tried(
    control: ConstantDrag,
    prediction: SkipPrediction,
    seen: Seen,
    search: Search,
    lower: Scalar,
) -> Search:
    """One skip of the search, and the ratio of the next one."""
    ratio = search.lift_to_drag
    plan = prediction.plan(seen.velocity, seen.rate, seen.drag, ratio, lower)
    error = prediction.range(plan, seen.velocity, seen.rate).total - seen.range_to_go
    slow = plan.exit_velocity < control.slow_exit
    fast = plan.exit_velocity > prediction.circular_velocity
    near = jnp.abs(error) < control.tolerance
    misses = jnp.logical_not(slow | fast | near)
    # The first ratio is the least: if its skip is too long, the drag is held.
    long = misses & (search.changed == 0.0) & (error >= 0.0)
    turns = misses & jnp.logical_not(long)

    difference = search.error - error
    known = jnp.abs(difference) > 1e-9
    change = search.change * error / jnp.where(known, difference, 1.0)
    change = jnp.where(known, change, 0.0)
    change = jnp.where(ratio + change < 0.0, -0.5 * ratio, change)
    beyond = ratio + change >= _LARGEST_RATIO
    after = jnp.where(beyond, _LARGEST_RATIO, ratio + change)

    end = jnp.where(long | (turns & beyond), LATER, OPEN)
    for flag, name in ((near, FOUND), (fast, LATER), (slow, SLOW)):
        end = jnp.where(flag, name, end)
    goes_on = turns & jnp.logical_not(beyond)
    return Search(
        started=search.started,
        lift_to_drag=jnp.where(turns, after, ratio),
        change=jnp.where(turns, change, search.change),
        error=jnp.where(misses, error, search.error),
        changed=jnp.where(goes_on, 1.0, search.changed),
        plan=plan,
        end=end,
    )
