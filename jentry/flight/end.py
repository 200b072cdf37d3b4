"""The end of a flight: the last correction to it, its derivative, and its outcome."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Count
from .closed_loop import Lane, command, is_finite, path_constraints, vector_field
from .scenario import Scenario
from .termination import Outcome


_TIME_TOLERANCE = 1e-5
"""s; either solver comes nearer to the end than this, or did not reach it."""


class End(eqx.Module):
    """A flight at its end."""

    lane: Lane
    outcome: Count
    ended_by: Count


def end_of_flight(scenario: Scenario, lane: Lane) -> End:
    """Go from where the loop stopped to where the first end condition is met.

    The loop stops close to it. The rest is a Newton correction along the flow, which is
    differentiated: this gives time and state at the end their exact derivatives, as the
    implicit function theorem has them.
    """
    conditions = scenario.termination
    field = vector_field(scenario, lane.held)
    rates, _ = field(lane.flown, (lane.state, lane.memory))
    margins, margin_rates = jax.jvp(
        conditions.margins,
        (lane.flown, lane.state),
        (jnp.ones_like(lane.flown), rates),
    )
    seconds_left = jnp.where(margins <= 0.0, 0.0, jnp.abs(margins / margin_rates))
    counting = conditions.counting(lane.flown, lane.state)
    if counting is not None:
        seconds_left = jnp.where(counting, seconds_left, jnp.inf)
    seconds_left = lax.stop_gradient(seconds_left)
    ended_by = jnp.argmin(seconds_left)
    met = seconds_left[ended_by] < _TIME_TOLERANCE

    began = lane.flown > 0.0
    closing = lax.stop_gradient(margin_rates[ended_by])
    correction = margins[ended_by] / jnp.where(met & began, closing, 1.0)
    correction = jnp.where(met & began, correction, 0.0)
    state = jax.tree.map(
        lambda x, rate: x - correction * lax.stop_gradient(rate), lane.state, rates
    )
    flown = lane.flown - correction
    controls, _ = command(scenario, flown, state, lane.memory, lane.held)
    now = path_constraints(scenario, state, controls)
    peaks = jax.tree.map(jnp.maximum, lane.peaks, now)
    ended = Lane(
        flown,
        state,
        lane.memory,
        lane.held,
        peaks,
        lane.bracket,
        jnp.zeros_like(lane.running),
        lane.singular,
    )
    outcome = jnp.array(conditions.outcomes)[ended_by]
    beyond = ~began & (margins[ended_by] <= 0.0)
    outcome = jnp.where(beyond, Outcome.BEGAN_BEYOND_END, outcome)
    outcome = jnp.where(met, outcome, Outcome.NOT_FINITE)
    outcome = jnp.where(lane.singular, Outcome.SINGULAR, outcome)
    finite = is_finite((flown, state, lane.memory, peaks))
    outcome = jnp.where(finite, outcome, Outcome.NOT_FINITE)
    return End(ended, outcome, ended_by)
