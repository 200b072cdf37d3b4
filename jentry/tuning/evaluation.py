"""Loss and gradient of a batch at one point, with what cannot be flown left out."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ..campaign.batch import filled_up
from ..campaign.campaign import drawn_inputs
from ..campaign.dispersions import Dispersion
from .batch_gradients import (
    ROUNDING,
    Loss,
    Problem,
    batch_gradient,
    batch_jacobian,
    batch_outputs,
    loss_and_weights,
    put_back,
    where_finite,
    within_measure,
)
from .differences import Fly, Slope, gradient_by_differences, slope_along
from .parameters import Free


_NUDGE = 1e-13
"""Of a free number: some hundred roundings of the value that it stands for, and far
less than what a difference of the loss is to be told from"""


class LinearResiduals(eqx.Module):
    """Residuals and their Jacobian about a point, in as few rows as there are columns.

    Of many rows only the triangle of their QR factorization is kept: it has the same
    norms, and what a least-squares solver needs no longer grows with the flights.
    """

    residuals: Float[Array, " rows"]
    jacobian: dict[str, Array]
    """By address, each of shape (rows, ...)"""


class Evaluation(eqx.Module):
    """What is known of one point."""

    loss: float
    """Of the exact law, over the draws that are the same for all points"""
    followed: float
    """Of the law and the draws of the gradient: the same, unless these are others"""
    gradient: Free
    failed: int
    """Flights of the exact law that are not finite, and that the loss leaves out"""
    gradients_failed: int
    """Flights whose gradient is left out: not finite, or of outputs whose derivatives are
    beyond all measure; by differences, flights that are not finite on both sides"""
    reached: dict[str, float]
    """Share of the flights that the loss looks at to which each parameter matters"""
    linear: LinearResiduals | None = None
    """For least squares"""
    gradient_error: float = np.nan
    """Standard error of a gradient by differences"""


class Evaluator:
    """Evaluates points: loss and gradient, or residuals and their Jacobian."""

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
        difference: float | None = None,
    ):
        """The gradient is that of `followed`, and the loss that of `exact`.

        With a `difference` the gradient is by central differences of that step.
        """
        self._exact, self._followed, self._loss_of = exact, followed, loss
        self._dispersions, self._key, self._runs = dispersions, key, runs
        self._fresh_draws, self._forward = fresh_draws, forward
        self._least_squares, self._difference = least_squares, difference
        self._devices = len(jax.devices())
        self._inputs = self._draw(0)
        self._apart = followed is not exact or fresh_draws
        batches = 1 if difference is None else 1 + 2 * exact.parameters.count
        self.flights_per_step = (batches + self._apart) * runs

    def __call__(self, free: Free, step: int) -> Evaluation:
        """At a point, in a step that has draws of its own if they are fresh."""
        if self._least_squares:
            evaluation = self._by_residuals(free)
        elif self._difference is not None:
            evaluation = self._by_differences(free, self._drawn(step))
        else:
            evaluation = self._by_gradient(free, self._drawn(step))
        if not self._apart:
            return evaluation
        loss, _, failed = self._loss(self._exact, free, self._inputs)
        return eqx.tree_at(lambda e: (e.loss, e.failed), evaluation, (loss, failed))

    def loss(self, free: Free) -> float:
        """Of the exact law, at a point."""
        return self._loss(self._exact, free, self._inputs)[0]

    def slope_along(self, free: Free, direction: Free, step: int, size: float) -> Slope:
        """Central difference of the loss that is followed, of a step of this size to both
        sides, with the draws of the gradient of a step of tuning."""
        fly = self._flown(self._drawn(step))
        return slope_along(fly, self._loss_of, free, direction, size)

    def _flown(self, inputs) -> Fly:
        given, counted = inputs

        def fly(free: Free) -> tuple[Any, np.ndarray]:
            outputs, finite = batch_outputs(self._followed, free, given, self._devices)
            return outputs, np.asarray(finite) & counted

        return fly

    def rounding(self, free: Free, step: int, loss: float) -> float:
        """Of the loss that is followed: how much it changes by itself when all free
        numbers change by their rounding."""
        ones = {a: jnp.ones_like(x) for a, x in free.items()}
        inputs = self._drawn(step)
        changes = []
        for nudge in (_NUDGE, -_NUDGE):
            nudged = _moved(free, ones, nudge)
            changes.append(abs(self._loss(self._followed, nudged, inputs)[0] - loss))
        return max((change for change in changes if np.isfinite(change)), default=0.0)

    def _drawn(self, step: int) -> tuple[dict[str, Array], np.ndarray]:
        """The draws of a gradient."""
        return self._draw(step + 1) if self._fresh_draws else self._inputs

    def _draw(self, step: int) -> tuple[dict[str, Array], np.ndarray]:
        """Inputs of the runs of a step, filled up, and which of them count."""
        runs = filled_up(step * self._runs + np.arange(self._runs), self._devices)
        inputs = drawn_inputs(self._exact.scenario, self._dispersions, self._key, runs)
        return inputs, np.arange(len(runs)) < self._runs

    def _loss(self, problem: Problem, free: Free, inputs) -> tuple[float, Any, int]:
        """Loss of the finite runs, its derivative to all outputs, and how many are not."""
        given, counted = inputs
        outputs, finite = batch_outputs(problem, free, given, self._devices)
        finite = np.asarray(finite) & counted
        failed = self._runs - int(finite.sum())
        if not finite.any():
            nothing = eqx.filter(outputs, eqx.is_inexact_array)
            return np.inf, jax.tree.map(jnp.zeros_like, nothing), failed
        loss, weights = loss_and_weights(self._loss_of, where_finite(outputs, finite))
        return float(loss), put_back(weights, finite), failed

    def _by_gradient(self, free: Free, inputs) -> Evaluation:
        loss, weights, failed = self._loss(self._followed, free, inputs)
        gradient = batch_gradient(
            self._followed, free, inputs[0], weights, self._devices, self._forward
        )
        counted = max(int(gradient.counted), 1)
        reached = {a: int(n) / counted for a, n in gradient.reached.items()}
        left_out = int(gradient.failed)
        return Evaluation(loss, loss, gradient.total, failed, left_out, reached)

    def _by_differences(self, free: Free, inputs) -> Evaluation:
        """See `differences`. The loss is that of the point itself."""
        assert self._difference is not None
        loss, _, failed = self._loss(self._followed, free, inputs)
        found = gradient_by_differences(
            self._flown(inputs), self._runs, self._loss_of, free, self._difference
        )
        left_out = max(found.failed - failed, 0)
        return Evaluation(
            loss,
            loss,
            found.gradient,
            failed,
            left_out,
            found.reached,
            gradient_error=found.error,
        )

    def _by_residuals(self, free: Free) -> Evaluation:
        given, counted = self._inputs
        outputs, jacobian, finite, sizes = batch_jacobian(
            self._followed, free, given, self._devices
        )
        finite = np.asarray(finite) & counted
        flights = int(finite.sum())
        failed = self._runs - flights
        nothing = jax.tree.map(jnp.zeros_like, free)
        if not flights:
            unreached = dict.fromkeys(free, 0.0)
            linear = LinearResiduals(
                jnp.full((_rows(free),), jnp.inf),
                {a: jnp.zeros((_rows(free), *x.shape)) for a, x in free.items()},
            )
            return Evaluation(np.inf, np.inf, nothing, failed, 0, unreached, linear)
        smooth = np.asarray(within_measure(sizes[finite]))
        residuals, slopes = residuals_and_slopes(
            self._loss_of.residuals,
            where_finite(outputs, finite),
            _zero_unless(smooth, where_finite(jacobian, finite)),
        )
        loss = float(np.sum(residuals**2)) / flights
        gradient = {
            a: 2.0 * jnp.asarray(np.tensordot(residuals, s, 2)) / flights
            for a, s in slopes.items()
        }
        # A flight that failed is as bad as the worst, and flat.
        missing = failed * np.max(np.sum(residuals**2, axis=1))
        linear = _compressed(residuals, slopes, missing, self._runs)
        left_out = flights - int(smooth.sum())
        return Evaluation(
            loss, loss, gradient, failed, left_out, _reached(slopes), linear
        )


def _moved(free: Free, direction: Free, size: float) -> Free:
    return {a: x + size * direction[a] for a, x in free.items()}


def residuals_and_slopes(
    residuals, outputs: Any, jacobian: Any
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Residuals of shape (flights, n) and their Jacobian, (flights, n, ...) by address."""
    found = _residuals_and_slopes(residuals, outputs, jacobian)
    return jax.tree.map(np.asarray, found)


