"""Outputs of many flights, and the gradient of a loss of them, in constant memory.

The loss is a function of all flights at once, such as a percentile or a worst case. It is
therefore differentiated in two passes. The first pass computes the outputs of all flights
and the derivatives of the loss with respect to them, the weights. The second pass computes,
flight by flight, the gradient of the weighted sum of the outputs. Memory holds the outputs
of all flights, and one batch of flights that fits into the cache.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from ..campaign.batch import over_runs, sum_over_runs
from ..campaign.campaign import fly_run
from ..flight.flight import Flight
from ..flight.scenario import Scenario
from ..flight.solver import AbstractSolver
from ..flight.termination import has_end
from ..parameters.parameters import Free, Parameters, Tangent


Outputs = Callable[[Scenario, Flight], Any]
"""Function of a scenario and its flight that returns a pytree of numbers, like `misses`"""

Loss = Callable[[Any], Any]
"""Function of the outputs of many flights, each of shape (flights, ...): one number"""

FORWARD_UP_TO = 8
"""Largest number of parameters for which forward mode is used.

Measured cost in units of one flight: 1.7 for a tangent, 11 for reverse mode.
"""

ROUNDING = 1e-12
"""Share of the largest derivative of a flight. A parameter whose derivative is smaller has
no effect on the flight"""

_BEYOND_MEASURE = 1e6
"""A flight diverges if its derivative exceeds the median of its batch by this factor.

The derivatives are those of the outputs and not of the loss: a loss may depend on the
flights of a tail only, and the outputs of these flights have usual derivatives.
"""


class Simulation(eqx.Module):
    """How a run is flown, and the outputs that are computed from it."""

    outputs: Outputs = eqx.field(static=True)
    solver: AbstractSolver
    history: float | None = eqx.field(default=None, static=True)
    """Interval (s) at which the history of a flight is stored; None for no history"""

    def __call__(
        self, scenario: Scenario, inputs: dict[str, Array]
    ) -> tuple[Any, Bool[Array, ""]]:
        """Outputs of one run, and whether it has an end and all outputs are finite."""
        flight, dispersed = fly_run(scenario, inputs, self.solver, self.history)
        outputs = jax.tree.map(jnp.asarray, self.outputs(dispersed, flight))
        finite = all_finite(outputs) & has_end(flight.outcome)
        return outputs, finite


class Problem(eqx.Module):
    """A simulation whose scenario depends on parameters."""

    parameters: Parameters | Tangent
    simulation: Simulation

    def __call__(
        self, free: Free, inputs: dict[str, Array]
    ) -> tuple[Any, Bool[Array, ""]]:
        """Outputs of one run at a point, and whether they are finite; see `Simulation`.

        The tuned values are nominal values: a tuned entry point also moves the target.
        """
        return self.simulation(self.parameters.scenario(free), inputs)


class Gradient(eqx.Module):
    """Gradient of a loss with respect to the free numbers."""

    total: Free
    moved: dict[str, Array]
    """Number of flights on which each parameter has an effect, by address"""
    counted: Array
    """Number of flights on which the loss depends"""
    failed: Array
    """Number of counted flights that are left out, because their gradient is not finite or
    because they diverge: the derivatives of their outputs are too large"""


def all_finite(tree: PyTree) -> Bool[Array, ""]:
    """Whether every number is finite."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array))
    if not leaves:
        return jnp.ones((), bool)
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in leaves]))


def batch_outputs(
    simulation: Simulation, scenario: Scenario, inputs: dict[str, Any]
) -> tuple[Any, np.ndarray]:
    """Outputs of all runs in the form that a loss takes, and which runs are finite."""
    large = simulation.history is not None
    outputs, finite = over_runs(_fly, (simulation, scenario), inputs, large=large)
    return jax.tree.map(jnp.asarray, outputs), finite


def _fly(shared: tuple[Simulation, Scenario], inputs: dict[str, Array]) -> Any:
    simulation, scenario = shared
    return simulation(scenario, inputs)


def _along_ones(jacobian: Any, free: Free) -> Float[Array, ""]:
    """Largest derivative of the outputs of a flight when all free numbers change equally.

    Flights are compared by this number. Derivatives that are not finite count as zero.
    """
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
    """Which flights do not diverge.

    The derivatives of a flight that diverges are larger than those of the other flights of
    its batch by orders of magnitude.
    """
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


def batch_gradient(
    problem: Problem, free: Free, inputs: dict[str, Any], weights: Any, forward: bool
) -> Gradient:
    """Gradient of the sum of weights times outputs, over all runs.

    A flight adds nothing if its gradient is not finite or if it diverges; see
    `within_measure`.
    """
    assert isinstance(problem.parameters, Parameters)
    about = dataclasses.replace(problem, parameters=problem.parameters.about(free))
    return sum_over_runs(_gradient_of, (about, free, forward), (inputs, weights))


def _gradient_of(
    shared: tuple[Problem, Free, bool], runs: tuple[dict[str, Array], Any], counts
) -> Gradient:
    """Sum of the gradients of one batch of flights."""
    gradients, moved = jax.vmap(lambda run: _gradient_of_run(shared, run))(runs)
    counts = counts & jax.vmap(_any)(runs[1])
    sizes = {a: jax.vmap(_size)(g) for a, g in gradients.items()}
    size = functools.reduce(jnp.maximum, sizes.values())
    measured = jnp.isfinite(size) & within_measure(moved)
    kept = counts & measured

    def total(gradient):
        keep = kept.reshape(-1, *[1] * (gradient.ndim - 1))
        return jnp.sum(jnp.where(keep, gradient, 0.0), axis=0)

    return Gradient(
        total={a: total(g) for a, g in gradients.items()},
        moved={
            a: jnp.sum(kept & (s > 0.0) & (s > ROUNDING * size))
            for a, s in sizes.items()
        },
        counted=jnp.sum(counts),
        failed=jnp.sum(counts & ~measured),
    )


def _gradient_of_run(
    shared: tuple[Problem, Free, bool], run: tuple[dict[str, Array], Any]
) -> tuple[Free, Array]:
    """Gradient of one flight, and the size of the derivatives of its outputs."""
    problem, free, forward = shared
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


def _contracted(weights: Any, jacobian: Any, free: Free) -> Free:
    """Weights times the Jacobian.

    An output whose weight is zero need not have a finite derivative.
    """
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
    """Largest magnitude; NaN if any number is NaN."""
    return jnp.max(jnp.abs(tree))


def where_finite(outputs: Any, finite: np.ndarray) -> Any:
    """The outputs of the finite runs."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[finite]), outputs)


def put_back(values: Any, finite: np.ndarray) -> Any:
    """Values of the finite runs at their places among all runs, and zero elsewhere."""

    def put(x: Float[Array, "..."]):
        everywhere = np.zeros((len(finite), *x.shape[1:]), x.dtype)
        everywhere[finite] = x
        return jnp.asarray(everywhere)

    return jax.tree.map(put, values)
