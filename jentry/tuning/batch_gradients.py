"""Outputs of a batch of flights, and the gradient of a loss of them, in constant memory.

The loss is a function of all flights at once (a percentile, a worst case), so it is
differentiated in two passes: the flights, then the loss with respect to what they gave,
then flight by flight the gradient of that much of its numbers. No pass keeps more than a
cache-full of flights and the outputs.
"""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, PyTree

from ..addresses import replace_leaves
from ..campaign.batch import LANES, on_devices, over_runs
from ..campaign.campaign import fly_run
from ..flight.flight import Flight
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..flight.termination import has_end
from .parameters import Free, Parameters


Outputs = Callable[[Scenario, Flight], Any]
"""What is looked at of a flight, such as `misses`: a pytree of numbers"""

Loss = Callable[[Any], Any]
"""A number of the outputs of many flights, each of shape (flights, ...)"""

FORWARD_UP_TO = 8
"""Parameters. Measured: a tangent costs 1.7 of a flight, and reverse mode 11."""

ROUNDING = 1e-12
"""Of the derivative to the parameter that matters most to a flight: what is smaller
does not reach it"""

_BEYOND_MEASURE = 1e6
"""Times the median of the flights beside it: the derivative of a flight that diverges.
It is judged by the outputs of the flights alone, whatever the loss makes of them: the
flights of a tail, on which a loss may look alone, have usual derivatives."""


class Problem(eqx.Module):
    """What is flown with which parameters, and what is looked at."""

    scenario: Scenario
    parameters: Parameters
    outputs: Outputs = eqx.field(static=True)
    solver: AbstractSolver
    history: float | None = eqx.field(static=True)

    def __call__(
        self, free: Free, inputs: dict[str, Array]
    ) -> tuple[Any, Bool[Array, ""]]:
        """Outputs of one run, and whether it has an end and all of them are finite."""
        # The tuned values are nominal ones: a tuned entry point moves the target along.
        tuned = replace_leaves(self.scenario, self.parameters.values(free))
        flight, aimed = fly_run(tuned, inputs, self.solver, self.history)
        outputs = jax.tree.map(jnp.asarray, self.outputs(aimed, flight))
        finite = all_finite(outputs) & has_end(flight.outcome)
        return outputs, finite


class Gradient(eqx.Module):
    """Of a loss, with respect to the free numbers."""

    total: Free
    reached: dict[str, Array]
    """Flights to which the parameter makes a difference, by address"""
    counted: Array
    """Flights that the loss looks at"""
    failed: Array
    """Of these, those that were left out: their gradient is not finite, or the derivative
    of their outputs is beyond all measure"""


