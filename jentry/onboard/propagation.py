"""Onboard prediction: a flight of the onboard model under a command, to an end."""

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
from ..motion.dynamics import (
    AbstractDynamics,
    EntryDynamics,
    require_angles,
    with_respect_to,
)
from ..motion.state import Controls, EntryState
from .estimation import AbstractFactors, Factors
from .model import OnboardModel


Command = Callable[[Scalar, EntryState], Controls]
"""Command of the vehicle, over the time since the start (s) and the state"""


class SampledCommand(NamedTuple):
    """A command that is decided at the start of each step and applied through the step.

    This models a law that decides at a guidance cycle. Expensive computations belong in
    `decide`, which runs once in a step. The command itself is evaluated at every stage of
    the step, and in the search for the end.
    """

    decide: Callable[[Scalar, EntryState], Command]
    """Function of the time since the start of the prediction (s) and the state"""


Margin = Callable[[EntryState], Scalar]
"""A smooth function of the state that is positive before an end and falls through zero at
it"""
Index = Callable[[EntryState], Scalar]
"""A smooth function of the state, such as the energy"""
Integrand = Callable[[Scalar, EntryState, Controls], PyTree]
"""Numbers that are integrated over the time with the motion, such as the heat rate"""

NO_END = -1
"""Value of `Prediction.ended_by` if no end was met"""

_AT_ONCE = 8
"""Number of steps between checks whether any flight of the batch continues"""
_SEARCH = 6
"""Bracketed Newton steps for the length of the last step, which are not differentiated"""
_EXACT = 2
"""Differentiated Newton steps: derivatives of the end are exact up to the third order"""
_CONVERGED = 1e-6
"""Share of a step by which the last Newton step may move the end"""


class Prediction(eqx.Module):
    """The end of a predicted flight, or the point at which it was given up."""

    time: Scalar
    """s since the start of the prediction"""
    state: EntryState
    integrals: Any
    """Integrals of the integrand; None without one"""
    ended_by: Count
    """Position among the ends of the one that was met, or `NO_END`"""

    @property
    def has_end(self) -> Flag:
        """Whether an end was met. Otherwise state and derivatives are not those of an end,
        and a law should leave its command unchanged, or use ends that it can meet."""
        return self.ended_by != NO_END


class _Moving(eqx.Module):
    """Integrated quantities, or their rates."""

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
    """Propagate the onboard model under a command to the first of several ends.

    The steps have equal length in time, except the last, which is cut where the end is
    met. The result varies smoothly with the state, the command and the factors. Forward-
    and reverse-mode derivatives are those of the end that is met, up to the third order.
    Under `vmap` the steps continue until no flight of the batch needs one. To compute the
    prediction only where it is due, call it within `where_due`.

    Ends are checked after each step: an end that is met and left again within a step is
    not detected. A flight is given up if it meets no end in its steps, starts beyond an
    end, comes too close to a singular point of the equations of motion or does not remain
    finite. `has_end` is then false, and time and state are the last valid ones. Ground and
    skipping out are ends like others:

        ends = (
            lambda state: state.velocity - 503.0,
            lambda state: state.altitude,
            lambda state: 135e3 - state.altitude,
        )

    **Arguments:**

    - `model`: planet and vehicle that the law assumes.
    - `state`: initial state of the prediction.
    - `command`: the command, or a `SampledCommand` that decides it at the start of each
      step; smooth within a step.
    - `ends`: margins.
    - `step`: s.
    - `steps`: largest number of steps; rounded up to a multiple of eight.
    - `factors`: factors on the lift and the drag of the model; none by default.
    - `dynamics`: equations of motion that integrate altitude and angles.
    - `integrand`: further quantities to integrate over the time, from zero.

    **Raises:** `ValueError` without an end, for a step or a number of steps that is not
    positive, and for `VectorDynamics`.
    """
    _require_steps(steps)
    require_angles(dynamics, state, "a prediction integrates altitude and angles")
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

        # A jitted function is traced once for all the places that call it.
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

    # If no end was crossed the last step has zero length, and its slopes are finite.
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
    """Propagate the onboard model under a command until an index has a value.

    The steps are equal over the index, which replaces the time as independent variable.
    This is the cheapest and smoothest prediction if the index rises or falls throughout,
    as the energy does in the air. If the index moves the wrong way at a stage of any step,
    or the numbers do not remain finite, `has_end` is false and the prediction is its
    initial state. The index has its value at the end to the order of the method, and
    exactly if it is a component of the state.

    **Arguments:** those of `propagate`, and

    - `index`: such as `lambda state: energy(model.planet, state)`.
    - `end`: value of the index at the end.
    - `steps`: number of steps.

    **Raises:** `ValueError` for a number of steps that is not positive, and for
    `VectorDynamics`.
    """
    _require_steps(steps)
    require_angles(dynamics, state, "a prediction integrates altitude and angles")
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
    # NaN is not zero either.
    met = _is_finite(moving) & (backwards == 0.0)
    moving = _select(met, moving, start)
    ended_by = jnp.where(met, 0, NO_END)
    return Prediction(moving.time, moving.state, moving.integrals, ended_by)


def require_corrections(corrections: int, step: float, steps: int) -> None:
    """Look at the counts of a law that corrects its decision by predictions.

    **Arguments:**

    - `corrections`: corrections in one guidance cycle.
    - `step`, `steps`: length, s, and largest number of steps in a prediction.

    **Raises:** `ValueError` for a number that is not positive.
    """
    if corrections < 1:
        raise ValueError(f"corrections is {corrections}: it must be 1 or more")
    if not 0.0 < step < math.inf or steps < 1:
        raise ValueError(
            f"a prediction has {steps} steps of {step} s: both must be positive"
        )


def _flow(
    model: OnboardModel,
    command: Command,
    factors: AbstractFactors | None,
    dynamics: AbstractDynamics,
    integrand: Integrand | None,
) -> Callable[[_Moving], _Moving]:
    """Time derivative of the integrated quantities."""
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
    # A reduction of a scalar would separate operations that belong together.
    leaves = [x if jnp.ndim(x) == 0 else jnp.sum(x) for x in jax.tree.leaves(moving)]
    return jnp.isfinite(sum(leaves))


def _select(condition: Flag, chosen: _Moving, otherwise: _Moving) -> _Moving:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), chosen, otherwise)
