"""One guidance cycle of a flight: the law decides, then the motion is integrated."""

import dataclasses
import math

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
from jax import lax

from .._setup import fast_options_are_on
from ..fields import Flag, Scalar
from ..guidance.cycle import FixedCycle
from ..guidance.law import AbstractLaw, AbstractSampledLaw
from .closed_loop import (
    decide,
    guidance_period,
    is_finite,
    navigate,
    noted,
    select,
    vector_field,
)
from .lane import Bracket, Lane
from .scenario import Scenario
from .solver import AbstractSolver, Adaptive, FixedStep
from .termination import Outcome


_AIM_SHORT = 0.999
"""Share of the predicted time to the end that a step takes, to stop before the end."""

_END_TOLERANCE = 1e-9
"""s; the last correction and its derivative neglect terms of this size."""


_FREE_STEPS = 3
"""Number of steps that need not halve the bracket; the end takes four or five steps."""


_STEP = 0.1
"""Length of a step, s, if neither the solver nor the scenario has one."""

_SAME_TIME = 1e-6
"""s; two times that differ by less are equal: thousands of cycles add up rounding."""


_MOST_KEPT = 1e7
"""Largest number of entries of a history, some gigabytes for one flight."""

_MOST_STEPS = 1e9
"""Largest number of steps of a flight, which takes an hour or two."""