@eqx.filter_jit
def _residuals_and_slopes(residuals, outputs: Any, jacobian: Any):
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
    leaves, structure = jax.tree.flatten(moving)

    def along(tangent):
        function = lambda moving: stacked(eqx.combine(moving, fixed))
        return jax.jvp(function, (moving,), (tangent,))[1]

    # The Jacobian is a dictionary by address in place of each output; turned around, it
    # has for each address tangents of all outputs, with the numbers of the leaf last.
    by_output = structure.flatten_up_to(jacobian)
    slopes = {}
    for address in by_output[0]:
        shape = by_output[0][address].shape[leaves[0].ndim :]
        tangents = structure.unflatten(
            [
                by_address[address].reshape(*leaf.shape, -1)
                for leaf, by_address in zip(leaves, by_output, strict=True)
            ]
        )
        columns = jax.vmap(along, in_axes=-1, out_axes=-1)(tangents)
        slopes[address] = columns.reshape(*columns.shape[:2], *shape)
    return stacked(outputs), slopes


def _zero_unless(smooth: np.ndarray, jacobian: Any) -> Any:
    def zeroed(x):
        keep = smooth.reshape(-1, *[1] * (x.ndim - 1))
        return jnp.asarray(np.where(keep, np.asarray(x), 0.0))

    return jax.tree.map(zeroed, jacobian)