def all_finite(tree: PyTree) -> Bool[Array, ""]:
    """Whether every number is finite."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array))
    if not leaves:
        return jnp.ones((), bool)
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


@eqx.filter_jit
def batch_outputs(
    problem: Problem, free: Free, inputs: dict[str, Array], devices: int
) -> tuple[Any, Bool[Array, " runs"]]:
    """Outputs of every run, and which of the runs are finite."""
    return over_runs(
        lambda shared, run: shared[0](shared[1], run), (problem, free), inputs, devices
    )


@eqx.filter_jit
def batch_jacobian(
    problem: Problem, free: Free, inputs: dict[str, Array], devices: int
) -> tuple[Any, Any, Bool[Array, " runs"], Float[Array, " runs"]]:
    """Outputs of every run, their Jacobian by forward mode, which runs are finite, and
    the size of the derivatives of each; NaN if one of them is not finite."""

    def one(shared, run):
        problem, free = shared

        def outputs(free):
            outputs, finite = problem(free, run)
            moving = eqx.filter(outputs, eqx.is_inexact_array)
            return moving, (outputs, finite)

        jacobian, (outputs, finite) = jax.jacfwd(outputs, has_aux=True)(free)
        size = jnp.where(all_finite(jacobian), _along_ones(jacobian, free), jnp.nan)
        return outputs, jacobian, finite, size

    return over_runs(one, (problem, free), inputs, devices)


def _along_ones(jacobian: Any, free: Free) -> Float[Array, ""]:
    """Size of the derivatives of a flight, by which flights are compared: the largest of
    its outputs when all free numbers move alike. What is not finite counts as nothing."""
    is_row = lambda node: isinstance(node, dict) and node.keys() == free.keys()

    def along(row: dict[str, Array]) -> Array:
        moved = [jnp.sum(s, axis=_last(free[a].ndim)) for a, s in row.items()]
        return _largest(sum(moved, jnp.zeros(())))

    rows = jax.tree.leaves(jacobian, is_leaf=is_row)
    return functools.reduce(jnp.maximum, map(along, rows), jnp.zeros(()))


def _last(count: int) -> tuple[int, ...]:
    return tuple(range(-count, 0))


def _largest(x: Array) -> Array:
    return jnp.max(jnp.where(jnp.isfinite(x), jnp.abs(x), 0.0), initial=0.0)


def within_measure(sizes: Float[Array, " flights"]) -> Bool[Array, " flights"]:
    """Which flights do not diverge: the derivatives of one that does are larger than
    those of the flights beside it by orders of magnitude."""
    usual = jnp.nanmedian(jnp.where(sizes > 0.0, sizes, jnp.nan))
    return jnp.isfinite(sizes) & ~(sizes > _BEYOND_MEASURE * usual)


@eqx.filter_jit
def loss_and_weights(loss: Loss, outputs: Any) -> tuple[Array, Any]:
    """The loss, and its derivative with respect to every output of every flight."""
    if not jax.tree.leaves(eqx.filter(outputs, eqx.is_inexact_array)):
        raise ValueError("the outputs have no number to differentiate, only integers")
    return eqx.filter_value_and_grad(lambda outputs: _scalar(loss(outputs)))(outputs)


def _scalar(loss: Any) -> Array:
    if jnp.shape(loss) != ():
        raise ValueError(
            f"the loss has shape {jnp.shape(loss)}: it must be one number, such as "
            "jnp.mean(misses.downrange**2)"
        )
    return jnp.asarray(loss, float)


@eqx.filter_jit
def batch_gradient(
    problem: Problem,
    free: Free,
    inputs: dict[str, Array],
    weights: Any,
    devices: int,
    forward: bool,
) -> Gradient:
    """Gradient of the sum of weights times outputs, over all runs.

    A flight whose gradient is not finite, or whose outputs have derivatives beyond all
    measure, adds nothing.
    """

    def of_run(shared, run) -> tuple[Free, Array]:
        """Of one flight, and the size of the derivatives of its outputs."""
        problem, free = shared
        inputs, weights = run

        def moving(free):
            outputs, _ = problem(free, inputs)
            return eqx.filter(outputs, eqx.is_inexact_array)

        if forward:
            jacobian = jax.jacfwd(moving)(free)
            return _contracted(weights, jacobian, free), _along_ones(jacobian, free)

        def weighted(free):
            products = jax.tree.map(
                lambda w, x: jnp.sum(jnp.where(w != 0.0, w * x, 0.0)),
                weights,
                moving(free),
            )
            return sum(jax.tree.leaves(products), jnp.zeros(()))

        ones = jax.tree.map(jnp.ones_like, free)
        _, moved = jax.jvp(moving, (free,), (ones,))
        size = functools.reduce(jnp.maximum, map(_largest, jax.tree.leaves(moved)))
        return jax.grad(weighted)(free), size

    def of_chunk(shared, chunk) -> Gradient:
        """Of a cache-full of flights, summed."""
        gradients, moved = jax.vmap(lambda run: of_run(shared, run))(chunk)
        counts = jax.vmap(_any)(chunk[1])
        sizes = {a: jax.vmap(_size)(g) for a, g in gradients.items()}
        size = functools.reduce(jnp.maximum, sizes.values())
        measured = jnp.isfinite(size) & within_measure(moved)
        kept = counts & measured

        def total(gradient):
            keep = kept.reshape(-1, *[1] * (gradient.ndim - 1))
            return jnp.sum(jnp.where(keep, gradient, 0.0), axis=0)

        reached = {
            a: jnp.sum(kept & (s > 0.0) & (s > ROUNDING * size))
            for a, s in sizes.items()
        }
        failed = jnp.sum(counts & ~measured)
        summed = {a: total(g) for a, g in gradients.items()}
        return Gradient(summed, reached, jnp.sum(counts), failed)

    def on_one_device(shared, runs):
        chunks = jax.tree.map(lambda x: x.reshape(-1, LANES, *x.shape[1:]), runs)

        def add(total, chunk):
            return jax.tree.map(jnp.add, total, of_chunk(shared, chunk)), None

        first = jax.tree.map(lambda x: x[0], chunks)
        shapes = jax.eval_shape(lambda: of_chunk(shared, first))
        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        total, _ = lax.scan(add, nothing, chunks)
        return jax.tree.map(lambda x: x[None], total)

    parts = on_devices(on_one_device, (problem, free), (inputs, weights), devices)
    return jax.tree.map(lambda x: jnp.sum(x, axis=0), parts)


def _contracted(weights: Any, jacobian: Any, free: Free) -> Free:
    """Weights times the Jacobian. An output without weight need not have a derivative."""
    leaves, structure = jax.tree.flatten(weights)
    rows = structure.flatten_up_to(jacobian)

    def to(address: str) -> Array:
        total = jnp.zeros_like(free[address])
        for weight, row in zip(leaves, rows, strict=True):
            column = row[address].reshape(weight.size, *free[address].shape)
            each = jnp.reshape(weight, (-1, *[1] * free[address].ndim))
            total += jnp.sum(jnp.where(each != 0.0, each * column, 0.0), axis=0)
        return total

    return {address: to(address) for address in free}


def _any(tree: PyTree) -> Bool[Array, ""]:
    leaves = [jnp.any(x != 0.0) for x in jax.tree.leaves(tree)]
    return jnp.any(jnp.stack(leaves)) if leaves else jnp.zeros((), bool)


def _size(tree: PyTree) -> Array:
    """Largest magnitude; NaN if there is one."""
    return jnp.max(jnp.abs(tree))


def where_finite(outputs: Any, finite: np.ndarray) -> Any:
    """The outputs of the finite runs."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[finite]), outputs)


def put_back(values: Any, finite: np.ndarray) -> Any:
    """Values of the finite runs among all runs; zero for the others."""

    def put(x: Float[Array, "..."]):
        everywhere = np.zeros((len(finite), *x.shape[1:]), x.dtype)
        everywhere[finite] = x
        return jnp.asarray(everywhere)

    return jax.tree.map(put, values)