class Plan(eqx.Module):
    """Division of the time of a flight into cycles, and of a cycle into steps."""

    duration: float = eqx.field(static=True)
    """Length of a cycle, s"""
    scheduled: int = eqx.field(static=True)
    """Number of cycles up to the time limit"""
    cycles: int = eqx.field(static=True)
    """Largest number of cycles, including those of the last steps to the end"""
    decide_every: int = eqx.field(static=True)
    keep_every: int = eqx.field(static=True)
    navigate_every: int | None = eqx.field(static=True)
    """Number of cycles from one update of the navigation to the next; None without one"""
    solver: AbstractSolver

    @property
    def step(self) -> float:
        """Length of the first step, s; an adaptive solver chooses its own."""
        if isinstance(self.solver, FixedStep):
            return self.duration / self.solver.steps_in(self.duration)
        return self.duration

    @classmethod
    def of(cls, scenario: Scenario, solver: AbstractSolver, history: float | None):
        if isinstance(solver, Adaptive) and fast_options_are_on():
            raise ValueError(
                "the Adaptive solver cannot be compiled with the options of "
                "jentry.setup(fast=True), which would end this process: leave them off"
            )
        law, period = scenario.law, guidance_period(scenario)
        if isinstance(solver, FixedStep):
            usual = period if period and varies(law) else _STEP
            solver = solver.or_step(scenario.step or usual)
            assert solver.step is not None
        limit = scenario.termination.time_limit
        if history is not None and not 0.0 < history < math.inf:
            raise ValueError(
                f"history is {history} s: the interval must be positive and finite"
            )
        if history is not None and limit / history > _MOST_KEPT:
            raise ValueError(
                f"history is {history} s: of a flight of {limit:g} s that is more than "
                f"{_MOST_KEPT:.0e} entries"
            )
        if period is not None and limit / period > _MOST_STEPS:
            raise ValueError(
                f"the guidance period is {period} s: a flight of {limit:g} s would take "
                f"more than {_MOST_STEPS:.0e} cycles"
            )
        if isinstance(solver, FixedStep) and limit / (solver.step or 1.0) > _MOST_STEPS:
            raise ValueError(
                f"step is {solver.step} s: a flight of {limit:g} s would take more than "
                f"{_MOST_STEPS:.0e} steps"
            )
        updated = scenario.navigation.cycle
        lengths = {
            "history": history,
            "the guidance period": period,
            "the cycle of the navigation": updated,
        }
        given = {name: d for name, d in lengths.items() if d is not None}
        if varies(law):
            for name, other in given.items():
                assert period is not None
                if other < period - 1e-9:
                    raise ValueError(
                        f"{name} is {other} s: with a guidance cycle that varies it must "
                        f"be a multiple of the longest, {period} s"
                    )
        default = 20 * (solver.step or _STEP) if isinstance(solver, FixedStep) else 1.0
        duration = min(given.values(), default=default)
        for other in given.values():
            if abs(other / duration - round(other / duration)) > 1e-9:
                raise ValueError(
                    " and ".join(f"{name} is {d} s" for name, d in given.items())
                    + ": each must be a multiple of the shortest"
                )
        scheduled = math.ceil(limit / duration - 1e-9)
        if varies(law):
            assert isinstance(law, AbstractSampledLaw)
            scheduled = law.cycle.most_cycles(limit)
        steps = solver.steps_in(duration) if isinstance(solver, FixedStep) else 1
        cycles = scheduled + math.ceil(steps_to_the_end(duration / steps) / steps)
        decide_every = 1 if period is None else round(period / duration)
        keep_every = 1 if history is None else round(history / duration)
        navigate_every = None if updated is None else round(updated / duration)
        return cls(
            duration,
            scheduled,
            cycles,
            decide_every,
            keep_every,
            navigate_every,
            solver,
        )

    def stacked_every(self, scenario: Scenario) -> int:
        """Number of cycles from one state that is stacked for the history to the next."""
        return 1 if varies(scenario.law) else self.keep_every

    def kept(self, scenario: Scenario, lanes: Lane) -> Lane:
        """The stacked lanes that are entries of the history."""
        if not varies(scenario.law):
            count = math.ceil(self.scheduled / self.keep_every)
            return jax.tree.map(lambda x: x[:count], lanes)
        interval = self.duration * self.keep_every
        count = math.ceil(scenario.termination.time_limit / interval - 1e-9)
        grid = interval * jnp.arange(count)
        flown = jnp.where(lanes.running, lanes.flown, jnp.inf)
        index = jnp.searchsorted(flown, grid - _SAME_TIME)
        lanes = jax.tree.map(lambda x: x[index], lanes)
        there = lanes.running & (jnp.abs(lanes.flown - grid) < _SAME_TIME)
        return eqx.tree_at(lambda lanes: lanes.running, lanes, there)

    def decided(self, scenario: Scenario, lane: Lane) -> Lane:
        """The lane after an update of its navigation, and after a decision of its sampled
        law on it, if the cycles of these start now."""
        law = scenario.law
        if self.navigate_every is not None and varies(law):
            lane = navigate(scenario, lane, self._has_passed(law, lane))
        elif self.navigate_every == 1:
            lane = navigate(scenario, lane, None)
        elif self.navigate_every is not None:
            lane = navigate(scenario, lane, self._starts(lane, self.navigate_every))
        if self.decide_every == 1:
            return decide(scenario, lane, None)
        return decide(scenario, lane, self._starts(lane, self.decide_every))

    def _starts(self, lane: Lane, every: int) -> Flag:
        """Whether a cycle of so many cycles of the plan starts now."""
        index = jnp.round(lane.flown / self.duration).astype(int)
        return index % every == 0

    def _has_passed(self, law: AbstractLaw, lane: Lane) -> Flag:
        """Whether a cycle of the navigation ended in the last guidance cycle, which varies.

        Guidance cycles that share one clock with the navigation end where it does.
        """
        assert isinstance(law, AbstractSampledLaw) and self.navigate_every is not None
        length = self.duration * self.navigate_every
        begun = lane.flown - law.cycle.seconds(lane.held)
        before, now = (
            jnp.floor((time + _SAME_TIME) / length) for time in (begun, lane.flown)
        )
        return now > before

    def cycle(self, scenario: Scenario, lane: Lane) -> Lane:
        """One guidance cycle, or a part of one if the history has a finer interval."""
        return self.moved(scenario, self.decided(scenario, lane))

    def moved(self, scenario: Scenario, lane: Lane) -> Lane:
        """The lane after the motion of a cycle whose decision has been made."""
        law, duration = scenario.law, self.duration
        if varies(law):
            assert isinstance(law, AbstractSampledLaw)
            duration = law.cycle.seconds(lane.held)
        if isinstance(self.solver, Adaptive):
            return _adaptive_cycle(scenario, self.solver, duration, lane)
        assert isinstance(self.solver, FixedStep)
        steps = self.solver.steps_in(self.duration)
        if varies(law):
            trial = jnp.where(lane.on_schedule, duration / steps, lane.bracket.trial)
            lane = eqx.tree_at(lambda lane: lane.bracket.trial, lane, trial)
        return _fixed_cycle(scenario, self.solver, duration / steps, steps, lane)


