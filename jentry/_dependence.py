"""Dependence of the outputs of a function on its inputs, from its traced form."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from .fields import Scalar


_CALLS = {"jit", "pjit", "closed_call", "remat2", "checkpoint", "custom_jvp_call"}
"""Operations that only call a traced function: each of their outputs is examined by itself.
Every output of any other operation counts as depending on every input."""


class Traced:
    """A function that is traced once and may be called many times.

    Comparisons, selections and `stop_gradient` propagate a dependence. No dependence is
    overlooked, whatever the values are. A false dependence may be found if a loop or a
    branch has several outputs, or if an input is multiplied by zero.
    """

    def __init__(self, function: Callable[..., Any], *inputs: Any):
        self._closed, outputs = jax.make_jaxpr(function, return_shape=True)(*inputs)
        self._structure = jax.tree.structure(outputs)

    def __call__(self, *inputs: Any) -> Any:
        # A constant is returned as a NumPy number.
        outputs = map(jnp.asarray, jaxpr_as_fun(self._closed)(*inputs))
        return jax.tree.unflatten(self._structure, outputs)

    def depends(self) -> bool:
        """Whether any output of the function depends on its inputs."""
        return any(self._dependent())

    def depending(self) -> Any:
        """Whether each output depends on the inputs, in the structure of the outputs."""
        return jax.tree.unflatten(self._structure, self._dependent())

    def independent(self, where: Callable[[Any], Any]) -> Scalar | None:
        """The number at a place of the output; None if it depends on the inputs.

        Only the operations that are needed for this number are computed.
        """
        jaxpr = self._closed.jaxpr
        places = jax.tree.unflatten(self._structure, range(len(jaxpr.outvars)))
        place = where(places)
        if self._dependent()[place]:
            return None
        wanted = set(filter(_is_variable, [jaxpr.outvars[place]]))
        needed = []
        for equation in reversed(jaxpr.eqns):
            if wanted.intersection(equation.outvars):
                needed.append(equation)
                wanted.update(filter(_is_variable, equation.invars))
        lean = jaxpr.replace(eqns=needed[::-1], outvars=[jaxpr.outvars[place]])
        nothing = (jnp.zeros(v.aval.shape, v.aval.dtype) for v in jaxpr.invars)
        value = jaxpr_as_fun(ClosedJaxpr(lean, self._closed.consts))(*nothing)[0]
        return jnp.asarray(value)

    def _dependent(self) -> list[bool]:
        jaxpr = self._closed.jaxpr
        return _dependent(jaxpr, [True] * len(jaxpr.invars))


def _is_variable(v: Any) -> bool:
    return not isinstance(v, Literal)


def _dependent(jaxpr: Jaxpr, dependent_inputs: Sequence[bool]) -> list[bool]:
    """Whether each output of a traced function depends on the marked inputs."""
    dependent = {v for v, r in zip(jaxpr.invars, dependent_inputs, strict=True) if r}

    def is_dependent(v: Any) -> bool:
        return _is_variable(v) and v in dependent

    for equation in jaxpr.eqns:
        inputs = [is_dependent(v) for v in equation.invars]
        if not any(inputs):
            continue
        inner = _called(equation)
        outputs = _dependent(inner, inputs) if inner else [True] * len(equation.outvars)
        dependent.update(v for v, r in zip(equation.outvars, outputs, strict=True) if r)
    return [is_dependent(v) for v in jaxpr.outvars]


def _called(equation: Any) -> Jaxpr | None:
    if equation.primitive.name not in _CALLS:
        return None
    inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
    inner = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
    fits = isinstance(inner, Jaxpr) and len(inner.invars) == len(equation.invars)
    return inner if fits else None
