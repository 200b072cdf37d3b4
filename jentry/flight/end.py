"""The end of a flight: the last correction to it, its derivative, and its outcome."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._batching import side_by_side
from ..fields import Count
from .closed_loop import is_finite, noted, select, vector_field
from .lane import Lane
from .scenario import Scenario
from .termination import Outcome


_TIME_TOLERANCE = 1e-5
"""s; a solver that stops farther from the end than this did not reach it."""


class End(eqx.Module):
    """A flight at its end."""

    lane: Lane
    outcome: Count
    ended_by: Count


_PLACES = (0.0, 0.5, 0.5, 1.0)
_WEIGHTS = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
"""Weights of the stages of the classical Runge-Kutta method"""

_LANDINGS = 3
"""Number of corrections. Derivatives are exact to the first order after one correction and
to the third after two. After three the method of the steps limits them to the fourth."""


@eqx.filter_jit
def end_of_flight(scenario: Scenario, lane: Lane) -> End:
    """Move a flight from where the loop stopped to where the first end condition is met.

    The loop stops close to the end, at a time that is not differentiated. The rest is
    Newton's method along the flow, which is differentiated. It changes only the last
    digits, and gives time and state at the end their derivatives, up to the fourth order.

    If the loop stopped at numbers that are not finite, its last step is tried again, to
    find whether a commanded bank was invalid.
    """
    conditions = scenario.termination
    field = vector_field(scenario, lane.held, lane.aiding)
    asking = dataclasses.replace(lane.moving, off_a_bank=jnp.zeros_like(lane.flown))
    planet = scenario.planet
    now = lane.state, lane.moving.believed, planet
    counting = conditions.counting(lane.flown, *now)

    def margins_at(time, motion, navigated):
        moving = dataclasses.replace(lane.moving, motion=motion, navigated=navigated)
        return conditions.margins(time, moving.state, moving.believed, planet)

    def land(landing, _):
        """One Runge-Kutta step; its length follows from its first stage."""
        flown, start, ended_by, met = landing

        @functools.partial(jax.checkpoint, prevent_cse=False)
        def stage(known, stage):
            slope, total, correction, ended_by, met = known
            first, place, weight = stage
            length = place * correction
            y = jax.tree.map(lambda y, k: y + length * k, start, slope)
            slope = field(flown + length, y)

            margins, closing = jax.jvp(
                margins_at,
                (flown, start.motion, start.navigated),
                (jnp.ones_like(flown), slope.motion, slope.navigated),
            )
            seconds_left = jnp.where(margins <= 0.0, 0.0, jnp.abs(margins / closing))
            if counting is not None:
                # The adaptive solver may stop just behind the end that it has found.
                behind = jnp.where(closing < 0.0, jnp.abs(margins / closing), jnp.inf)
                seconds_left = jnp.where(counting, seconds_left, behind)
            seconds_left = lax.stop_gradient(seconds_left)
            unknown = ended_by < 0
            ended_by = jnp.where(unknown, jnp.argmin(seconds_left), ended_by)
            near = seconds_left[ended_by] < _TIME_TOLERANCE
            met = jnp.where(unknown, near, met)
            again = jnp.where(unknown & ~met & (lane.stopped < 0), tried, 0.0)

            moves = met & (flown > 0.0)
            closing = jnp.where(moves, closing[ended_by], 1.0)
            newton = jnp.where(moves, -margins[ended_by] / closing, again)
            correction = jnp.where(first, newton, correction)
            length = weight * correction
            total = jax.tree.map(lambda y, k: y + length * k, total, slope)
            return (slope, total, correction, ended_by, met), None

        nothing = jax.tree.map(jnp.zeros_like, start)
        known = nothing, start, jnp.zeros_like(flown), ended_by, met
        known = side_by_side(known)
        stages = jnp.arange(4) == 0, jnp.array(_PLACES), jnp.array(_WEIGHTS)
        (_, y, correction, ended_by, met), _ = lax.scan(stage, known, stages)
        return (flown + correction, y, ended_by, met), None

    unknown = jnp.full_like(lane.running, -1, int), jnp.zeros_like(lane.running)
    tried = lax.stop_gradient(lane.bracket.trial)
    landing = side_by_side((lane.flown, asking, *unknown), lane.running)
    landing, _ = lax.scan(land, landing, length=_LANDINGS)
    flown, moving, ended_by, met = landing
    assert moving.off_a_bank is not None
    off_a_bank = ~met & (moving.off_a_bank > 0.0)
    moving = dataclasses.replace(moving, off_a_bank=None)
    flown, moving = select(met, (flown, moving), (lane.flown, lane.moving))
    seen, _ = noted(scenario, lane, flown, moving)
    ended = Lane(
        flown,
        moving,
        lane.held,
        seen,
        lane.bracket,
        jnp.zeros_like(lane.running),
        lane.stopped,
        lane.aiding,
    )
    outcome = jnp.array(conditions.outcomes)[ended_by]
    at_stop = conditions.margins(lane.flown, *now)
    beyond = (lane.flown == 0.0) & (at_stop[ended_by] <= 0.0)
    outcome = jnp.where(beyond, Outcome.BEGAN_BEYOND_END, outcome)
    lost = jnp.where(off_a_bank, Outcome.NOT_A_BANK, Outcome.NOT_FINITE)
    outcome = jnp.where(met, outcome, lost)
    outcome = jnp.where(lane.stopped < 0, outcome, lane.stopped)
    finite = is_finite((flown, moving, seen.peaks))
    outcome = jnp.where(finite, outcome, Outcome.NOT_FINITE)
    return End(ended, outcome, ended_by)
