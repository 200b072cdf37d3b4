"""Functions that the compiler does not inline into their callers."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer
from jax.experimental.xla_metadata import set_xla_metadata


P = ParamSpec("P")
R = TypeVar("R")


def apart(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function as `eqx.filter_jit` does, without inlining it into its callers.

    XLA inlines a function into its callers, and repeats cheap operations there for each of
    their uses. A large function then takes several times as long to compile and to run. A
    function that is not inlined computes nothing twice, and stores its results. This helps
    if much is computed in every stage of a step: 512 flights of `sx-2` take 0.38 s instead
    of 0.60 s (`full`), and 0.32 s instead of 0.41 s (`small-angle`). Measure it: if the
    command of every law is not inlined, flights of Mars in the plane take 5 % longer, and
    those of `rlv` 8 %.
    """
    compiled = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*given: P.args, **named: P.kwargs) -> R:
        return jax.tree.map(_called, compiled(*given, **named))

    return call


def _called(result: Any) -> Any:
    """A result of a call that must not be inlined."""
    if not isinstance(result, Tracer):
        return result
    return set_xla_metadata(result, inlineable="false")  # marks the call
