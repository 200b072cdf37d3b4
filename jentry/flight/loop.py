"""A loop of unknown length with exact derivatives, forward and reverse.

`lax.while_loop` stops as soon as every flight of a batch has ended, but has no reverse
mode; `lax.scan` has both, but always runs to the horizon. This loop stops early *and*
has both: its derivative is stated once, as a linear map with its transpose.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from .._batching import any_lane
from .._types import Count


Carry = TypeVar("Carry", bound=PyTree)
Parameters = TypeVar("Parameters", bound=PyTree)


def _stack_of(tree: PyTree, length: int) -> PyTree:
    def zeros(x):
        return jnp.zeros((length, *jnp.shape(x)), jnp.result_type(x))

    return jax.tree.map(zeros, tree)


def _put(stack: PyTree, index: Count, tree: PyTree) -> PyTree:
    return jax.tree.map(lambda s, x: s.at[index].set(x), stack, tree)


def _take(stack: PyTree, index: Count) -> PyTree:
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

    `cycle` must return the carry as it was when it no longer runs: under `vmap` the loop
    goes on until no flight of the batch runs. Memory in reverse mode is one carry per
    cycle; the inside of a cycle is computed again.
    """
    return _loop(parameters, carry, cycle, running, max_cycles, False)[0]


def while_running_with_history(
    cycle: Callable[[Parameters, Carry], Carry],
    running: Callable[[Carry], Any],
    parameters: Parameters,
    carry: Carry,
    max_cycles: int,
) -> tuple[Carry, Carry]:
    """As `while_running`; also the carry at the start of every cycle, stacked.

    Of the `max_cycles` entries those count for which `running(entry)` holds.
    """
    return _loop(parameters, carry, cycle, running, max_cycles, True)[:2]


def _run(parameters, carry, cycle, running, max_cycles, keep):
    def going(loop):
        index, carry, _ = loop
        return any_lane(running(carry)) & (index < max_cycles)

    def body(loop):
        index, carry, history = loop
        if keep:
            history = _put(history, index, carry)
        return index + 1, cycle(parameters, carry), history

    history = _stack_of(carry, max_cycles) if keep else None
    count, carry, history = lax.while_loop(going, body, (0, carry, history))
    return carry, history, count


_loop = eqx.filter_custom_jvp(_run)


@_loop.def_jvp
def _loop_jvp(primals, tangents):
    parameters, carry, cycle, running, max_cycles, keep = primals
    parameter_tangents, carry_tangents, *_ = tangents
    final, history, count = _run(parameters, carry, cycle, running, max_cycles, True)

    differentiated = jax.tree.map(
        lambda t: t is not None, parameter_tangents, is_leaf=lambda t: t is None
    )
    varied, fixed = eqx.partition(parameters, differentiated)
    _, discrete_stack = eqx.partition(history, eqx.is_inexact_array)
    moving = eqx.filter(carry, eqx.is_inexact_array)
    carry_tangents = eqx.combine(
        eqx.filter(carry_tangents, eqx.is_inexact_array),
        jax.tree.map(jnp.zeros_like, moving),
    )

    def linearized(index):
        """The cycle at its place in the flight, over what is differentiated only."""
        discrete = _take(discrete_stack, index)

        def advance(varied, moving):
            after = cycle(eqx.combine(varied, fixed), eqx.combine(moving, discrete))
            return eqx.filter(after, eqx.is_inexact_array)

        at = varied, _take(eqx.filter(history, eqx.is_inexact_array), index)
        return advance, at

    def push(inputs):
        varied_tangent, moving_tangent, stack = inputs

        def body(loop):
            index, tangent, stack = loop
            if keep:
                stack = _put(stack, index, tangent)
            advance, at = linearized(index)
            _, tangent = jax.jvp(advance, at, (varied_tangent, tangent))
            return index + 1, tangent, stack

        _, tangent, stack = lax.while_loop(
            lambda loop: loop[0] < count, body, (0, moving_tangent, stack)
        )
        return jax.tree.map(jnp.zeros_like, varied_tangent), tangent, stack

    def pull(cotangents):
        _, moving_cotangent, stack = cotangents

        def body(loop):
            index, parameter_cotangent, cotangent = loop
            index = index - 1
            advance, at = linearized(index)
            _, transpose = jax.vjp(advance, *at)
            more, cotangent = transpose(cotangent)
            if keep:
                cotangent = _add(cotangent, _take(stack, index))
            return index, _add(parameter_cotangent, more), cotangent

        start = count, jax.tree.map(jnp.zeros_like, varied), moving_cotangent
        _, parameter_cotangent, cotangent = lax.while_loop(
            lambda loop: loop[0] > 0, body, start
        )
        return parameter_cotangent, cotangent, jax.tree.map(jnp.zeros_like, stack)

    # `custom_linear_solve` is the one public primitive that lets a linear map carry its
    # own transpose through jvp, transposition and vmap. It is used for that alone: the
    # map takes (parameters, carry, 0) to (0, final carry, history). It insists that all
    # its inputs are linear in the tangents, hence the zero that ties them together.
    stack = _stack_of(moving, max_cycles) if keep else None
    inputs = parameter_tangents, carry_tangents, stack
    tie = 0.0 * sum(jnp.sum(t) for t in jax.tree.leaves(inputs[:2]))
    inputs = jax.tree.map(lambda t: t + tie, inputs)
    _, tangent, stack = lax.custom_linear_solve(
        lambda x: x,
        inputs,
        solve=lambda _, inputs: push(inputs),
        transpose_solve=lambda _, cotangents: pull(cotangents),
    )
    out = final, history if keep else None, count
    return out, (tangent, stack, None)
