"""Tunes numbers of a scenario with the gradient of a loss of its Monte Carlo flights."""

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import optax
import optimistix

from .._setup import needs_float64
from .._warnings import ResultWarning
from ..addresses import addresses_of, replace_leaves
from ..campaign.description import describe
from ..campaign.dispersions import Dispersion
from ..flight.miss import misses
from ..flight.scenario import Scenario
from ..flight.scenario_checks import check
from ..flight.solver import AbstractSolver, FixedStep
from ..parameters.maps import Ranges
from ..parameters.parameters import Build, Parameters, itself, scenario_at
from .batch_gradients import Loss, Outputs, Problem, Simulation
from .course import COARSE_STEP, Budget, Course
from .draws import Draws, held_out
from .evaluation import Evaluator
from .gradients import AutomaticDifferentiation, GradientMethod
from .judgement import Judgement, judge
from .penalties import Penalty
from .record import CourseFile, Entry, Record, told
from .saving import write_tuned
from .steppers import AbstractStepper, Descent, Solver


Optimizer = optax.GradientTransformation | optimistix.AbstractMinimiser


@dataclasses.dataclass(frozen=True)
class Tuned:
    """The tuned scenario, the course of the tuning, and an evaluation on held-out draws."""

    scenario: Scenario
    """Scenario of the best point of the course, with the exact law"""
    parameters: Any
    """The `start` of `tune` with the best values: the scenario itself, or the pytree from
    which it is built"""
    values: dict[str, np.ndarray]
    """Values of the tuned leaves, by address"""
    moved: tuple[str, ...]
    """Addresses of the leaves of the scenario that depend on the tuned leaves: these leaves
    themselves, or those that are built from them"""
    course: list[Entry]
    """All points that were evaluated"""
    best: int
    """Place of the best point in the course"""
    stopped: str
    """Reason for which tuning stopped"""
    judgement: Judgement
    """Comparison with the scenario at the start, on held-out draws, without the penalty"""
    penalties: tuple[float, float] | None = None
    """Penalties at the start and at the best point; None without a penalty"""
    remarks: tuple[str, ...] = ()
    """Texts of the warnings"""

    @property
    def gradient_shares(self) -> dict[str, float]:
        """Share of the flights in which each parameter has an effect on the gradient.

        It is computed at the best point, with the surrogate law if there is one. A
        parameter with a share near zero was tuned on few flights. A parameter with a share
        of zero was not tuned: it acts through a discrete choice, or beyond a limit. For
        such parameters of drag tracking see `smooth_switching`.
        """
        return self.course[self.best].gradient_shares

    def save(
        self,
        path: Path | str,
        *,
        law: str | None = None,
        case: str | None = None,
        world: Sequence[str] | None = None,
        dispersions: str | Mapping[str, Any] | None = None,
        values: Mapping[str, Any] | None = None,
        comment: str = "",
    ) -> None:
        """Write a configuration file that `jentry COMMAND MISSION --config FILE` reads.

        The file sets every leaf of the scenario that was tuned or built, by address, with
        its unit and all digits. The table `[tuned]`, which commands ignore, contains the
        tuned parameters, their values at the start, and the judgement.

        **Arguments:**

        - `law`, `case`, `world`: names of the mission, as for `Mission.scenario`.
        - `dispersions`: name of a set of dispersions of the mission, or the
          `[dispersions]` table of another configuration file.
        - `values`: further numbers to set, by address, in SI units.
        - `comment`: lines at the top of the file.

            tuned.save("tuned.toml")
        """
        head = {"law": law, "case": case, "world": world, "dispersions": dispersions}
        write_tuned(path, self, head, values or {}, comment)


