"""Derivatives in forward mode, computed in the flight's own loop."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jaxtyping import PyTree

from .._trace_modes import forward_mode_only


def with_tangents(
    function: Callable[[Any], Any],
) -> Callable[[tuple[PyTree, PyTree]], tuple[PyTree, PyTree]]:
    """The function of a run and of directions, with its derivatives along them.

    It returns the values of `function(run)`, and their derivatives of shape
    (directions, ...), with None for those that are no floats. The directions are a pytree
    like the run, of arrays of shape (directions, ...). A few directions are carried along
    with the flight, which needs no memory: so `kernel_of` takes the function.
    """

    def both(given: tuple[PyTree, PyTree]) -> tuple[PyTree, PyTree]:
        run, directions = given

        def along(direction: PyTree) -> tuple[PyTree, PyTree]:
            out, tangents = eqx.filter_jvp(function, (run,), (direction,))
            return out, eqx.filter(tangents, eqx.is_inexact_array)

        with forward_mode_only():
            return jax.vmap(along, out_axes=(None, 0))(directions)

    return both
