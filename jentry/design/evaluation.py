"""Loss and gradient of a batch at one point, with what cannot be flown left out."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ..campaign.dispersions import Dispersion
from ..campaign.monte_carlo import drawn_inputs, filled_up
from .batch_gradient import (
    Loss,
    Problem,
    batch_gradient,
    batch_jacobian,
    batch_outputs,
    loss_and_weights,
    put_back,
    where_finite,
)
from .parameters import Free


class Evaluation(eqx.Module):
    """What is known of one point."""

    loss: float
    gradient: Free
    not_finite: int
    """Flights that are not, or whose derivatives are not"""
    residuals: Float[Array, " residuals"] | None = None
    jacobian: Any = None
    """Of the residuals, by address, each of shape (residuals, ...)"""
    reached: dict[str, float] = eqx.field(default_factory=dict)
    """Share of the flights that the loss looks at to which each parameter matters"""


class Evaluator:
    """Loss and gradient at a point, by what the stepper needs."""

    def __init__(
        self,
        exact: Problem,
        followed: Problem,
        loss: Loss,
        dispersions: Mapping[str, Dispersion],
        key: Key[Array, ""],
        runs: int,
        *,
        fresh_draws: bool,
        forward: bool,
        least_squares: bool,
    ):
        """The gradient is that of `followed`, and the loss that of `exact`."""
        self._exact, self._followed, self._loss_of = exact, followed, loss
        self._dispersions, self._key, self._runs = dispersions, key, runs
        self._fresh_draws, self._forward = fresh_draws, forward
        self._least_squares = least_squares
        self._devices = len(jax.devices())
        self._inputs = self._draw(0)
        self._apart = followed is not exact or fresh_draws
        self.flights_per_step = (2 if self._apart else 1) * runs

    def _draw(self, step: int) -> tuple[dict[str, Array], np.ndarray]:
        """Inputs of the runs of a step, filled up, and which of them count."""
        runs = filled_up(step * self._runs + np.arange(self._runs), self._devices)
        inputs = drawn_inputs(self._exact.scenario, self._dispersions, self._key, runs)
        return inputs, np.arange(len(runs)) < self._runs

    def __call__(self, free: Free, step: int) -> Evaluation:
        if self._least_squares:
            return self._residuals(free)
        inputs = self._draw(step + 1) if self._fresh_draws else self._inputs
        loss, weights, not_finite = self._loss(self._followed, free, inputs)
        if self._apart:
            loss, _, not_finite = self._loss(self._exact, free, self._inputs)
        gradient = batch_gradient(
            self._followed, free, inputs[0], weights, self._devices, self._forward
        )
        counted = max(int(gradient.counted), 1)
        reached = {a: int(n) / counted for a, n in gradient.reached.items()}
        not_finite += int(gradient.not_finite)
        return Evaluation(loss, gradient.total, not_finite, reached=reached)

    def _loss(self, problem: Problem, free: Free, inputs) -> tuple[float, Any, int]:
        """Loss of the finite runs, its derivative to all outputs, and how many are not."""
        given, counted = inputs
        outputs, finite = batch_outputs(problem, free, given, self._devices)
        finite = np.asarray(finite) & counted
        not_finite = self._runs - int(finite.sum())
        if not finite.any():
            nothing = eqx.filter(outputs, eqx.is_inexact_array)
            return np.inf, jax.tree.map(jnp.zeros_like, nothing), not_finite
        loss, weights = loss_and_weights(self._loss_of, where_finite(outputs, finite))
        return float(loss), put_back(weights, finite), not_finite

    def _residuals(self, free: Free) -> Evaluation:
        given, counted = self._inputs
        outputs, jacobian, finite = batch_jacobian(
            self._followed, free, given, self._devices
        )
        finite = np.asarray(finite) & counted
        nothing = jax.tree.map(jnp.zeros_like, free)
        if not finite.any():
            unreached = dict.fromkeys(free, 0.0)
            return Evaluation(np.inf, nothing, self._runs, reached=unreached)
        residuals, slopes = _residuals(
            self._loss_of.residuals,
            where_finite(outputs, finite),
            where_finite(jacobian, finite),
        )
        flights = int(finite.sum())
        not_finite = self._runs - flights
        loss = float(jnp.sum(residuals**2)) / flights
        gradient = {
            a: 2.0 * jnp.tensordot(residuals.ravel(), _rows(s), 1) / flights
            for a, s in slopes.items()
        }
        if self._apart:
            loss, _, not_finite = self._loss(self._exact, free, self._inputs)
        reached = {a: _share_reached(slope) for a, slope in slopes.items()}
        if flights < self._runs:
            # As many rows as ever: a flight that failed is as bad as the worst, and flat.
            worst = jnp.max(jnp.abs(residuals))
            missing = self._runs - flights
            residuals = _with_rows(residuals, missing, worst)
            slopes = {a: _with_rows(s, missing, 0.0) for a, s in slopes.items()}
        scale = 1.0 / np.sqrt(self._runs)
        return Evaluation(
            loss,
            gradient,
            not_finite,
            scale * residuals.ravel(),
            {a: scale * _rows(s) for a, s in slopes.items()},
            reached,
        )


@eqx.filter_jit
def _residuals(
    residuals, outputs: Any, jacobian: Any
) -> tuple[Array, dict[str, Array]]:
    """Residuals of shape (flights, n) and their Jacobian, (flights, n, ...) by address."""

    def stacked(outputs):
        columns = jax.tree.leaves(residuals(outputs))
        flights = len(jax.tree.leaves(outputs)[0])
        for column in columns:
            if jnp.shape(column) != (flights,):
                raise ValueError(
                    f"a residual has shape {jnp.shape(column)}: give one number for "
                    f"each of the {flights} flights"
                )
        return jnp.stack(columns, axis=1)

    moving, fixed = eqx.partition(outputs, eqx.is_inexact_array)

    def along(tangent):
        function = lambda moving: stacked(eqx.combine(moving, fixed))
        return jax.jvp(function, (moving,), (tangent,))[1]

    # The Jacobian has the structure of the outputs, with the addresses at its leaves.
    by_address = _turned_around(moving, jacobian)
    slopes = {}
    for address, (tangent, shape) in by_address.items():
        columns = jax.vmap(along, in_axes=-1, out_axes=-1)(tangent)
        slopes[address] = columns.reshape(*columns.shape[:2], *shape)
    return stacked(outputs), slopes


def _turned_around(
    moving: Any, jacobian: Any
) -> dict[str, tuple[Any, tuple[int, ...]]]:
    """By address: tangents of the outputs with the parameter's numbers in one last axis."""
    leaves, structure = jax.tree.flatten(moving)
    inner = structure.flatten_up_to(jacobian)
    found = {}
    for address in inner[0]:
        shape = inner[0][address].shape[leaves[0].ndim :]
        columns = [
            by_address[address].reshape(*leaf.shape, -1)
            for leaf, by_address in zip(leaves, inner, strict=True)
        ]
        found[address] = structure.unflatten(columns), shape
    return found


def _rows(slope: Array) -> Array:
    """(flights, n, ...) as (flights * n, ...)"""
    return slope.reshape(-1, *slope.shape[2:])


def _with_rows(values: Array, count: int, fill: Any) -> Array:
    return jnp.concatenate(
        [values, jnp.full((count, *values.shape[1:]), fill, values.dtype)]
    )


def _share_reached(slope: Array) -> float:
    reached = jnp.any(slope.reshape(len(slope), -1) != 0.0, axis=1)
    return float(jnp.mean(reached))
