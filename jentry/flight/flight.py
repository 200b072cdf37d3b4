"""Fly one scenario to its end: `fly`, a pure function that all of jentry uses."""

import dataclasses
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
from .._printed import as_text, in_words
from .._setup import needs_float64
from .._warnings import ResultWarning
from ..fields import Count, Flag, Scalar
from ..motion.constraints import ConstraintValues
from ..motion.state import Controls, EntryState
from ..onboard.navigation_filter import Knowledge
from ..units import at_edge
from ..world.perturbed_atmosphere import without_zero_perturbations
from ..world.random_profile import settled
from ..world.tabulated import unit_of_caveat
from .closed_loop import (
    caveats,
    constrained,
    knowledge,
    path_constraints,
    select,
    start,
)
from .cycle import Plan
from .end import end_of_flight
from .lane import Instant, Lane, Moving
from .loop import while_running, while_running_with_history
from .scenario import Scenario
from .scenario_checks import checked
from .sensing import command, first_moving
from .solver import AbstractSolver, FixedStep
from .termination import Outcome


class History(eqx.Module):
    """A flight at equal intervals from its start; NaN after its end."""

    time: Float[Array, "*n"] = eqx.field(metadata={"unit": "s"})
    states: EntryState
    controls: Controls
    """Controls of the vehicle"""
    commands: Controls | None
    """Commands of the law; None if the vehicle follows them at once"""
    constraints: ConstraintValues
    """The constrained quantities at these times, not their peaks"""
    decisions: Any
    """What a sampled law holds: curves, estimates, commands; None for a continuous law"""
    navigated: EntryState | None = None
    """States that the vehicle believes; None with perfect navigation"""
    knowledge: Knowledge | None = None
    """Knowledge errors; None with perfect navigation"""

    __str__ = as_text


class Flight(eqx.Module):
    """The end of a flight and, on request, its history."""

    time: Scalar = eqx.field(metadata={"unit": "s"})
    """Time at the end, s"""
    state: EntryState
    """State at the end"""
    outcome: Count
    """Code of an `Outcome`"""
    ended_by: Count
    """Position in `scenario.termination.names` of the end condition that was met, or beyond
    which the flight began. It has no meaning for the other outcomes without an end"""
    peaks: ConstraintValues
    """Largest values of `scenario.constraints` over all steps. The `Adaptive` solver checks
    only the ends of the guidance cycles"""
    at_peaks: dict[str, Instant]
    """Time and state at the peaks of `scenario.located_peaks`, by name: accurate to a step,
    and without a derivative"""
    caveats: dict[str, Scalar]
    """Caveats by name, each a share from 0 to 1. They are those of the decisions of the law
    (see `AbstractSampledLaw.caveats`), and the shares of time beyond each table of the
    planet and the vehicle (see `AbstractTabulated`)"""
    history: History | None
    beyond_tables: dict[str, Scalar] = eqx.field(default_factory=dict)
    """Largest distances beyond the edges of these tables over all steps, by the name of the
    caveat: m, rad, or Mach numbers. They have no derivative"""
    navigated: EntryState | None = None
    """State that the vehicle believes at the end; None with perfect navigation"""
    knowledge: Knowledge | None = None
    """Knowledge error at the end; None with perfect navigation"""
    at_end: ConstraintValues = eqx.field(default_factory=lambda: ConstraintValues({}))
    """Values at the end of the path constraints in `scenario.values_at_end`, such as the
    Mach number and the dynamic pressure at which a parachute opens"""

    def __str__(self) -> str:
        kind, _, numbers = as_text(self).partition("\n")
        if isinstance(self.outcome, Tracer) or np.ndim(self.outcome):
            return f"{kind}\n{numbers}"
        return f"{kind}: {Outcome(int(self.outcome)).message}\n{numbers}"


@needs_float64
def fly(
    scenario: Scenario,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
) -> Flight:
    """Fly a scenario from its initial state to the first of its end conditions.

    This is one flight: batch it with `jax.vmap` or `monte_carlo`, and compile it with
    `eqx.filter_jit`. It is differentiable in every leaf of the scenario, in forward mode
    (`jax.jvp`, `jax.jacfwd`) and in reverse mode (`jax.grad`). The end is located exactly,
    and its time is differentiated too. Derivatives of higher order may nest the modes in
    any order, and are exact up to the fourth. Each order flies again: a Hessian-vector
    product costs two to three gradients, and stores the flight and its tangents, one carry
    of each per cycle.

    A derivative is that of the flight between its jumps. If a law decides in cycles, a
    flight jumps where a bank reversal, or the last cycle before the end, comes one cycle
    later. At a corner, where two end conditions are met at once or a command meets its
    limit, the derivative is one-sided. The mean of the derivatives of many flights is the
    derivative of their mean if the flights have corners, but not if they have jumps. For
    jumps see `CentralDifferences` in `tune` and `linear_covariance(mode="difference")`.

    **Arguments:**

    - `scenario`: the scenario to fly.
    - `solver`: `FixedStep` (default) or `Adaptive`.
    - `history`: interval at which the flight is stored, s; with None only the end is
      stored. With a sampled law it must divide the guidance period or be a multiple of it.

    **Raises:** `ValueError` for numbers that cannot be flown. A flight does not raise an
    error because it crashed or skipped out: see `Flight.outcome`. `has_end(flight.outcome)`
    is false if the numbers did not stay finite, if the flight began beyond an end
    condition, if it came too close to a singular point of the equations of motion, if it
    stopped at the edge of a table, or if the law commanded an invalid bank. The end and
    the derivatives of such a flight have no meaning: leave it out of a sum before
    differentiating the sum.

        flight = fly(scenario)
        gradient = jax.grad(lambda s: fly(s).state.altitude)(scenario)
    """
    scenario = ready(scenario)
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
    flight = landed(scenario, lane, kept)
    warn_of(flight.caveats, flight.beyond_tables)
    return flight


