"""Values that are computed once per process."""

import contextlib
import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import jax

from ._programs import is_tracing


P = ParamSpec("P")
R = TypeVar("R")


def computed_once(function: Callable[P, R]) -> Callable[P, R]:
    """`functools.cache` for functions whose results contain arrays.

    If the first call happens while JAX traces, a plain cache would store tracers, which are
    valid only in that trace, and return them to later calls.
    """

    @functools.cache
    def of_known_numbers(*given: P.args, **named: P.kwargs) -> R:
        with known_numbers():
            return function(*given, **named)

    cached = functools.update_wrapper(of_known_numbers, function)
    return cast(Callable[P, R], cached)  # the type of a plain cache lacks the arguments


def known_numbers() -> contextlib.AbstractContextManager:
    """A context in which all numbers are known, even while JAX traces.

    Without tracing it does nothing: the context of JAX would take `sx-2` 1.25 s instead of
    1 s.
    """
    return jax.ensure_compile_time_eval() if is_tracing() else contextlib.nullcontext()