def varies(law: AbstractLaw) -> bool:
    """Whether the guidance cycle of a law depends on the flight."""
    return isinstance(law, AbstractSampledLaw) and not isinstance(law.cycle, FixedCycle)


def steps_to_the_end(step: float) -> int:
    """Largest number of steps in the step (s) that contains the end: `_next_trial`."""
    return math.ceil(math.log2(max(step / _END_TOLERANCE, 1.0))) + _FREE_STEPS + 2


def _fixed_cycle(
    scenario: Scenario,
    solver: FixedStep,
    full_step: Scalar | float,
    steps: int,
    lane: Lane,
) -> Lane:
    """Take steps until the cycle is over or the end is located within its tolerance.

    A step that would cross the end is not taken. Each following step goes to the zero of
    the straight line through the margins before and behind the end. Two or three such
    steps come within the tolerance, before the end. They are steps of the same solver, so
    that its order holds up to the end.
    """
    field = vector_field(scenario, lane.held, lane.aiding)
    conditions, dynamics = scenario.termination, scenario.dynamics

    def step(lane: Lane, _: None) -> tuple[Lane, None]:
        bracket = lane.bracket
        moving = lane.moving.in_step()
        moving = solver.advance(field, lane.flown, bracket.trial, moving).renewed()
        flown = lane.flown + bracket.trial
        seen, refused = noted(scenario, lane, flown, moving)

        before, planet = lane.moving, scenario.planet
        counting = conditions.counting(
            lane.flown, before.state, before.believed, planet
        )
        margin = conditions.smallest_margin(
            flown, moving.state, moving.believed, planet, counting
        )
        finite = is_finite(moving)
        taken = lane.running & finite & (margin > 0.0)
        singular = dynamics.is_singular(lane.state, moving.state)
        stopped = jnp.where(taken & singular, Outcome.SINGULAR, lane.stopped)
        stopped = jnp.where(taken & refused, Outcome.BEYOND_TABLE, stopped)
        taken = taken & (stopped < 0)
        flown, moving, seen = select(
            taken, (flown, moving, seen), (lane.flown, lane.moving, lane.noted)
        )
        running = lane.running & finite & (stopped < 0)
        after = _next_trial(bracket, margin, taken, full_step)
        bracket = select(running, after, bracket)
        running = running & (bracket.trial > 0.0)
        held = lane.held
        after = flown, moving, held, seen, bracket, running, stopped
        return Lane(*after), None

    # What the navigation holds is large, and does not change within a cycle.
    without = dataclasses.replace(lane, aiding=None)
    after, _ = lax.scan(step, without, None, length=steps)
    return dataclasses.replace(after, aiding=lane.aiding)