@needs_float64
def tune(
    start: Any,
    where: Callable[[Any], Any] | None,
    loss: Loss,
    optimizer: Optimizer,
    draws: Draws,
    *,
    build: Build = itself,
    ranges: Ranges | None = None,
    outputs: Outputs = misses,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    gradient: GradientMethod = AutomaticDifferentiation(),
    penalty: Penalty | None = None,
    budget: Budget = Budget(),
    record: Record = Record(),
) -> Tuned:
    """Minimise a loss of many dispersed flights with its gradient.

    The loss is a function of the outputs of all runs. Flights that are not finite are left
    out of the loss and of its gradient, and a point with more of them is never the best. At
    the end the exact law flies the best point with held-out draws, see `Tuned.judgement`.

    The gradient is the mean of the exact derivatives of the flights. The outputs of a
    flight may also jump: a law with a guidance cycle reverses the bank one cycle later, or
    needs one more cycle to the end. The derivative of a flight does not contain its jumps,
    so that with jumps the mean of the derivatives is not the derivative of the mean. Before
    the first step the gradient is compared with a central difference of the loss along it,
    with a step of 2 % of the numbers. If they contradict each other, `tune` warns. Then use
    a surrogate without the jumps, such as `smooth_reversals` for the bank, or
    `CentralDifferences`, which include all jumps within their step.

    **Arguments:**

    - `start`: the scenario at which tuning starts; or, with `build`, any pytree of numbers.
    - `where`: lens to the leaves of `start` to tune, of any shape:
      `lambda s: s.guidance.gains`. None for all leaves.
    - `loss`: function of the outputs of the runs, each of shape (runs, ...), that returns
      one number; see `tuning.losses`.
    - `optimizer`: a minimiser of optimistix, such as `LBFGS(rtol=1e-6, atol=1e-6)`, which
      is the best choice for few parameters; or an optimizer of optax, for many parameters
      or fresh draws. A learning rate of 0.1 changes a positive number by about a tenth.
    - `draws`: dispersions, random key, and the numbers of tuning draws and held-out draws.
    - `build`: function from `start`, with the values of a point, to the scenario. It may
      plan a reference, and the gradient includes the dependence of the reference on the
      parameters. JAX evaluates it once for each point. Define it once: another function is
      compiled again. The addresses of `ranges` and of the results are those in `start`.
    - `ranges`: by address `Bounds(lower, upper)`, or `Scale(size)` for an unbounded number.
      The default scale is the size of the number itself. Numbers that must be positive stay
      positive. Close to a bound a number hardly changes: `tune` warns of a start within
      0.1 % of a bound.
    - `outputs`: function of scenario and flight that returns the numbers for the loss, such
      as `lambda s, f: (misses(s, f), f.peaks)`. Define it once, too.
    - `solver`, `history`: as for `fly`.
    - `gradient`: `AutomaticDifferentiation(forward, surrogate)`, or
      `CentralDifferences(step, surrogate)`. With a surrogate the gradient is that of a
      smoother scenario; the loss and the best point are those of the exact law.
    - `penalty`: a number of the nominal scenario that is added to the loss, such as
        `DampingBelow(Damping.of(scenario))`. Its derivative is taken in forward mode.
    - `budget`: limits of steps and time.
    - `record`: the file from which the same call resumes, and a function that reports each
      step.

    Tuning stops where the gradient is below the rounding of the loss, since the result of
    every further step would be random.

    **Raises:** `ValueError` for leaves that cannot be tuned, a tuned leaf that is also
    dispersed, a loss that is not one number, and if no flight is finite at the start.
    **Warns** of a gradient that a difference contradicts, and of a start close to a bound.

        tuned = tune(
            scenario,
            lambda s: s.guidance.gains,
            MeanSquare(lambda misses: misses.downrange / km),
            optimistix.LBFGS(rtol=1e-6, atol=1e-6),
            Draws(dispersions, jax.random.key(0)),
        )
        tuned.scenario, tuned.judgement["downrange", "std"]
    """
    parameters = Parameters.of(start, where, ranges, build)
    scenario = scenario_at(parameters, parameters.at_start)
    check(scenario)
    stepper = _stepper(optimizer, draws.fresh)
    draws.check(scenario, budget.steps)
    _require_disjoint(scenario, parameters, draws.dispersions)
    simulation = Simulation(outputs, solver, history)
    exact = Problem(parameters, simulation)
    evaluate = Evaluator(exact, loss, draws, gradient, penalty)
    file = None
    if record.path is not None:
        asked = loss, penalty, optimizer, gradient, record.labels
        described = _description(exact, scenario, draws, asked)
        file = CourseFile(Path(record.path), described)
    remarks = parameters.near_bounds()
    for remark in remarks:
        warnings.warn(remark, ResultWarning, stacklevel=3)
    course = Course(parameters.zeros())
    if file is not None and file.path.exists():
        course.resume(file, evaluate)
    if not np.isfinite(evaluate.penalty(parameters.zeros())):
        raise ValueError(
            "the penalty or its derivative is not finite at the start: try it alone, "
            "penalty(scenario)"
        )
    while not (stopped := course.why_stop(budget)):
        course.advance(evaluate, stepper, parameters)
        if len(course.entries) == 1 and course.entries[0].contradicted:
            said = _contradiction(course.entries[0])
            warnings.warn(said, ResultWarning, stacklevel=3)
        if file is not None:
            course.store(file)
        if record.report is not None:
            record.report(course.entries, course.best)

    values, best_free = (
        course.entries[course.best].values,
        course.entries[course.best].free,
    )
    tuned = scenario_at(parameters, values)
    unseen = draws.dispersions, held_out(draws.key), draws.held_out
    judgement = judge(scenario, tuned, *unseen, loss, simulation)
    first = course.entries[0]
    remarks += [_contradiction(first)] if first.contradicted else []
    return Tuned(
        scenario=tuned,
        parameters=replace_leaves(parameters.start, values),
        values=values,
        moved=parameters.moved,
        course=course.entries,
        best=course.best,
        stopped=stopped,
        judgement=judgement,
        penalties=None
        if penalty is None
        else (evaluate.penalty(first.free), evaluate.penalty(best_free)),
        remarks=tuple(remarks),
    )


