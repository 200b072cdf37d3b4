"""Tune any numbers of a scenario by gradient through its Monte Carlo."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import optax
import optimistix
from jaxtyping import Array, Key

from .._setup import needs_float64
from .._warnings import ResultWarning
from ..addresses import addresses_of, replace_leaves
from ..campaign.batch import filled_up
from ..campaign.campaign import check_draws, drawn_inputs
from ..campaign.description import describe
from ..campaign.dispersions import Dispersion, check_dispersions
from ..flight.miss import misses
from ..flight.scenario import Scenario, checked
from ..flight.solver import AbstractSolver, FixedStep
from .batch_gradients import FORWARD_UP_TO, Loss, Outputs, Problem
from .course import COARSE_STEP, Course
from .evaluation import Evaluator
from .judgement import Judgement, held_out as held_out_key, judge
from .losses import MeanSquare
from .parameters import Bounds, Parameters, Scales
from .record import Entry, Record, told
from .steppers import AbstractStepper, Descent, Solver


Optimizer = (
    optax.GradientTransformation
    | optimistix.AbstractLeastSquaresSolver
    | optimistix.AbstractMinimiser
)


@dataclasses.dataclass(frozen=True)
class Tuned:
    """What tuning has found, and how it does on draws that it has not seen."""

    scenario: Scenario
    """With the best point of the history, and the exact law"""
    values: dict[str, np.ndarray]
    """Of the tuned leaves, by address"""
    history: list[Entry]
    best: int
    """Its place in the history"""
    stopped: str
    """Why"""
    judgement: Judgement
    """Against the scenario as it was given, on held-out draws"""
    remarks: tuple[str, ...] = ()
    """What was warned of"""

    @property
    def reached(self) -> dict[str, float]:
        """Share of the flights that each parameter reaches with a gradient, at the best
        point, of the law that was followed. Near zero it was tuned by few flights, and at
        zero not at all: it acts through a discrete choice, or behind a limit; for those
        of drag tracking see `smooth_switching`."""
        return self.history[self.best].reached


@needs_float64
def tune(
    scenario: Scenario,
    where: Callable[[Any], Any],
    loss: Loss,
    optimizer: Optimizer,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    *,
    runs: int = 256,
    steps: int = 100,
    bounds: Bounds | None = None,
    scales: Scales | None = None,
    outputs: Outputs = misses,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    fresh_draws: bool = False,
    mode: str | None = None,
    difference_step: float = 0.02,
    surrogate: Callable[[Scenario], Scenario] | None = None,
    patience: int = 20,
    tolerance: float = 1e-4,
    seconds: float | None = None,
    held_out: int = 5000,
    record: Path | str | None = None,
    labels: Mapping[str, Any] | None = None,
    report: Callable[[list[Entry], int], None] | None = None,
) -> Tuned:
    """Make a loss of many dispersed flights small, by its gradient.

    The loss sees the outputs of all runs at once; flights that are not finite are left
    out of it and of its gradient, and a point with more of them is never the best. What
    is found is flown again by the exact law on other draws, `Tuned.judgement`.

    The gradient is the mean of the exact derivatives of the flights. A flight may also
    jump: a law that decides in cycles reverses its bank one cycle later, or takes one
    cycle more to the end. The derivative of a flight is that between its jumps, so that
    with jumps the mean of the derivatives is not the derivative of the mean. Before the
    first step the gradient is compared with a central difference of the loss along it, of
    2 % of the numbers; where they contradict each other, `tune` warns. Then take a
    `surrogate` without the jumps, such as `smooth_reversals` of the bank, or
    `mode="difference"`, which sees whatever happens within its step.

    **Arguments:**

    - `scenario`: where tuning starts.
    - `where`: lens to the leaves to tune, of any shape: `lambda s: s.guidance.gains`.
    - `loss`: a number of the outputs of the runs, each of shape (runs, ...); see
      `tuning.losses`.
    - `optimizer`: a minimiser of optimistix, such as `LBFGS(rtol=1e-6, atol=1e-6)`, for
      any loss, and the best choice for few parameters; a least-squares solver, such as
      `LevenbergMarquardt(rtol=1e-6, atol=1e-6)`, for a loss that is a `MeanSquare`; or an
      optimizer of optax, for many parameters or fresh draws. A learning
      rate of 0.1 moves a positive number by about a tenth.
    - `dispersions`, `key`, `runs`: the draws. They are the same in each step, unless
      `fresh_draws`: then each gradient has new ones, while the best point is still
      judged by the same.
    - `steps`: at most; `seconds` (wall clock) likewise. It ends before when the best
      loss has not fallen by a share of `tolerance` in `patience` steps.
    - `bounds`: lower and upper by address. Numbers that must be positive stay so anyway.
        Next to a bound a number hardly moves: a start within 0.1 % of one is warned of.
    - `scales`: by address, how much of a number counts as much as a factor e of a positive
        one. Its own size if not given, so that a number that is zero needs one.
    - `outputs`: what is looked at of a flight, a function of scenario and flight, for
      example `lambda s, f: (misses(s, f), f.peaks)`. `history` (s) gives the flights
      one, see `fly`; define the function once, since another one is compiled anew.
    - `mode`: "forward" or "reverse", of the exact derivatives; by the number of parameters
      if not given. Least squares goes forward. Or "difference": central differences of
      the loss with the same draws, number by number, over `difference_step` to both sides
      (in free numbers: 0.02 is 2 % of a positive number). They are exact for the loss
      averaged over that interval, jumps included, and come with a standard error,
      `Entry.gradient_error`. A step in which hardly a flight jumps tells little.
    - `surrogate`: takes the scenario to a smoother one whose gradient is followed, such
      as `smooth_switching`. The loss and the best point are those of the exact law.
    - `held_out`: runs to judge by.
    - `record`: a file that is kept up to date, and from which the same call resumes; it
      may ask for more steps. `labels` are kept in it and compared: what tells your
      losses and optimizers apart.
    - `report`: is called after each step with the history and the place of the best.

    It stops where the gradient is below the rounding of the loss: every further step
    would be taken by chance.

    **Raises:** `ValueError` for leaves that cannot be tuned, a leaf that is dispersed as
    well, a loss that is no number, and if no flight is finite at the start. **Warns**
    of a gradient that a difference contradicts, and of a start next to a bound.

        tuned = tune(
            scenario,
            lambda s: s.guidance.gains,
            MeanSquare(lambda misses: misses.downrange / km),
            optimistix.LBFGS(rtol=1e-6, atol=1e-6),
            dispersions,
            jax.random.key(0),
        )
        tuned.scenario, tuned.judgement["downrange", "std"]
    """
    scenario = checked(scenario)
    if not dispersions:
        raise ValueError("nothing is dispersed: give dispersions")
    check_dispersions(scenario, dispersions)
    parameters = Parameters.of(scenario, where, bounds, scales)
    _require_disjoint(scenario, parameters, dispersions)
    for name, value, least in (
        ("runs", runs, 2),
        ("steps", steps, 1),
        ("held_out", held_out, 2),
        ("patience", patience, 1),
    ):
        if value < least:
            raise ValueError(f"{name} is {value}: it must be at least {least}")
    if not 0.0 < difference_step < 1.0:
        raise ValueError(
            f"difference_step is {difference_step}: it must be between 0 and 1; 0.02 is 2 "
            "% of a positive number"
        )
    # All draws before the first flight, those of later steps and the held-out ones too.
    if fresh_draws:
        check_draws(scenario, dispersions, key, np.arange((steps + 1) * runs))
    unseen = filled_up(np.arange(held_out), len(jax.devices()))
    drawn_inputs(scenario, dispersions, held_out_key(key), unseen)
    stepper = _stepper(optimizer, loss, fresh_draws)
    least_squares = _is_least_squares(optimizer)
    exact = Problem(scenario, parameters, outputs, solver, history)
    followed = exact
    if surrogate is not None:
        followed = dataclasses.replace(exact, scenario=surrogate(scenario))
    evaluate = Evaluator(
        exact,
        followed,
        loss,
        dispersions,
        key,
        runs,
        fresh_draws=fresh_draws,
        forward=_is_forward(mode, parameters.count, least_squares),
        least_squares=least_squares,
        difference=difference_step if mode == "difference" else None,
    )
    stored = None
    if record is not None:
        by = difference_step if mode == "difference" else None
        asked = loss, outputs, optimizer, fresh_draws, by, labels or {}
        description = _description(exact, followed, dispersions, key, runs, asked)
        stored = Record(Path(record), description)
    remarks = parameters.near_bounds()
    for remark in remarks:
        warnings.warn(remark, ResultWarning, stacklevel=3)
    course = Course(parameters.start())
    if stored is not None and stored.path.exists():
        course.resume(stored, evaluate)
    limits = steps, seconds, patience, tolerance
    while not (stopped := course.why_stop(*limits)):
        course.advance(evaluate, stepper, parameters)
        if len(course.entries) == 1 and course.entries[0].contradicted:
            said = _contradiction(course.entries[0])
            warnings.warn(said, ResultWarning, stacklevel=3)
        if stored is not None:
            course.store(stored)
        if report is not None:
            report(course.entries, course.best)

    values = course.entries[course.best].values
    tuned = replace_leaves(scenario, values)
    judgement = judge(
        scenario,
        tuned,
        dispersions,
        held_out_key(key),
        held_out,
        loss,
        outputs,
        solver,
        history,
    )
    first = course.entries[0]
    remarks += [_contradiction(first)] if first.contradicted else []
    return Tuned(
        tuned, values, course.entries, course.best, stopped, judgement, tuple(remarks)
    )


def _contradiction(entry: Entry) -> str:
    return (
        f"the gradient of the loss at the start is {entry.gradient_norm:.3g}, and a "
        f"difference of the loss along it, of {100.0 * COARSE_STEP:g} % to both sides, "
        f"says {entry.difference:.3g} +- {entry.difference_error:.2g}: flights jump there "
        "(a bank reversal or an end one guidance cycle later), which their derivatives do "
        "not know; follow a surrogate, such as smooth_reversals, or take "
        'mode="difference"'
    )


def _is_least_squares(optimizer: Optimizer) -> bool:
    return isinstance(optimizer, optimistix.AbstractLeastSquaresSolver)


def _is_forward(mode: str | None, count: int, least_squares: bool) -> bool:
    if mode not in (None, "forward", "reverse", "difference"):
        raise ValueError(
            f'mode is {mode!r}: it must be "forward", "reverse" or "difference"'
        )
    if least_squares:
        if mode in ("reverse", "difference"):
            raise ValueError(
                "a least-squares solver goes forward: leave the mode out, or take "
                "another optimizer, such as optimistix.LBFGS"
            )
        return True
    return count <= FORWARD_UP_TO if mode is None else mode == "forward"


def _require_disjoint(
    scenario: Scenario, parameters: Parameters, dispersions: Mapping[str, Dispersion]
) -> None:
    for name, dispersion in dispersions.items():
        for address in addresses_of(scenario, dispersion.where):
            if address in parameters.maps:
                raise ValueError(
                    f"{address} is tuned, and the dispersion {name!r} moves it: tune "
                    "something else, or leave the dispersion out"
                )


def _stepper(optimizer: Optimizer, loss: Loss, fresh_draws: bool) -> AbstractStepper:
    if isinstance(optimizer, optax.GradientTransformation):
        return Descent(optimizer, fresh_draws)
    if not isinstance(
        optimizer,
        optimistix.AbstractLeastSquaresSolver | optimistix.AbstractMinimiser,
    ):
        raise ValueError(
            f"the optimizer is a {type(optimizer).__name__}: give one of optax, or a "
            "minimiser or a least-squares solver of optimistix"
        )
    if fresh_draws:
        raise ValueError(
            "a solver of optimistix compares points on the same draws: leave fresh_draws "
            "out, or take an optimizer of optax"
        )
    if _is_least_squares(optimizer) and not isinstance(loss, MeanSquare):
        raise ValueError(
            "a least-squares solver needs residuals: give the loss as "
            "MeanSquare(lambda outputs: ...), or take another optimizer"
        )
    return Solver(optimizer)


def _description(
    exact: Problem,
    followed: Problem,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: int,
    asked: tuple[Loss, Outputs, Optimizer, bool, float | None, Mapping[str, Any]],
) -> dict[str, Any]:
    """What a tuning run is: two that are equal take the same steps.

    Of functions the names can be told, and of optimizers of optax nothing.
    """
    loss, outputs, optimizer, fresh_draws, difference, labels = asked
    known = describe(exact.scenario, dispersions, 0, exact.solver, exact.history)
    return {
        **known,
        "seed": jax.random.key_data(key).tolist(),
        "runs": runs,
        "followed": str(followed.scenario),
        "parameters": {a: told(m) for a, m in exact.parameters.maps.items()},
        "loss": told(loss),
        "outputs": told(outputs),
        "optimizer": told(optimizer),
        "fresh_draws": fresh_draws,
        "difference_step": difference,
        "labels": {name: str(value) for name, value in labels.items()},
    }
