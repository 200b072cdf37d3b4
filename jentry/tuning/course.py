"""The course of a tuning run: its points so far, the best of them, and when it ends."""

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
"""In free numbers: 2 % of a positive number. Steps of tuning are rather longer"""

_MEASURED_AGAIN = 1e-3
"""Of the loss at which its rounding was measured before"""


@dataclasses.dataclass(frozen=True)
class Budget:
    """When a tuning run ends, at the latest."""

    steps: int = 100
    """Points that are tried"""
    patience: int = 20
    tolerance: float = 1e-4
    """It ends when the best loss has not fallen by this share of it in `patience` steps"""
    seconds: float | None = None
    """Of the wall clock"""

    def __post_init__(self):
        for name in ("steps", "patience"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name} is {value}: it must be at least 1")


class Course:
    """The points so far, and where tuning goes next."""

    def __init__(self, start: Free):
        self.entries: list[Entry] = []
        self.best = 0
        self._following = start
        self._state: Any = None
        self._stored_state: list[np.ndarray] | None = None
        self._converged = False
        self._begin, self._before = time.perf_counter(), 0.0

    def resume(self, file: CourseFile, evaluate: Evaluator) -> None:
        """Go on from a file, if its first loss is what the loss is now."""
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
        """Evaluate the next point and step on from it."""
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
        # As host arrays: a program is compiled anew for each placement of its arguments.
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
        """Measured at the start, and again where the loss has become much smaller."""
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
        """Empty if there is no reason to."""
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
    """Scaled, so that the square of a large one does not overflow."""
    numbers = np.concatenate([np.ravel(g) for g in gradient.values()])
    largest = np.max(np.abs(numbers))
    if largest == 0.0:
        return 0.0
    return float(largest * np.linalg.norm(numbers / largest))