def _contradiction(entry: Entry) -> str:
    return (
        f"the gradient of the loss at the start is {entry.gradient_norm:.3g}, and a "
        f"difference of the loss along it, of {100.0 * COARSE_STEP:g} % to both sides, "
        f"is {entry.difference:.3g} +- {entry.difference_error:.2g}: flights jump there "
        "(a bank reversal or an end one guidance cycle later), which their derivatives do "
        "not contain; use gradient=CentralDifferences() (`jentry tune --differences`), or "
        "gradient=AutomaticDifferentiation(surrogate=...) of a smoother law, such as "
        "smooth_reversals"
    )


def _require_disjoint(
    scenario: Scenario, parameters: Parameters, dispersions: Mapping[str, Dispersion]
) -> None:
    """Refuse tuned leaves that are dispersed.

    A run draws such a leaf about its value at the start, which would undo the tuning.
    """
    for name, dispersion in dispersions.items():
        for address in addresses_of(scenario, dispersion.where):
            if address in parameters.moved:
                raise ValueError(
                    f"{address} is tuned, and the dispersion {name!r} moves it: tune "
                    "something else, or leave the dispersion out"
                )


def _stepper(optimizer: Optimizer, fresh_draws: bool) -> AbstractStepper:
    if isinstance(optimizer, optax.GradientTransformation):
        return Descent(optimizer, fresh_draws)
    if not isinstance(optimizer, optimistix.AbstractMinimiser):
        raise ValueError(
            f"the optimizer is a {type(optimizer).__name__}: give one of optax, or a "
            "minimiser of optimistix, such as LBFGS"
        )
    if fresh_draws:
        raise ValueError(
            "a minimiser of optimistix compares points on the same draws: leave "
            "fresh=True out, or take an optimizer of optax"
        )
    return Solver(optimizer)


def _description(
    exact: Problem,
    scenario: Scenario,
    draws: Draws,
    asked: tuple[Loss, Penalty | None, Optimizer, GradientMethod, Mapping[str, Any]],
) -> dict[str, Any]:
    """Description of a tuning run. Runs with equal descriptions take the same steps.

    It contains only the names of functions, and nothing about optimizers of optax.
    """
    loss, penalty, optimizer, gradient, labels = asked
    simulation, parameters = exact.simulation, exact.parameters
    assert isinstance(parameters, Parameters)
    solver, history = simulation.solver, simulation.history
    smooth = gradient.surrogate
    return {
        **describe(scenario, draws.dispersions, 0, solver, history),
        "seed": jax.random.key_data(draws.key).tolist(),
        "runs": draws.runs,
        "fresh_draws": draws.fresh,
        "build": told(parameters.build),
        "parameters": {a: told(m) for a, m in parameters.maps.items()},
        "loss": told(loss),
        "penalty": told(penalty),
        "outputs": told(simulation.outputs),
        "optimizer": told(optimizer),
        "gradient": told(gradient),
        "followed": None if smooth is None else str(smooth(scenario)),
        "labels": {name: str(value) for name, value in labels.items()},
    }
