"""The end of a flight: the last correction to it, its derivative, and its outcome."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Count
from .closed_loop import Lane, command, path_constraints, vector_field
from .scenario import Scenario
from .solver import FixedStep
from .termination import Outcome


_TIME_TOLERANCE = 1e-5
"""s; either solver comes nearer to the end than this, or did not reach it."""


class End(eqx.Module):
    """A flight at its end."""

    lane: Lane
    outcome: Count
    ended_by: Count


_LANDINGS = 3
"""Each doubles the order up to which derivatives are exact, from none to one to three; the
method of the steps is exact up to the fourth."""


def end_of_flight(scenario: Scenario, lane: Lane) -> End:
    """Go from where the loop stopped to where the first end condition is met.

    The loop stops close to it, at a time that is not differentiated. The rest is Newton's
    method along the flow, which is: it moves nothing but the last digits, and gives time
    and state at the end their derivatives, up to the fourth order.
    """
    conditions = scenario.termination
    field = vector_field(scenario, lane.held)

    def land(landing, _):
        flown, y, ended_by, met = landing
        rates, _ = field(flown, y)
        margins, margin_rates = jax.jvp(
            conditions.margins, (flown, y[0]), (jnp.ones_like(flown), rates)
        )
        seconds_left = jnp.where(margins <= 0.0, 0.0, jnp.abs(margins / margin_rates))
        seconds_left = lax.stop_gradient(seconds_left)
        first = ended_by < 0
        ended_by = jnp.where(first, jnp.argmin(seconds_left), ended_by)
        near = seconds_left[ended_by] < _TIME_TOLERANCE
        met = jnp.where(first, near, met)

        moves = met & (flown > 0.0)
        closing = jnp.where(moves, margin_rates[ended_by], 1.0)
        correction = jnp.where(moves, -margins[ended_by] / closing, 0.0)
        y = FixedStep().advance(field, flown, correction, y)
        return (flown + correction, y, ended_by, met), None

    unknown = jnp.full_like(lane.running, -1, int), jnp.zeros_like(lane.running)
    landing = lane.flown, (lane.state, lane.memory), *unknown
    landing, _ = lax.scan(land, landing, length=_LANDINGS)
    flown, (state, memory), ended_by, met = landing
    controls, _ = command(scenario, flown, state, memory, lane.held)
    now = path_constraints(scenario, state, controls)
    peaks = jax.tree.map(jnp.maximum, lane.peaks, now)
    ended = Lane(
        flown,
        state,
        memory,
        lane.held,
        peaks,
        lane.bracket,
        jnp.zeros_like(lane.running),
    )
    outcome = jnp.where(
        met, jnp.array(conditions.outcomes)[ended_by], Outcome.NOT_FINITE
    )
    return End(ended, outcome, ended_by)
