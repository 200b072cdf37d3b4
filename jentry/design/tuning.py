"""Tune any numbers of a scenario by gradient through its Monte Carlo."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
from jaxtyping import Array, Key

from .._addresses import addresses_of, replace_leaves
from ..campaign.description import describe
from ..campaign.dispersions import Dispersion, check_dispersions
from ..flight.misses import misses
from ..flight.scenario import Scenario, check
from ..flight.solver import AbstractSolver, FixedStep
from .batch_gradient import FORWARD_UP_TO, Loss, Outputs, Problem
from .evaluation import Evaluator
from .judgement import Judgement, held_out as held_out_key, judge
from .losses import MeanSquare
from .parameters import Bounds, Free, Parameters
from .steppers import AbstractStepper, Descent, LeastSquares, Minimisation
from .tuning_record import Entry, read_record, restored, write_record


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

    @property
    def reached(self) -> dict[str, float]:
        """Share of the flights that each parameter reaches with a gradient, at the best
        point. Near zero it was tuned by few flights, and at zero not at all: it acts
        through a discrete choice, or behind a limit; see `smooth_switching`."""
        return self.history[self.best].reached


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
    outputs: Outputs = misses,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    fresh_draws: bool = False,
    mode: str | None = None,
    surrogate: Callable[[Scenario], Scenario] | None = None,
    patience: int = 20,
    tolerance: float = 1e-4,
    seconds: float | None = None,
    held_out: int = 5000,
    record: Path | str | None = None,
    report: Callable[[list[Entry], int], None] | None = None,
) -> Tuned:
    """Make a loss of many dispersed flights small, by their exact gradient.

    The loss sees the outputs of all runs at once; flights that are not finite are left
    out of it and of its gradient, and a point with more of them is never the best. What
    is found is flown again by the exact law on other draws, `Tuned.judgement`.

    **Arguments:**

    - `scenario`: where tuning starts.
    - `where`: lens to the leaves to tune, of any shape: `lambda s: s.guidance.gains`.
    - `loss`: a number of the outputs of the runs, each of shape (runs, ...); see
      `design.losses`.
    - `optimizer`: of optax, for any loss; or a least-squares solver of optimistix, such as
      `LevenbergMarquardt(rtol=1e-6, atol=1e-6)`, for a loss that is a `MeanSquare`. With
      few parameters the latter needs far fewer steps. Steps are relative: a learning
      rate of 0.1 moves a positive number by about a tenth.
    - `dispersions`, `key`, `runs`: the draws. They are the same in each step, unless
      `fresh_draws`: then each gradient has new ones, while the best point is still
      judged by the same.
    - `steps`: at most; `seconds` (wall clock) likewise. It ends before when the best
      loss has not fallen by a share of `tolerance` in `patience` steps.
    - `bounds`: lower and upper by address. Numbers that must be positive stay so anyway.
    - `outputs`: what is looked at of a flight, a function of scenario and flight, for
      example `lambda s, f: (misses(s, f), f.peaks)`. `history` (s) gives the flights
      one, see `fly`; define the function once, since another one is compiled anew.
    - `mode`: "forward" or "reverse"; by the number of parameters if not given.
    - `surrogate`: takes the scenario to a smoother one whose gradient is followed, such
      as `smooth_switching`. The loss and the best point are those of the exact law.
    - `held_out`: runs to judge by.
    - `record`: a file that is kept up to date, and from which the same call resumes.
    - `report`: is called after each step with the history and the place of the best.

    **Raises:** `ValueError` for leaves that cannot be tuned, a leaf that is dispersed as
    well, a loss that is no number, and if no flight is finite at the start.

        tuned = tune(
            scenario,
            lambda s: s.guidance.gains,
            MeanSquare(lambda misses: misses.downrange / km),
            optimistix.LevenbergMarquardt(rtol=1e-6, atol=1e-6),
            dispersions,
            jax.random.key(0),
        )
        tuned.scenario, tuned.judgement["downrange", "std"]
    """
    check(scenario)
    check_dispersions(scenario, dispersions)
    parameters = Parameters.of(scenario, where, bounds)
    _require_disjoint(scenario, parameters, dispersions)
    for name, value, least in (
        ("runs", runs, 2),
        ("steps", steps, 1),
        ("held_out", held_out, 2),
        ("patience", patience, 1),
    ):
        if value < least:
            raise ValueError(f"{name} is {value}: it must be at least {least}")
    if mode not in (None, "forward", "reverse"):
        raise ValueError(f'mode is {mode!r}: it must be "forward" or "reverse"')
    forward = parameters.count <= FORWARD_UP_TO if mode is None else mode == "forward"

    exact = Problem(scenario, parameters, outputs, solver, history)
    followed = exact
    if surrogate is not None:
        followed = dataclasses.replace(exact, scenario=surrogate(scenario))
    stepper = _stepper(optimizer, loss, fresh_draws)
    evaluate = Evaluator(
        exact,
        followed,
        loss,
        dispersions,
        key,
        runs,
        fresh_draws=fresh_draws,
        forward=forward,
        least_squares=isinstance(stepper, LeastSquares),
    )
    description = _description(exact, followed, loss, dispersions, key, runs, stepper)
    place = None if record is None else Path(record)

    entries: list[Entry] = []
    begin, already = time.perf_counter(), 0.0
    following, state, best = parameters.start(), None, 0
    stored: list[np.ndarray] | None = None
    if place is not None and place.exists():
        entries, following, stored = read_record(place, description)
        best, already = _best(entries), entries[-1].seconds
    stopped = _why_stop(entries, best, patience, tolerance, steps, seconds)
    while not stopped:
        evaluation = evaluate(following, len(entries))
        if not entries and not np.isfinite(evaluation.loss):
            raise ValueError(
                f"none of the {runs} flights is finite at the start: fly one of them and "
                "see why, jentry.monte_carlo(scenario, dispersions, key, runs=1)"
            )
        entries.append(
            Entry(
                loss=evaluation.loss,
                gradient_norm=_norm(evaluation.gradient),
                not_finite=evaluation.not_finite,
                flights=evaluate.flights_per_step * (len(entries) + 1),
                seconds=already + time.perf_counter() - begin,
                values=jax.tree.map(np.asarray, parameters.values(following)),
                free=following,
                reached=evaluation.reached,
            )
        )
        if len(entries) == 1 or entries[-1].better_than(entries[best]):
            best = len(entries) - 1
        if state is None:
            state = stepper.init(following, evaluation)
            if stored is not None and place is not None:
                state = restored(state, stored, place)
        if np.isfinite(evaluation.loss) or isinstance(stepper, Minimisation):
            following, state, converged = stepper.step(following, state, evaluation)
        else:
            # Every flight failed: go back halfway to the best point.
            converged = False
            following = jax.tree.map(
                lambda a, b: 0.5 * (a + b), following, entries[best].free
            )
        # As host arrays: a program is compiled anew for each placement of its arguments.
        following = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)), following)
        if place is not None:
            write_record(place, description, entries, following, state)
        if report is not None:
            report(entries, best)
        stopped = _why_stop(entries, best, patience, tolerance, steps, seconds)
        if converged and not stopped:
            stopped = "converged"

    values = entries[best].values
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
    return Tuned(tuned, values, entries, best, stopped, judgement)


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
        return Descent(optimizer)
    if isinstance(optimizer, optimistix.AbstractMinimiser):
        if fresh_draws:
            raise ValueError(_SAME_DRAWS)
        return Minimisation(optimizer)
    if not isinstance(optimizer, optimistix.AbstractLeastSquaresSolver):
        raise ValueError(
            f"the optimizer is a {type(optimizer).__name__}: give one of optax, or a "
            "least-squares solver of optimistix"
        )
    if not isinstance(loss, MeanSquare):
        raise ValueError(
            "a least-squares solver needs residuals: give the loss as "
            "MeanSquare(lambda outputs: ...), or take an optimizer of optax"
        )
    if fresh_draws:
        raise ValueError(_SAME_DRAWS)
    return LeastSquares(optimizer)


_SAME_DRAWS = (
    "a solver of optimistix compares steps on the same draws: leave fresh_draws out, or "
    "take an optimizer of optax"
)


def _description(
    exact: Problem,
    followed: Problem,
    loss: Loss,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    runs: int,
    stepper: AbstractStepper,
) -> dict[str, Any]:
    """What a tuning run is: two that are equal take the same steps.

    Of functions and optimizers only the names can be told.
    """
    seed = jax.random.key_data(key).tolist()
    return {
        **describe(exact.scenario, dispersions, 0, exact.solver, exact.history),
        "seed": seed,
        "runs": runs,
        "followed": str(followed.scenario),
        "parameters": {a: type(m).__name__ for a, m in exact.parameters.maps.items()},
        "loss": type(loss).__name__,
        "stepper": type(stepper).__name__,
    }


def _best(entries: list[Entry]) -> int:
    best = 0
    for place, entry in enumerate(entries):
        if entry.better_than(entries[best]):
            best = place
    return best


def _norm(gradient: Free) -> float:
    return float(np.sqrt(sum(np.sum(np.square(g)) for g in gradient.values())))


def _why_stop(
    entries: list[Entry],
    best: int,
    patience: int,
    tolerance: float,
    steps: int,
    seconds: float | None,
) -> str:
    """Empty if there is no reason to."""
    if not entries:
        return ""
    if entries[-1].gradient_norm == 0.0 and np.isfinite(entries[-1].loss):
        return "no gradient reaches the parameters"
    if len(entries) >= steps:
        return f"{steps} steps"
    if seconds is not None and entries[-1].seconds >= seconds:
        return f"{seconds:g} s"
    if len(entries) > patience:
        earlier = entries[: len(entries) - patience]
        before = earlier[_best(earlier)]
        now = entries[best]
        fewer = now.not_finite < before.not_finite
        if not fewer and now.loss > before.loss - tolerance * abs(before.loss):
            return f"no progress in {patience} steps"
    return ""
