"""The course of a tuning run: its points so far, its best point, and when it ends."""

import dataclasses
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..parameters.parameters import Free, Parameters
from .evaluation import Evaluator
from .gradients import Evaluation
from .record import CourseFile, Entry, restored
from .steppers import AbstractStepper


COARSE_STEP = 0.02
"""Step of a central difference, in free numbers: 2 % of a positive number. Steps of tuning
are usually longer"""

_MEASURED_AGAIN = 1e-3
"""Share of the loss at which rounding was last measured. Once the loss is smaller than
this, rounding is measured again"""


@dataclasses.dataclass(frozen=True)
class Budget:
    """Limits at which a tuning run ends."""

    steps: int = 100
    """Largest number of points that are evaluated"""
    patience: int = 20
    """Number of steps over which progress is measured, see `tolerance`"""
    tolerance: float = 1e-4
    """Share of the best loss. Tuning ends if the best loss falls by less than this in
    `patience` steps"""
    seconds: float | None = None
    """Limit of wall-clock time, s; None for no limit"""

    def __post_init__(self):
        for name in ("steps", "patience"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name} is {value}: it must be at least 1")


class Course:
    """The evaluated points so far, and the next point to evaluate."""

    def __init__(self, start: Free):
        self.entries: list[Entry] = []
        self.best = 0
        self._following = start
        self._state: Any = None
        self._stored_state: list[np.ndarray] | None = None
        self._converged = False
        self._begin, self._before = time.perf_counter(), 0.0

    def resume(self, file: CourseFile, evaluate: Evaluator) -> None:
        """Continue from a file if the first loss in the file equals the present loss.

        **Raises:** `ValueError` if the two losses differ.
        """
        self.entries, self._following, self._stored_state, done = file.read()
        self._converged = done
        self._before = self.entries[-1].seconds
        for place in range(len(self.entries)):
            self._compare(place)
        known, now = self.entries[0].loss, evaluate.loss(self.entries[0].free)
        if not np.isclose(known, now, rtol=1e-9, atol=0.0):
            raise ValueError(
                f"{file.path} holds another tuning run: its loss at the start is "
                f"{known:g}, and here it is {now:g}; choose another place, or remove it"
            )

    def advance(
        self, evaluate: Evaluator, stepper: AbstractStepper, parameters: Parameters
    ) -> None:
        """Evaluate the next point, then let the stepper choose the one after it."""
        here = self._following
        evaluation = evaluate(here, len(self.entries))
        if not self.entries:
            _require_start(evaluation)
        entry = self._entry(here, evaluation, evaluate, parameters)
        if entry.is_rounding:
            nothing = jax.tree.map(jnp.zeros_like, evaluation.gradient)
            evaluation = eqx.tree_at(lambda e: e.gradient, evaluation, nothing)
        self.entries.append(entry)
        self._compare(len(self.entries) - 1)
        if self._state is None:
            self._state = stepper.init(here, evaluation)
            if self._stored_state is not None:
                self._state = restored(self._state, self._stored_state)
        best = self.entries[self.best].free
        following, self._state, self._converged = stepper.step(
            here, self._state, evaluation, best
        )
        # As host arrays: a program is compiled again for each placement of its arguments.
        self._following = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)), following)

    def _entry(
        self,
        here: Free,
        evaluation: Evaluation,
        evaluate: Evaluator,
        parameters: Parameters,
    ) -> Entry:
        step = len(self.entries)
        norm = _norm(evaluation.gradient)
        slope = None
        by_differences = np.isfinite(evaluation.gradient_error)
        if step == 0 and np.isfinite(norm) and norm > 0.0 and not by_differences:
            along = {a: g / norm for a, g in evaluation.gradient.items()}
            slope = evaluate.slope_along(here, along, step, COARSE_STEP)
            slope = slope if slope.flights else None
        return Entry(
            loss=evaluation.loss,
            gradient_norm=norm,
            failed=evaluation.failed,
            gradients_failed=evaluation.gradients_failed,
            flights=evaluate.flights_per_step * (step + 1),
            seconds=self._before + time.perf_counter() - self._begin,
            values=jax.tree.map(np.asarray, parameters.values(here)),
            free=here,
            gradient_shares=evaluation.gradient_shares,
            rounding=self._rounding(here, evaluation, evaluate),
            difference=np.nan if slope is None else slope.value,
            difference_error=np.nan if slope is None else slope.error,
            gradient_error=evaluation.gradient_error,
        )

    def _rounding(
        self, here: Free, evaluation: Evaluation, evaluate: Evaluator
    ) -> float:
        """Rounding of the followed loss; see `Evaluation.followed`.

        It is measured at the start, and again where the loss has become much smaller.
        """
        if self.entries:
            last = self.entries[-1].rounding
            since = next(entry for entry in self.entries if entry.rounding == last)
            if abs(evaluation.loss) > _MEASURED_AGAIN * abs(since.loss):
                return last
        return evaluate.rounding(here, len(self.entries), evaluation.followed)

    def store(self, file: CourseFile) -> None:
        file.write(self.entries, self._following, self._state, self._converged)

    def _compare(self, place: int) -> None:
        if self.entries[place].better_than(self.entries[self.best]):
            self.best = place

    def why_stop(self, budget: Budget) -> str:
        """The reason to stop; empty if there is none."""
        if not self.entries:
            return ""
        last, best = self.entries[-1], self.entries[self.best]
        if last is best and last.gradient_norm == 0.0:
            if last.gradients_failed:
                return "no flight has a gradient that is finite"
            return "the gradient is zero"
        if last is best and last.is_rounding:
            return (
                f"the gradient {last.gradient_norm:.3g} is below the rounding of the "
                f"loss, {last.rounding:.3g}: nothing is left to tune"
            )
        if self._converged:
            return "converged"
        if len(self.entries) >= budget.steps:
            return f"{budget.steps} steps"
        if budget.seconds is not None and last.seconds >= budget.seconds:
            return f"{budget.seconds:g} s"
        if len(self.entries) <= budget.patience:
            return ""
        before = self.entries[0]
        for entry in self.entries[: len(self.entries) - budget.patience]:
            before = entry if entry.better_than(before) else before
        enough = best.failed < before.failed
        enough |= best.loss < before.loss - budget.tolerance * abs(before.loss)
        return "" if enough else f"no progress in {budget.patience} steps"


def _require_start(evaluation: Evaluation) -> None:
    if not np.isfinite(evaluation.loss):
        raise ValueError(
            f"the loss is {evaluation.loss:g} at the start, with {evaluation.failed} "
            "flights of which an output is not finite: look at one of them, "
            "jentry.monte_carlo(scenario, dispersions, key, runs=1); a history is NaN "
            "after the end of its flight, so take one number of it in the outputs"
        )


def _norm(gradient: Free) -> float:
    """Euclidean norm, computed with scaling so that large numbers do not overflow."""
    numbers = np.concatenate([np.ravel(g) for g in gradient.values()])
    largest = np.max(np.abs(numbers))
    if largest == 0.0:
        return 0.0
    return float(largest * np.linalg.norm(numbers / largest))