def _next_trial(
    bracket: Bracket, margin: Scalar, taken: Flag, full_step: Scalar | float
) -> Bracket:
    """The bracket after a step to a margin, which was taken or was found to cross the end.

    The next step is zero when the end is within the tolerance. Wherever the end lies, the
    bracket about it is no longer than `allowed` after the next step, and `allowed` is
    halved in each step. This bounds the number of steps for any margin, in the manner of
    I. F. D. Oliveira and R. H. C. Takahashi, "An Enhancement of the Bisection Method
    Average Performance Preserving Minmax Optimality", ACM TOMS 47(1), 2020.

    These steps are not differentiated. The last correction at the end is differentiated.
    """
    moved = (bracket.margin - margin) / bracket.trial
    allowed = 0.5 * bracket.allowed
    margin, far, far_margin = select(
        taken,
        (margin, bracket.far - bracket.trial, bracket.far_margin),
        (bracket.margin, bracket.trial, margin),
    )
    in_sight = jnp.isfinite(far)
    allowed = jnp.where(jnp.isfinite(allowed), allowed, 2.0**_FREE_STEPS * far)
    closing = (margin - far_margin) / far
    # If two conditions compete, the margin behind the end may belong to the other one and
    # be steeper. The step just taken then shows better how fast this margin closes.
    closing = jnp.where(taken & (moved > 0.0), jnp.minimum(closing, moved), closing)
    way = margin / closing
    arrived = (taken & (way < _END_TOLERANCE)) | (far < _END_TOLERANCE)
    aim = jnp.minimum(_AIM_SHORT * way, allowed)
    aim = jnp.clip(aim, far - allowed, _AIM_SHORT * far)
    aim = jnp.where(arrived, 0.0, aim)
    aim, far, far_margin, allowed = lax.stop_gradient((aim, far, far_margin, allowed))
    trial = jnp.where(in_sight, aim, full_step)
    return Bracket(trial, margin, far, far_margin, allowed)


def _adaptive_cycle(
    scenario: Scenario, solver: Adaptive, duration: Scalar | float, lane: Lane
) -> Lane:
    """Integrate to the end of the cycle, or to the first end condition."""
    field = vector_field(scenario, lane.held, lane.aiding)
    conditions = scenario.termination
    flown = jnp.minimum(lane.flown + duration, conditions.time_limit)
    counting = conditions.counting(
        lane.flown, lane.state, lane.moving.believed, scenario.planet
    )

    def smallest_margin(t, y, args, **kwargs):
        margins = conditions.margins(t, y.state, y.believed, scenario.planet)
        if counting is not None:
            margins = jnp.where(counting, margins, jnp.inf)
        return jnp.min(margins[:-1], initial=jnp.inf)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: field(jnp.asarray(t), y)),
        solver.method,
        t0=lane.flown,
        t1=flown,
        dt0=None,
        y0=lane.moving,
        stepsize_controller=diffrax.PIDController(
            rtol=solver.tolerance, atol=solver.tolerance
        ),
        event=diffrax.Event(
            smallest_margin, optimistix.Newton(solver.tolerance, solver.tolerance)
        ),
        adjoint=diffrax.DirectAdjoint(),
        max_steps=solver.max_steps,
        throw=False,
    )
    assert solution.ts is not None
    after = solution.ts[0]
    moving = jax.tree.map(lambda x: x[0], solution.ys).renewed()
    done = solution.event_mask | (after >= scenario.termination.time_limit)
    good = (solution.result == diffrax.RESULTS.successful) | (
        solution.result == diffrax.RESULTS.event_occurred
    )
    going = lane.running & good & is_finite(moving)
    seen, refused = noted(scenario, lane, after, moving)
    singular = scenario.dynamics.is_beyond(moving.state)
    stopped = jnp.where(going & singular, Outcome.SINGULAR, lane.stopped)
    stopped = jnp.where(going & refused, Outcome.BEYOND_TABLE, stopped)
    going = going & (stopped < 0)
    flown, moving, seen = select(
        going, (after, moving, seen), (lane.flown, lane.moving, lane.noted)
    )
    running = going & ~done
    held, bracket = lane.held, lane.bracket
    return Lane(flown, moving, held, seen, bracket, running, stopped, lane.aiding)
