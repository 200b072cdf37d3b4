"""A loop of unknown length with exact derivatives, forward and reverse.

`lax.while_loop` stops as soon as every flight of a batch has ended, but has no reverse
mode. `lax.scan` has both modes, but always runs to its full length. This loop stops early
*and* has both modes: its derivative is defined once, as the solution of a linear system
with its transpose. Since the system itself is defined too, derivatives of any order follow.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from .._batching import any_lane, side_by_side
from .._linear_solve import linear_solve
from .._trace_modes import has_forward_mode_only
from ..fields import Count


Carry = TypeVar("Carry", bound=PyTree)
Parameters = TypeVar("Parameters", bound=PyTree)


def _stack_of(tree: PyTree, length: int) -> PyTree:
    def zeros(x):
        return jnp.zeros((length, *jnp.shape(x)), jnp.result_type(x))

    return jax.tree.map(zeros, tree)


def _put(stack: PyTree, index: Count | int, tree: PyTree) -> PyTree:
    return jax.tree.map(lambda s, x: s.at[index].set(x), stack, tree)


def _take(stack: PyTree, index: Count | int) -> PyTree:
    return jax.tree.map(lambda s: s[index], stack)


def _add(a: PyTree, b: PyTree) -> PyTree:
    return jax.tree.map(jnp.add, a, b)


def while_running(
    cycle: Callable[[Parameters, Carry], Carry],
    running: Callable[[Carry], Any],
    parameters: Parameters,
    carry: Carry,
    max_cycles: int,
) -> Carry:
    """Apply `cycle(parameters, carry)` while `running(carry)`, at most `max_cycles` times.

    `cycle` must return a carry that no longer runs unchanged: under `vmap` the loop
    continues until no flight of the batch runs. Reverse mode stores one carry per cycle;
    the intermediate values of a cycle are computed again.
    """
    loop = _run if has_forward_mode_only() else _loop
    return loop(parameters, carry, None, cycle, running, max_cycles, 0, True)[0]


def while_running_with_history(
    cycle: Callable[[Parameters, Carry], Carry],
    running: Callable[[Carry], Any],
    parameters: Parameters,
    carry: Carry,
    max_cycles: int,
    every: int = 1,
    begin: Callable[[Parameters, Carry], Carry] | None = None,
) -> tuple[Carry, Carry]:
    """Loop as `while_running` does, and stack the carry at the starts of cycles.

    These are the first cycle and each `every`-th after it. Only entries for which
    `running(entry)` holds are valid. A cycle may be given in two parts, `begin` and then
    `cycle`: the result of `begin(parameters, carry)` is then stacked. `begin` too must
    return a carry that no longer runs unchanged.
    """
    given = parameters, carry, begin, cycle, running, max_cycles, every, True
    return _loop(*given)[:2]


@eqx.filter_jit
def _advance(cycle, parameters, carry):
    """One cycle, or a part of it. It is compiled with the code around it. As a separate
    function it is traced and differentiated once for all places where it is called."""
    return cycle(parameters, carry)


def _begun(begin, parameters, carry):
    return carry if begin is None else _advance(begin, parameters, carry)


def _run(parameters, carry, begin, cycle, running, max_cycles, keep, begun):
    """The last carry, the stack of each `keep`-th carry, and the number of cycles.

    No carry is stacked if `keep` is zero. The stack has the results of `begin` if `begun`,
    and its inputs if not.
    """
    stacked = math.ceil(max_cycles / keep) if keep else 0

    def going(loop):
        index, carry, _ = loop
        return any_lane(running(carry)) & (index < max_cycles)

    def body(loop):
        index, before, history = loop
        carry = _begun(begin, parameters, before)
        if keep:
            # Carries that are not stacked are all written to one place behind the others.
            wanted = index % keep == 0
            place = jnp.where(wanted, index // keep, stacked) if keep > 1 else index
            history = _put(history, place, carry if begun else before)
        return index + 1, _advance(cycle, parameters, carry), history

    carry = side_by_side(carry, parameters)
    history = _stack_of(carry, stacked + (keep > 1)) if keep else None
    count, carry, history = lax.while_loop(going, body, (0, carry, history))
    if keep > 1:
        history = jax.tree.map(lambda x: x[:stacked], history)
    return carry, history, count


_loop = eqx.filter_custom_jvp(_run)


class _Flown(eqx.Module):
    """The flight that is linearized."""

    varied: PyTree
    """The parameters that are varied"""
    fixed: PyTree
    """The other arrays of the parameters"""
    moving: PyTree
    """The differentiated leaves of the carries at the starts of all cycles, stacked"""
    discrete: PyTree
    """The other leaves of these carries"""
    count: Count
    """Number of cycles"""


class _Path(eqx.Module):
    """The whole linearized flight: input and result of the sweeps."""

    varied: PyTree
    """The parameters that are varied"""
    first: PyTree
    """The carry before the first cycle"""
    stack: PyTree
    """The carries at the starts of all cycles, and behind the last one"""
    final: PyTree
    """The carry when the loop stopped"""


@_loop.def_jvp
def _loop_jvp(primals, tangents):
    parameters, carry, begin, cycle, running, max_cycles, keep, begun = primals
    parameter_tangents, carry_tangents, *_ = tangents
    # This calls the function with this rule, not its body. The states about which the
    # cycles are linearized depend on the parameters too; higher derivatives need that.
    final, history, count = _loop(
        parameters, carry, begin, cycle, running, max_cycles, 1, False
    )

    differentiated = jax.tree.map(
        lambda t: t is not None, parameter_tangents, is_leaf=lambda t: t is None
    )
    varied, fixed = eqx.partition(parameters, differentiated)
    moving, _ = eqx.partition(carry, eqx.is_inexact_array)
    moving_stack, discrete_stack = eqx.partition(history, eqx.is_inexact_array)
    fixed, static = eqx.partition(fixed, eqx.is_array)
    carry_tangents = eqx.combine(
        eqx.filter(carry_tangents, eqx.is_inexact_array),
        jax.tree.map(jnp.zeros_like, moving),
    )

    def linearized(flown, index):
        """The cycle at an index of the flight, as a function of differentiated leaves."""
        discrete = _take(flown.discrete, index)

        def advance(varied, moving):
            parameters = eqx.combine(varied, flown.fixed, static)
            carry = _begun(begin, parameters, eqx.combine(moving, discrete))
            after = _advance(cycle, parameters, carry)
            return eqx.filter(after, eqx.is_inexact_array)

        return advance, (flown.varied, _take(flown.moving, index))

    def push(flown, path):
        def body(loop):
            index, tangent, stack = loop
            advance, at = linearized(flown, index)
            _, tangent = jax.jvp(advance, at, (path.varied, tangent))
            tangent = _add(tangent, _take(path.stack, index + 1))
            return index + 1, tangent, _put(stack, index + 1, tangent)

        tangent = _add(path.first, _take(path.stack, 0))
        stack = _put(path.stack, 0, tangent)
        _, tangent, stack = lax.while_loop(
            lambda loop: loop[0] < flown.count, body, (0, tangent, stack)
        )
        return _Path(path.varied, path.first, stack, _add(path.final, tangent))

    def pull(flown, path):
        def body(loop):
            index, parameter_cotangent, cotangent, stack = loop
            index = index - 1
            advance, at = linearized(flown, index)
            _, transpose = jax.vjp(advance, *at)
            more, cotangent = transpose(cotangent)
            cotangent = _add(cotangent, _take(path.stack, index))
            stack = _put(stack, index, cotangent)
            return index, _add(parameter_cotangent, more), cotangent, stack

        cotangent = _add(path.final, _take(path.stack, flown.count))
        stack = _put(path.stack, flown.count, cotangent)
        _, parameter_cotangent, cotangent, stack = lax.while_loop(
            lambda loop: loop[0] > 0,
            body,
            (flown.count, path.varied, cotangent, stack),
        )
        return _Path(
            parameter_cotangent, _add(path.first, cotangent), stack, path.final
        )

    def equations(flown, path):
        """Left-hand sides of the equations that the sweeps solve.

        They are x[0] - first, x[k+1] - J[k] x[k] and final - x[count], where J[k] is the
        derivative of cycle k of the flight. They are evaluated only for derivatives of
        higher order, which differentiate J.
        """

        def of_cycle(index):
            # After the end of the loop there is no state to linearize about.
            going = index < flown.count
            advance, at = linearized(flown, jnp.where(going, index, 0))
            before = path.varied, _take(path.stack, index)
            _, after = jax.jvp(advance, at, before)
            after = jax.tree.map(lambda a: jnp.where(going, a, 0.0), after)
            return jax.tree.map(jnp.subtract, _take(path.stack, index + 1), after)

        rows = lax.map(jax.checkpoint(of_cycle), jnp.arange(max_cycles))
        start = jax.tree.map(
            lambda x, first: x[:1] - first[None], path.stack, path.first
        )
        return _Path(
            path.varied,
            path.first,
            jax.tree.map(lambda a, b: jnp.concatenate([a, b]), start, rows),
            jax.tree.map(jnp.subtract, path.final, _take(path.stack, flown.count)),
        )

    flown = _Flown(varied, fixed, moving_stack, discrete_stack, count)
    given = _Path(
        parameter_tangents,
        carry_tangents,
        _stack_of(moving, max_cycles + 1),
        jax.tree.map(jnp.zeros_like, moving),
    )
    path = linear_solve(equations, push, pull, flown, given)
    if not keep:
        return (final, None, count), (path.final, None, None)
    history = jax.tree.map(lambda x: x[::keep], history)
    stack = jax.tree.map(lambda x: x[:-1:keep], path.stack)
    if begin is None or not begun:
        return (final, history, count), (path.final, stack, None)

    def all_begun(varied, moving):
        """The carries that `begin` returned; unchanged after the end of the loop."""
        parameters = eqx.combine(varied, fixed, static)
        begun = functools.partial(_begun, begin, parameters)

        def one_begun(entry):
            going = any_lane(running(entry))
            return lax.cond(going, begun, lambda entry: entry, entry)

        entries = lax.map(one_begun, eqx.combine(moving, discrete))
        return eqx.partition(entries, eqx.is_inexact_array)

    moving, discrete = eqx.partition(history, eqx.is_inexact_array)
    moving, stack, discrete = jax.jvp(
        all_begun, (varied, moving), (parameter_tangents, stack), has_aux=True
    )
    return (final, eqx.combine(moving, discrete), count), (path.final, stack, None)
