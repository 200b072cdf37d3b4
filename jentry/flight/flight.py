"""Fly one scenario to its end: the pure function that everything else calls."""

import warnings
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from .._batching import any_lane
from .._printed import in_words
from .._setup import needs_float64
from .._warnings import ResultWarning
from ..fields import Count, Flag, Scalar
from ..motion.constraints import ConstraintValues
from ..motion.state import Controls, EntryState
from ..units import at_edge
from ..world.perturbed_atmosphere import without_zero_departures
from ..world.random_profile import settled
from ..world.tabulated import unit_of_caveat
from .closed_loop import Instant, Lane, caveats, command, constrained, start
from .cycle import Plan
from .end import end_of_flight
from .loop import while_running, while_running_with_history
from .scenario import Scenario, checked
from .solver import AbstractSolver, FixedStep


class History(eqx.Module):
    """A flight at equal intervals from its start; NaN after its end."""

    time: Float[Array, "*n"] = eqx.field(metadata={"unit": "s"})
    states: EntryState
    controls: Controls
    """Controls that were flown"""
    commands: Controls | None
    """Commands of the law; None where they are flown at once"""
    constraints: ConstraintValues
    """The constrained quantities at these times, not their peaks"""
    decisions: Any
    """What a sampled law holds: curves, estimates, commands; None of a continuous law"""


class Flight(eqx.Module):
    """How a flight ended, and on request how it went."""

    time: Scalar = eqx.field(metadata={"unit": "s"})
    """At the end"""
    state: EntryState
    """At the end"""
    outcome: Count
    """Code of an `Outcome`"""
    ended_by: Count
    """Place in `scenario.termination.names` of the end condition that was met, or beyond
    which the flight began; without meaning for the other outcomes without an end"""
    peaks: ConstraintValues
    """Largest values of `scenario.constraints` over all steps; with the `Adaptive` solver
    over the ends of the guidance cycles only"""
    at_peaks: dict[str, Instant]
    """When and where the peaks of `scenario.located_peaks` were, by name: to within a
    step, and without a derivative"""
    caveats: dict[str, Scalar]
    """What a reader of the results must know, by name, shares from 0 to 1: of how the law
    decided (see `AbstractSampledLaw.caveats`), and of the time beyond each table of the
    planet and the vehicle (see `AbstractTabulated`)"""
    history: History | None
    beyond_tables: dict[str, Scalar] = eqx.field(default_factory=dict)
    """Largest distances beyond the edges of these tables, by the name of the caveat: m,
    rad, or Mach numbers. Over all steps, as the peaks are; without a derivative"""


@needs_float64
def fly(
    scenario: Scenario,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
) -> Flight:
    """Fly a scenario from its initial state to the first of its end conditions.

    One flight: batch it with `jax.vmap` or `monte_carlo`. Compile it with `eqx.filter_jit`.
    Differentiable in every leaf of the scenario, in forward mode (`jax.jvp`,
    `jax.jacfwd`) and in reverse mode (`jax.grad`); the end is located exactly, and its
    time moves with what is varied. Derivatives of higher order may nest the modes in any
    order, and are exact up to the fourth. Each order flies again: a Hessian-vector product
    costs two to three gradients, and keeps the flight and its tangents, one carry each a
    cycle.

    A derivative is that of the flight between its jumps. Where a law decides in cycles a
    flight jumps: a bank reversal, or the last cycle before the end, comes one cycle later.
    At a corner, where two end conditions are met at once or a command meets its limit, the
    derivative is one-sided. The mean of the derivatives of many flights is the derivative
    of their mean if the flights have corners, and not if they have jumps: for these see
    `CentralDifferences` in `tune` and `linear_covariance(mode="difference")`.

    **Arguments:**

    - `scenario`: what flies.
    - `solver`: `FixedStep` (default) or `Adaptive`.
    - `history`: interval at which to keep the flight, s; none keeps the end alone. With
      a sampled law it must divide the guidance period or be a multiple of it.

    **Raises:** `ValueError` for numbers that cannot be flown. How the flight went is in
    `Flight.outcome`; a flight never raises because it crashed or skipped out. Where
    `has_end(flight.outcome)` is false, since its numbers did not stay finite, it began
    beyond an end condition, it came too close to a singular point of the equations of
    motion or its law commanded what is no bank, its end and derivatives say nothing: leave
    that flight out of a sum before differentiating it.

        flight = fly(scenario)
        gradient = jax.grad(lambda s: fly(s).state.altitude)(scenario)
    """
    scenario = settled(without_zero_departures(checked(scenario)))
    plan = Plan.of(scenario, solver, history)
    lane = start(scenario, plan.step)
    if history is None:
        kept = None
        lane = while_running(plan.cycle, _running, scenario, lane, plan.cycles)
    else:
        every = plan.stacked_every(scenario)
        lane, lanes = while_running_with_history(
            plan.moved, _running, scenario, lane, plan.cycles, every, plan.decided
        )
        lanes = plan.kept(scenario, lanes)
        kept = lax.map(lambda lane: _observe(scenario, lane), lanes)
    end = end_of_flight(scenario, lane)
    told = caveats(scenario, end.lane)
    distances = {n: beyond.distance for n, beyond in end.lane.noted.beyond.items()}
    warn_of(told, distances)
    return Flight(
        time=end.lane.flown,
        state=end.lane.state,
        outcome=end.outcome,
        ended_by=end.ended_by,
        peaks=end.lane.noted.peaks,
        at_peaks=end.lane.noted.at_peaks,
        caveats=told,
        history=kept,
        beyond_tables=distances,
    )


