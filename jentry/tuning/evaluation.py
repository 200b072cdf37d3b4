"""Points of a tuning run evaluated: which law, which draws, and what rounding does."""

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
"""Of a free number: some hundred roundings of the value that it stands for, and far
less than what a difference of the loss is to be told from"""


class Evaluator:
    """Evaluates points: loss and gradient."""

    def __init__(
        self,
        exact: Problem,
        loss: Loss,
        draws: Draws,
        gradient: GradientMethod,
        penalty: Penalty | None = None,
    ):
        """The loss is that of `exact`, and the gradient that of its surrogate.

        The penalty is added to both, and its gradient to that of the flights.
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
        """At a point, in a step that has draws of its own if they are fresh."""
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
        """Of the exact law, at a point, with the penalty."""
        flown = batch_loss(self._exact, self._loss_of, free, self._inputs)[0]
        return flown + self.penalty(free)

    def penalty(self, free: Free) -> float:
        """Of the scenario at a point; 0 without one."""
        return 0.0 if self._penalty_of is None else self._penalty_with_slopes(free)[0]

    def _penalty_with_slopes(self, free: Free) -> tuple[float, Free]:
        parameters = self._exact.parameters
        assert isinstance(parameters, Parameters) and self._penalty_of is not None
        # Once, and not on every device that the flights are spread over.
        free = {a: jnp.asarray(np.asarray(x)) for a, x in free.items()}
        value, slopes = penalty_and_slopes(self._penalty_of, parameters, free)
        if not all_finite((value, slopes)):
            # As of flights that are not finite: never the best point.
            return np.inf, {a: jnp.zeros_like(x) for a, x in free.items()}
        return float(value), slopes

    def slope_along(self, free: Free, direction: Free, step: int, size: float) -> Slope:
        """Central difference of the loss that is followed, of a step of this size to both
        sides, with the draws of the gradient of a step of tuning."""
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
        """Of the loss that is followed: how much it changes by itself when all free
        numbers change by their rounding."""
        inputs = self._drawn(step)
        changes = []
        for nudge in (_NUDGE, -_NUDGE):
            nudged = {a: x + nudge * jnp.ones_like(x) for a, x in free.items()}
            moved = batch_loss(self._followed, self._loss_of, nudged, inputs)[0]
            changes.append(abs(moved + self.penalty(nudged) - loss))
        return max((change for change in changes if np.isfinite(change)), default=0.0)

    def _drawn(self, step: int) -> Inputs:
        """The draws of a gradient."""
        return self._draw(step + 1) if self._draws.fresh else self._inputs

    def _draw(self, step: int) -> Inputs:
        return self._draws.inputs(self._nominal, step)