def ready(scenario: Scenario) -> Scenario:
    """The scenario that the loop flies: checked, and with its random air drawn."""
    return settled(without_zero_perturbations(checked(scenario)))


def landed(scenario: Scenario, lane: Lane, history: History | None = None) -> Flight:
    """The flight whose loop stopped at a lane, moved to its end."""
    end = end_of_flight(scenario, lane)
    noted = end.lane.noted
    return Flight(
        time=end.lane.flown,
        state=end.lane.state,
        outcome=end.outcome,
        ended_by=end.ended_by,
        peaks=noted.peaks,
        at_peaks=noted.at_peaks,
        caveats=caveats(scenario, end.lane),
        history=history,
        beyond_tables={n: beyond.distance for n, beyond in noted.beyond.items()},
        navigated=_navigated(end.lane.moving),
        knowledge=knowledge(scenario, end.lane),
        at_end=_at_end(scenario, end.lane),
    )


def warn_of(
    caveats: Mapping[str, Any], distances: Mapping[str, Any], stacklevel: int = 4
) -> None:
    """Warn of caveats of one flight or of many that are not zero.

    `distances` are those beyond tables, for the caveats that have one. There is no warning
    for numbers that are not known yet, as under `jit`.
    """
    for name, shares in caveats.items():
        if not isinstance(shares, Tracer) and np.any(np.asarray(shares) > 0.0):
            sentence = caveat_sentence(name, shares, distances.get(name))
            warnings.warn(sentence, ResultWarning, stacklevel=stacklevel)


def caveat_sentence(name: str, shares: Any, distances: Any = None) -> str:
    """Sentence with the number of flights that have a caveat, and its largest share."""
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
    """Sentence with the number of runs with a caveat, its largest share and distance."""
    words = (
        f"{flights} of {runs} flights have {in_words(name)}, up to {share:.0%} in one "
        "flight"
    )
    if distance is None or unit is None:
        return words
    number, shown = at_edge(distance, unit)
    shown = "" if shown == "1" else f" {shown}"
    return f"{words}, and by up to {float(number):.3g}{shown}"


def _at_end(scenario: Scenario, lane: Lane) -> ConstraintValues:
    names = scenario.values_at_end
    if not names:
        return ConstraintValues({})
    values = path_constraints(scenario, lane.flown, lane.moving, lane.held)
    units = {
        n: each.shown_unit or each.unit for n, each in scenario.constraints.items()
    }
    return ConstraintValues({name: values[name] for name in names}, units)


def _navigated(moving: Moving) -> EntryState | None:
    return None if moving.navigated is None else moving.navigated.state


def _running(lane: Lane) -> Flag:
    return lane.running


def _observe(scenario: Scenario, lane: Lane) -> History:
    """One entry of the history; NaN if the flight had ended.

    Entries after the end of all flights of a batch cost nothing: the time limit may be
    many times longer than the flights.
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
    # Entries after the end are not states of a flight: evaluate the start in their place.
    flying, first = lane.on_schedule, first_moving(scenario)
    motion, navigated = select(
        flying,
        (lane.moving.motion, lane.moving.navigated),
        (first.motion, first.navigated),
    )
    moving = dataclasses.replace(lane.moving, motion=motion, navigated=navigated)
    lane = dataclasses.replace(lane, moving=moving)
    wish, _ = command(scenario, lane.flown, lane.moving, lane.held)
    controls = scenario.attitude.flown(lane.moving.attitude, wish)
    seen = History(
        time=jnp.asarray(lane.flown),
        states=moving.state,
        controls=controls,
        commands=None if controls is wish else wish,
        constraints=constrained(scenario, lane.moving, controls),
        decisions=jax.tree.map(jnp.asarray, lane.held),
        navigated=_navigated(lane.moving),
        knowledge=knowledge(scenario, lane),
    )
    return jax.tree.map(lambda x: jnp.where(flying, x, jnp.nan), seen)
