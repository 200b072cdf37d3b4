"""Prediction on board: what the onboard model flies under a command, to an end."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, PyTree

from .._batching import side_by_side, where_due
from .._integrate import runge_kutta, runge_kutta_step
from .._newton import by_jvp, newton
from ..fields import Count, Flag, Scalar
from ..motion.dynamics import AbstractDynamics, EntryDynamics, with_respect_to
from ..motion.state import Controls, EntryState
from .estimation import AbstractFactors, Factors
from .model import OnboardModel


Command = Callable[[Scalar, EntryState], Controls]
"""What the vehicle will fly, over the time since the start (s) and the state"""


class SampledCommand(NamedTuple):
    """A command that is decided anew at the start of each step, and flown through it.

    As a law decides in flight at a guidance cycle. What costs much is computed there, once
    in a step; the command itself is asked for at every stage, and for the place of the end.
    """

    decide: Callable[[Scalar, EntryState], Command]
    """Over the time since the start of the prediction (s) and the state"""


Margin = Callable[[EntryState], Scalar]
"""A smooth function of the state that is positive before an end and falls through zero
there"""
Index = Callable[[EntryState], Scalar]
"""A smooth function of the state, such as the energy"""
Integrand = Callable[[Scalar, EntryState, Controls], PyTree]
"""Numbers to be integrated over the time beside the motion, such as the heat rate"""

NO_END = -1
"""In `Prediction.ended_by`: no end was met"""

_AT_ONCE = 8
"""Steps, after each of which it is looked whether a flight of the batch goes on"""
_SEARCH = 6
"""Bracketed Newton steps for the length of the last step. They are not differentiated"""
_EXACT = 2
"""Newton steps that are: derivatives of the end are exact up to the third order"""
_CONVERGED = 1e-6
"""Share of a step by which the last of them may move the end"""


class Prediction(eqx.Module):
    """The end of a predicted flight, or where it was given up."""

    time: Scalar
    """s since the start of the prediction"""
    state: EntryState
    integrals: Any
    """Integrals of the integrand; None without one"""
    ended_by: Count
    """Place among the ends of the one that was met, or `NO_END`"""

    @property
    def has_end(self) -> Flag:
        """Whether an end was met. Otherwise state and derivatives say nothing of the end,
        and a law should leave its command as it is, or go by the ends that it can meet."""
        return self.ended_by != NO_END


class _Moving(eqx.Module):
    """What is integrated, or its rate."""

    time: Scalar
    state: EntryState
    integrals: Any


def propagate(
    model: OnboardModel,
    state: EntryState,
    command: Command | SampledCommand,
    ends: Sequence[Margin],
    *,
    step: Scalar | float,
    steps: int,
    factors: AbstractFactors | None = None,
    dynamics: AbstractDynamics = EntryDynamics(),
    integrand: Integrand | None = None,
) -> Prediction:
    """Fly the onboard model under a command to the first of several ends.

    In steps of equal length in time, of which the last is cut where the end is met: the
    answer varies smoothly with the state, the command and the factors, and forward- and
    reverse-mode derivatives are those of the end that is met, up to the third order.
    Under `vmap` the steps go on until no flight of the batch needs one. To be computed
    only where it is due, call it within `where_due`.

    Ends are looked at after each step, so that one which is met and left again within a
    step is not seen. A flight that meets none in the steps that it has, begins beyond
    one, comes too close to a singular point of the equations of motion or does not stay
    finite is given up: `has_end` is false, and time and state are the last good ones.
    Ground and skipping out are ends like others:

        ends = (
            lambda state: state.velocity - 503.0,
            lambda state: state.altitude,
            lambda state: 135e3 - state.altitude,
        )

    **Arguments:**

    - `model`: planet and vehicle as they are believed to be.
    - `state`: where the prediction begins.
    - `command`: what is flown, or what decides it at the start of each step; smooth within
      a step.
    - `ends`: margins.
    - `step`: s.
    - `steps`: how many there are at most; rounded up to a multiple of eight.
    - `factors`: on the lift and the drag of the model; none if not given.
    - `dynamics`: equations of motion, such as those of the scenario.
    - `integrand`: what else is to be integrated over the time, from zero.

    **Raises:** `ValueError` without an end, or for a step or a number of steps that is
    not positive.
    """
    _require_steps(steps)
    if not ends:
        raise ValueError("ends is empty: a prediction needs an end to go to")
    if isinstance(step, int | float) and not 0.0 < step < math.inf:
        raise ValueError(f"step is {step} s: it must be positive and finite")
    step = jnp.asarray(step, float)

    def decided(moving: _Moving) -> Command:
        if isinstance(command, SampledCommand):
            return command.decide(moving.time, moving.state)
        return command

    def stepping(flown: Command) -> Callable[[_Moving, Scalar], _Moving]:
        flow = _flow(model, flown, factors, dynamics, integrand)

        # As a function of its own it is traced once for all the places that call it.
        @jax.jit
        def after(moving: _Moving, length: Scalar) -> _Moving:
            return runge_kutta_step(lambda _, m: flow(m), 0.0 * length, moving, length)

        return after

    always = None if isinstance(command, SampledCommand) else stepping(command)

    def steps_from(moving: _Moving) -> Callable[[_Moving, Scalar], _Moving]:
        return stepping(decided(moving)) if always is None else always

    def margins(state: EntryState) -> Array:
        return jnp.stack([end(state) for end in ends])

    def advance(carry, _):
        moving, running, crossed = carry
        moved = steps_from(moving)(moving, step)
        flies = running & _is_finite(moved)
        flies &= jnp.logical_not(dynamics.is_singular(moving.state, moved.state))
        inside = jnp.min(margins(moved.state)) > 0.0
        taken = flies & inside
        return (_select(taken, moved, moving), taken, crossed | (flies & ~inside)), None

    def advance_all(carry):
        return lax.scan(advance, carry, length=_AT_ONCE)[0]

    def some(carry, _):
        return where_due(carry[1], advance_all, carry), None

    start = _start(state, decided, integrand)
    running = _is_finite(start) & (jnp.min(margins(state)) > 0.0)
    carry = side_by_side((start, running, jnp.zeros_like(running)), (model, factors))
    blocks = math.ceil(steps / _AT_ONCE)
    (last, _, crossed), _ = lax.scan(some, carry, length=blocks)

    after = steps_from(last)

    def margins_after(length: Scalar) -> Array:
        return margins(after(last, length).state)

    # Where no end was crossed the last step has no length, and its slopes are finite.
    at = lax.stop_gradient(last)
    after_there = steps_from(at)
    search = newton(
        by_jvp(lambda x: jnp.min(margins(after_there(at, x).state))),
        jnp.where(crossed, 0.5 * lax.stop_gradient(step), 0.0),
        _SEARCH,
        lower=jnp.zeros_like(step),
        upper=lax.stop_gradient(step),
        falls=True,
    )
    length = lax.stop_gradient(jnp.where(crossed, search.x, 0.0))
    ended_by = jnp.argmin(margins_after(length))
    found = newton(by_jvp(lambda x: margins_after(x)[ended_by]), length, _EXACT)
    converged = found.known & (jnp.abs(found.step) < _CONVERGED * step)
    met = crossed & converged
    end = after(last, jnp.where(met, found.x, 0.0))
    met &= _is_finite(end)
    met &= jnp.logical_not(dynamics.is_singular(last.state, end.state))
    end = _select(met, end, last)
    ended_by = jnp.where(met, ended_by, NO_END)
    return Prediction(end.time, end.state, end.integrals, ended_by)


def propagate_over(
    index: Index,
    end: Scalar | float,
    model: OnboardModel,
    state: EntryState,
    command: Command,
    *,
    steps: int,
    factors: AbstractFactors | None = None,
    dynamics: AbstractDynamics = EntryDynamics(),
    integrand: Integrand | None = None,
) -> Prediction:
    """Fly the onboard model under a command until an index has a value.

    In so many equal steps over the index, which takes the place of the time as
    independent variable: the cheapest and smoothest prediction where the index rises or
    falls throughout, as the energy does in the air. Where it runs the wrong way at a
    stage of any step, or the numbers do not stay finite, `has_end` is false and the
    prediction stays at its start. The index at the end has the value to the order of the
    method; exactly where it is a component of the state.

    **Arguments:** those of `propagate`, and

    - `index`: such as `lambda state: energy(model.planet, state)`.
    - `end`: its value at the end.
    - `steps`: how many.

    **Raises:** `ValueError` for a number of steps that is not positive.
    """
    _require_steps(steps)
    flow = _flow(model, command, factors, dynamics, integrand)
    over = with_respect_to(flow, lambda moving: index(moving.state))
    start = _start(state, lambda _: command, integrand)
    first = index(state)
    way = end - first

    def slope(_: Scalar, y: tuple[_Moving, Scalar]) -> tuple[_Moving, Scalar]:
        rates = over(y[0])
        backwards = jnp.where(rates.time * way < 0.0, 1.0, 0.0)
        return rates, backwards

    y = start, jnp.zeros_like(first)
    moving, backwards = runge_kutta(slope, first, end, y, steps)
    # What is not a number is not zero either.
    met = _is_finite(moving) & (backwards == 0.0)
    moving = _select(met, moving, start)
    ended_by = jnp.where(met, 0, NO_END)
    return Prediction(moving.time, moving.state, moving.integrals, ended_by)


def _flow(
    model: OnboardModel,
    command: Command,
    factors: AbstractFactors | None,
    dynamics: AbstractDynamics,
    integrand: Integrand | None,
) -> Callable[[_Moving], _Moving]:
    """Time derivative of what is integrated."""
    planet, nominal = model.planet, model.vehicle
    factors = Factors() if factors is None else factors

    def flow(moving: _Moving) -> _Moving:
        time, state = moving.time, moving.state
        controls = command(time, state)
        here = factors.at(state.altitude)
        scales = nominal.lift_scale * here.lift, nominal.drag_scale * here.drag
        vehicle = eqx.tree_at(lambda v: (v.lift_scale, v.drag_scale), nominal, scales)
        rates = dynamics.rates(planet, vehicle, state, controls)
        more = None if integrand is None else integrand(time, state, controls)
        return _Moving(jnp.ones_like(time), rates, more)

    return flow


def _start(
    state: EntryState,
    decided: Callable[[_Moving], Command],
    integrand: Integrand | None,
) -> _Moving:
    time = jnp.zeros_like(state.velocity)
    start = _Moving(time, state, None)
    if integrand is None:
        return start
    kinds = eqx.filter_eval_shape(
        lambda: integrand(time, state, decided(start)(time, state))  # pyright: ignore
    )
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), kinds)
    return _Moving(time, state, nothing)


def _require_steps(steps: int) -> None:
    if steps < 1:
        raise ValueError(f"steps is {steps}: it must be 1 or more")


def _is_finite(moving: _Moving) -> Flag:
    # A reduction of a scalar would stand between operations that belong together.
    leaves = [x if jnp.ndim(x) == 0 else jnp.sum(x) for x in jax.tree.leaves(moving)]
    return jnp.isfinite(sum(leaves))


def _select(condition: Flag, chosen: _Moving, otherwise: _Moving) -> _Moving:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, otherwise)
