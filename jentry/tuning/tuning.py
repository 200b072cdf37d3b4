"""Tune any numbers of a scenario by gradient through its Monte Carlo."""

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
from ..flight.scenario import Scenario, check
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
    """What tuning has found, and how it does on draws that it has not seen."""

    scenario: Scenario
    """Of the best point of the course, with the exact law"""
    parameters: Any
    """What was given to be tuned, with the best values: the scenario itself, or what it
    is built from"""
    values: dict[str, np.ndarray]
    """Of the tuned leaves, by address"""
    moved: tuple[str, ...]
    """Addresses of the leaves of the scenario that they move: their own, or those that
    are built from them"""
    course: list[Entry]
    """Every point that was tried"""
    best: int
    """The place of the best one in the course"""
    stopped: str
    """Why"""
    judgement: Judgement
    """Against the scenario as it was given, on held-out draws; of the flights alone"""
    penalties: tuple[float, float] | None = None
    """At the start and at the best point; None without a penalty"""
    remarks: tuple[str, ...] = ()
    """What was warned of"""

    @property
    def gradient_shares(self) -> dict[str, float]:
        """Share of the flights in which the gradient feels each parameter, at the best
        point, by the law that was followed. Near zero it was tuned by few flights, and at
        zero not at all: it acts through a discrete choice, or behind a limit; for those
        of drag tracking see `smooth_switching`."""
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

        It sets every leaf of the scenario that was tuned or built, by its address and with
        its unit, to the last digit. The table `[tuned]`, which commands pass over, has
        what was tuned, from where, and the judgement.

        **Arguments:**

        - `law`, `case`, `world`: of the mission, as `Mission.scenario` takes them.
        - `dispersions`: a reading of the mission, or the `[dispersions]` table of another
          configuration file.
        - `values`: further numbers to set, by address, in SI.
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
    """Make a loss of many dispersed flights small, by its gradient.

    The loss sees the outputs of all runs at once; flights that are not finite are left
    out of it and of its gradient, and a point with more of them is never the best. What
    is found is flown again by the exact law on other draws, `Tuned.judgement`.

    The gradient is the mean of the exact derivatives of the flights. A flight may also
    jump: a law that decides in cycles reverses its bank one cycle later, or takes one
    cycle more to the end. The derivative of a flight is that between its jumps, so that
    with jumps the mean of the derivatives is not the derivative of the mean. Before the
    first step the gradient is compared with a central difference of the loss along it, of
    2 % of the numbers; where they contradict each other, `tune` warns. Then follow a
    surrogate without the jumps, such as `smooth_reversals` of the bank, or take
    `CentralDifferences`, which see whatever happens within their step.

    **Arguments:**

    - `start`: the scenario where tuning starts; or, with `build`, any pytree of numbers.
    - `where`: lens to the leaves of it to tune, of any shape:
      `lambda s: s.guidance.gains`. None for all.
    - `loss`: a number of the outputs of the runs, each of shape (runs, ...); see
      `tuning.losses`.
    - `optimizer`: a minimiser of optimistix, such as `LBFGS(rtol=1e-6, atol=1e-6)`, the
      best choice for few parameters; or an optimizer of optax, for many parameters or
      fresh draws. A learning rate of 0.1 moves a positive number by about a tenth.
    - `draws`: what is dispersed, the key, and how many draws are tuned on and judged by.
    - `build`: takes the start, with the values of a point, to the scenario that is flown:
      a planner, of which the reference that is planned has the parameters' derivative.
      It is computed by JAX, once for each point. Define it once: another one is compiled
      anew. The addresses of `ranges` and of the results are those in the start.
    - `ranges`: by address `Bounds(lower, upper)`, or the `Scale(size)` of a number that
      may be any, of which otherwise its own size is taken. Numbers that must be positive
      stay so. Next to a bound a number hardly moves: a start within 0.1 % of one is
      warned of.
    - `outputs`: what is looked at of a flight, a function of scenario and flight, for
      example `lambda s, f: (misses(s, f), f.peaks)`. Define it once, too.
    - `solver`, `history`: as for `fly`.
    - `gradient`: `AutomaticDifferentiation(forward, surrogate)`, or
      `CentralDifferences(step, surrogate)`. With a surrogate the gradient is that of a
      smoother scenario; the loss and the best point are those of the exact law.
    - `penalty`: a number of the nominal scenario that is added to the loss, such as
        `DampingBelow(Damping.of(scenario))`. Its derivative is taken in forward mode.
    - `budget`: of steps and time.
    - `record`: the file from which the same call resumes, and who is told of each step.

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
        f"says {entry.difference:.3g} +- {entry.difference_error:.2g}: flights jump there "
        "(a bank reversal or an end one guidance cycle later), which their derivatives do "
        "not know; take gradient=CentralDifferences(), or "
        "gradient=AutomaticDifferentiation(surrogate=...) of a smoother law, such as "
        "smooth_reversals"
    )


def _require_disjoint(
    scenario: Scenario, parameters: Parameters, dispersions: Mapping[str, Dispersion]
) -> None:
    """What a run draws is drawn about the start: it would undo what is tuned."""
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
    """What a tuning run is: two that are equal take the same steps.

    Of functions the names can be told, and of optimizers of optax nothing.
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
