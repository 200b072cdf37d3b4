"""Evaluates points of a tuning run: loss, gradient, penalty and the effect of rounding."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..parameters.parameters import Free, Parameters, scenario_at
from .batch_gradients import Loss, Problem, all_finite
from .differences import Slope, slope_along
from .draws import Draws
from .gradients import Evaluation, GradientMethod, Inputs, batch_loss, fly_at
from .penalties import Penalty, penalty_and_slopes


_NUDGE = 1e-13
"""Change of a free number that shows the effect of rounding. It is some hundred times the
rounding error of the value, and far smaller than any step of tuning"""


class Evaluator:
    """Computes loss and gradient at points."""

    def __init__(
        self,
        exact: Problem,
        loss: Loss,
        draws: Draws,
        gradient: GradientMethod,
        penalty: Penalty | None = None,
    ):
        """The loss is computed with `exact`, and the gradient with its surrogate, if any.

        The penalty is added to both losses, and its gradient to the gradient.
        """
        assert isinstance(exact.parameters, Parameters)
        self._exact = self._followed = exact
        if gradient.surrogate is not None:
            smooth = exact.parameters.followed_by(gradient.surrogate)
            self._followed = Problem(smooth, exact.simulation)
        self._loss_of, self._draws, self._gradient = loss, draws, gradient
        self._penalty_of = penalty
        self._nominal = scenario_at(exact.parameters, exact.parameters.at_start)
        self._inputs = self._draw(0)
        self._apart = self._followed is not exact or draws.fresh
        batches = gradient.batches(exact.parameters.count)
        self.flights_per_step = (batches + self._apart) * draws.runs

    def __call__(self, free: Free, step: int) -> Evaluation:
        """Evaluate a point. With fresh draws the gradient uses the draws of this step."""
        inputs = self._drawn(step)
        found = self._gradient(self._followed, self._loss_of, free, inputs)
        if self._apart:
            loss, _, failed = batch_loss(self._exact, self._loss_of, free, self._inputs)
            found = eqx.tree_at(lambda e: (e.loss, e.failed), found, (loss, failed))
        if self._penalty_of is None or not np.isfinite(found.loss):
            return found
        penalty, slopes = self._penalty_with_slopes(free)
        total = {a: g + slopes[a] for a, g in found.gradient.items()}
        return eqx.tree_at(
            lambda e: (e.loss, e.followed, e.gradient),
            found,
            (found.loss + penalty, found.followed + penalty, total),
        )

    def loss(self, free: Free) -> float:
        """Loss of the exact law at a point, including the penalty."""
        flown = batch_loss(self._exact, self._loss_of, free, self._inputs)[0]
        return flown + self.penalty(free)

    def penalty(self, free: Free) -> float:
        """Penalty of the scenario at a point; 0 if there is no penalty."""
        return 0.0 if self._penalty_of is None else self._penalty_with_slopes(free)[0]

    def _penalty_with_slopes(self, free: Free) -> tuple[float, Free]:
        parameters = self._exact.parameters
        assert isinstance(parameters, Parameters) and self._penalty_of is not None
        # Computed once, and not on every device over which the flights are spread.
        free = {a: jnp.asarray(np.asarray(x)) for a, x in free.items()}
        value, slopes = penalty_and_slopes(self._penalty_of, parameters, free)
        if not all_finite((value, slopes)):
            # Infinite, as for flights that are not finite: this is never the best point.
            return np.inf, {a: jnp.zeros_like(x) for a, x in free.items()}
        return float(value), slopes

    def slope_along(self, free: Free, direction: Free, step: int, size: float) -> Slope:
        """Central difference of the followed loss along a direction.

        The followed loss is that of `Evaluation.followed`, with the draws of a step of
        tuning. `size` is the step to each side, in units of `direction`.
        """
        inputs = self._drawn(step)
        fly = lambda free: fly_at(self._followed, free, inputs)
        slope = slope_along(fly, self._loss_of, free, direction, size)
        if self._penalty_of is None:
            return slope
        sides = [
            self.penalty({a: x + way * direction[a] for a, x in free.items()})
            for way in (size, -size)
        ]
        change = (sides[0] - sides[1]) / (2.0 * size)
        return dataclasses.replace(slope, value=slope.value + change)

    def rounding(self, free: Free, step: int, loss: float) -> float:
        """Change of the followed loss when all free numbers change by about their rounding.

        `loss` is the followed loss at the point itself, see `Evaluation.followed`.
        """
        inputs = self._drawn(step)
        changes = []
        for nudge in (_NUDGE, -_NUDGE):
            nudged = {a: x + nudge * jnp.ones_like(x) for a, x in free.items()}
            moved = batch_loss(self._followed, self._loss_of, nudged, inputs)[0]
            changes.append(abs(moved + self.penalty(nudged) - loss))
        return max((change for change in changes if np.isfinite(change)), default=0.0)

    def _drawn(self, step: int) -> Inputs:
        """The draws of the gradient in a step."""
        return self._draw(step + 1) if self._draws.fresh else self._inputs

    def _draw(self, step: int) -> Inputs:
        return self._draws.inputs(self._nominal, step)
