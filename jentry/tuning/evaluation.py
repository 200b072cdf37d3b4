"""Points of a tuning run evaluated: which law, which draws, and what rounding does."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .batch_gradients import Loss, Problem
from .differences import Slope, slope_along
from .draws import Draws
from .gradients import Evaluation, GradientMethod, Inputs, batch_loss, fly_at
from .parameters import Free, Parameters, scenario_at


_NUDGE = 1e-13
"""Of a free number: some hundred roundings of the value that it stands for, and far
less than what a difference of the loss is to be told from"""


class Evaluator:
    """Evaluates points: loss and gradient."""

    def __init__(
        self, exact: Problem, loss: Loss, draws: Draws, gradient: GradientMethod
    ):
        """The loss is that of `exact`, and the gradient that of its surrogate."""
        assert isinstance(exact.parameters, Parameters)
        self._exact = self._followed = exact
        if gradient.surrogate is not None:
            smooth = exact.parameters.followed_by(gradient.surrogate)
            self._followed = Problem(smooth, exact.simulation)
        self._loss_of, self._draws, self._gradient = loss, draws, gradient
        self._nominal = scenario_at(exact.parameters, exact.parameters.at_start)
        self._inputs = self._draw(0)
        self._apart = self._followed is not exact or draws.fresh
        batches = gradient.batches(exact.parameters.count)
        self.flights_per_step = (batches + self._apart) * draws.runs

    def __call__(self, free: Free, step: int) -> Evaluation:
        """At a point, in a step that has draws of its own if they are fresh."""
        inputs = self._drawn(step)
        evaluation = self._gradient(self._followed, self._loss_of, free, inputs)
        if not self._apart:
            return evaluation
        loss, _, failed = batch_loss(self._exact, self._loss_of, free, self._inputs)
        return eqx.tree_at(lambda e: (e.loss, e.failed), evaluation, (loss, failed))

    def loss(self, free: Free) -> float:
        """Of the exact law, at a point."""
        return batch_loss(self._exact, self._loss_of, free, self._inputs)[0]

    def slope_along(self, free: Free, direction: Free, step: int, size: float) -> Slope:
        """Central difference of the loss that is followed, of a step of this size to both
        sides, with the draws of the gradient of a step of tuning."""
        inputs = self._drawn(step)
        fly = lambda free: fly_at(self._followed, free, inputs)
        return slope_along(fly, self._loss_of, free, direction, size)

    def rounding(self, free: Free, step: int, loss: float) -> float:
        """Of the loss that is followed: how much it changes by itself when all free
        numbers change by their rounding."""
        inputs = self._drawn(step)
        changes = []
        for nudge in (_NUDGE, -_NUDGE):
            nudged = {a: x + nudge * jnp.ones_like(x) for a, x in free.items()}
            moved = batch_loss(self._followed, self._loss_of, nudged, inputs)[0]
            changes.append(abs(moved - loss))
        return max((change for change in changes if np.isfinite(change)), default=0.0)

    def _drawn(self, step: int) -> Inputs:
        """The draws of a gradient."""
        return self._draw(step + 1) if self._draws.fresh else self._inputs

    def _draw(self, step: int) -> Inputs:
        return self._draws.inputs(self._nominal, step)
