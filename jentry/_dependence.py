"""What of a function does not depend on some of its inputs, read from its traced form."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from ._types import Scalar


_CALLS = {"jit", "pjit", "closed_call", "checkpoint", "remat", "custom_jvp_call"}
"""Operations that are a traced function and no more: each output of them is judged by
itself. Of any other one every output counts as depending on every input."""


def depends_on(function: Callable[..., Any], *inputs: Any) -> bool:
    """Whether any number that a function gives depends on its inputs, in any way.

    A comparison, a choice and a `stop_gradient` pass a dependence on. It is never
    overlooked, whatever the values are; where a loop or a branch has several outputs, or
    an input is multiplied by zero, one may be found that is none.
    """
    closed = jax.make_jaxpr(function)(*inputs)
    return any(_reached(closed.jaxpr, [True] * len(closed.jaxpr.invars)))


def value_without(function: Callable[..., Scalar], *inputs: Scalar) -> Scalar | None:
    """The value of a function that does not depend on its inputs; None of one that does.

    Only the operations that lead to the value are made, so that what else the function
    computes costs nothing. See `depends_on`.
    """
    closed = jax.make_jaxpr(function)(*inputs)
    jaxpr = closed.jaxpr
    if any(_reached(jaxpr, [True] * len(jaxpr.invars))):
        return None
    wanted = {v for v in jaxpr.outvars if not isinstance(v, Literal)}
    needed = []
    for equation in reversed(jaxpr.eqns):
        if wanted.intersection(equation.outvars):
            needed.append(equation)
            wanted.update(v for v in equation.invars if not isinstance(v, Literal))
    lean = ClosedJaxpr(jaxpr.replace(eqns=needed[::-1]), closed.consts)
    (value,) = jaxpr_as_fun(lean)(*(jnp.zeros_like(x) for x in inputs))
    return value


def _reached(jaxpr: Jaxpr, reached_inputs: Sequence[bool]) -> list[bool]:
    """Which outputs of a traced function depend on those of its inputs."""
    reached = {v for v, r in zip(jaxpr.invars, reached_inputs, strict=True) if r}

    def is_reached(variable) -> bool:
        return not isinstance(variable, Literal) and variable in reached

    for equation in jaxpr.eqns:
        inputs = [is_reached(v) for v in equation.invars]
        if not any(inputs):
            continue
        inner = _called(equation)
        outputs = _reached(inner, inputs) if inner else [True] * len(equation.outvars)
        reached.update(v for v, r in zip(equation.outvars, outputs, strict=True) if r)
    return [is_reached(v) for v in jaxpr.outvars]


def _called(equation) -> Jaxpr | None:
    if equation.primitive.name not in _CALLS:
        return None
    inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
    inner = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
    fits = isinstance(inner, Jaxpr) and len(inner.invars) == len(equation.invars)
    return inner if fits else None