def warn_of(
    caveats: Mapping[str, Any], distances: Mapping[str, Any], stacklevel: int = 4
) -> None:
    """Warn of caveats that are not zero, of one flight or of many.

    `distances` are those beyond tables, for the caveats that have one.

    Says nothing of numbers that are not known yet, as under `jit`.
    """
    for name, shares in caveats.items():
        if not isinstance(shares, Tracer) and np.any(np.asarray(shares) > 0.0):
            sentence = caveat_sentence(name, shares, distances.get(name))
            warnings.warn(sentence, ResultWarning, stacklevel=stacklevel)


def caveat_sentence(name: str, shares: Any, distances: Any = None) -> str:
    """How many flights have a caveat, and how much of it one of them has."""
    shares = np.atleast_1d(np.asarray(shares))
    told = int(np.sum(shares > 0.0)), shares.size, float(np.max(shares))
    if distances is None:
        return caveat_words(name, *told)
    return caveat_words(name, *told, float(np.max(distances)), unit_of_caveat(name))


def caveat_words(
    name: str,
    flights: int,
    runs: int,
    share: float,
    distance: float | None = None,
    unit: str | None = None,
) -> str:
    """How many of the runs have a caveat, the largest share, and the largest distance."""
    words = (
        f"{flights} of {runs} flights have {in_words(name)}, up to {share:.0%} in one "
        "flight"
    )
    if distance is None or unit is None:
        return words
    number, shown = at_edge(distance, unit)
    shown = "" if shown == "1" else f" {shown}"
    return f"{words}, and by up to {float(number):.3g}{shown}"


def _running(lane: Lane) -> Flag:
    return lane.running


def _observe(scenario: Scenario, lane: Lane) -> History:
    """One entry of the history; NaN where the flight had ended.

    Of a horizon of many times the flights it looks at no more than these.
    """
    shapes = eqx.filter_eval_shape(_observed, scenario, lane)
    ended = jax.tree.map(lambda x: jnp.full(x.shape, jnp.nan, x.dtype), shapes)
    return lax.cond(
        any_lane(lane.on_schedule),
        lambda: _observed(scenario, lane),
        lambda: ended,
    )


@eqx.filter_jit
def _observed(scenario: Scenario, lane: Lane) -> History:
    # Entries past the end are not states of a flight: observe the start in their place.
    flying, first = lane.on_schedule, scenario.initial_state
    state = jax.tree.map(lambda a, b: jnp.where(flying, a, b), lane.state, first)
    lane = eqx.tree_at(lambda lane: lane.moving.state, lane, state)
    wish, _ = command(scenario, lane.flown, lane.moving, lane.held)
    controls = scenario.attitude.flown(lane.moving.attitude, wish)
    seen = History(
        time=jnp.asarray(lane.flown),
        states=state,
        controls=controls,
        commands=None if controls is wish else wish,
        constraints=constrained(scenario, lane.moving, controls),
        decisions=jax.tree.map(jnp.asarray, lane.held),
    )
    return jax.tree.map(lambda x: jnp.where(flying, x, jnp.nan), seen)