def _rows(free: Free) -> int:
    return sum(x.size for x in free.values()) + 1


def _compressed(
    residuals: np.ndarray, slopes: dict[str, np.ndarray], missing: float, runs: int
) -> LinearResiduals:
    """Over the square root of the runs; `missing` is added to the sum of squares."""
    count = residuals.size
    columns = [slope.reshape(count, -1) for slope in slopes.values()]
    table = np.concatenate([*columns, residuals.reshape(count, 1)], axis=1)
    wide = table.shape[1]
    # At least as many rows as columns, and one of them for what is missing.
    table = np.concatenate([table, np.zeros((wide, wide))])
    table[-1, -1] = np.sqrt(missing)
    triangle = np.asarray(np.linalg.qr(table / np.sqrt(runs), mode="r"))
    jacobian, begin = {}, 0
    for (address, slope), column in zip(slopes.items(), columns, strict=True):
        end = begin + column.shape[1]
        part = triangle[:, begin:end].reshape(wide, *slope.shape[2:])
        jacobian[address], begin = jnp.asarray(part), end
    return LinearResiduals(jnp.asarray(triangle[:, -1]), jacobian)


def _reached(slopes: dict[str, np.ndarray]) -> dict[str, float]:
    """Share of the flights to which each parameter matters, beyond rounding."""
    sizes = {
        a: np.max(np.abs(s.reshape(len(s), -1)), axis=1) for a, s in slopes.items()
    }
    largest = np.max(list(sizes.values()), axis=0)
    return {
        a: float(np.mean((size > 0.0) & (size > ROUNDING * largest)))
        for a, size in sizes.items()
    }
