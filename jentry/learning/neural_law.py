"""Trains a neural law through the flight, on fresh dispersed flights in each step.

The training is a sequence of methods, see `weight_steps`. At intervals the weights are
judged on flights that no step uses. The result has the best ones.
"""

import dataclasses
import functools
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from .._setup import needs_float64
from ..campaign.campaign import drawn_inputs
from ..campaign.description import describe
from ..campaign.dispersions import (
    Dispersion,
    check_dispersions,
    scaled_dispersions,
)
from ..campaign.users_code import own_code
from ..flight.scenario import Scenario
from ..flight.scenario_checks import check
from ..flight.solver import AbstractSolver, FixedStep
from ..onboard.recurrent_network import ranges_of
from ..tuning.batch_gradients import Simulation
from ..tuning.losses import power_mean
from ..tuning.record import told
from .flight_residuals import (
    Flown,
    Residuals,
    Weights,
    curved,
    distances,
    flown,
    flown_with_derivatives,
    ground_miss,
    neural_law_of,
    weights_of,
    with_weights,
)
from .flight_segments import flown_in_segments, noisy_samples
from .recorded_law import record_inputs
from .segment_value import Learner, Segments
from .training_record import (
    PERCENTILES,
    HeldOut,
    Judged,
    Progress,
    TrainingFile,
    best_of,
)
from .weight_steps import (
    AbstractMethod,
    AdamSteps,
    GaussNewtonSteps,
)


_WIDER = 0.1
"""Share of the range of an input on flights of the law by which it is trusted beyond it"""


_EVERYWHERE = np.array([-1e300, 1e300])
"""Range of an input in training: the network is trusted wherever it leads"""


def robust_mean(distances: Array) -> Array:
    """Mean of sqrt(c^2 + d^2) - c, where c is twice the median of the distances d.

    It is quadratic for most flights, and linear for those that are far off.
    """
    scale = 2.0 * jax.lax.stop_gradient(jnp.median(distances))
    scale = jnp.maximum(scale, 1e-12)
    return jnp.mean(jnp.sqrt(scale * scale + distances * distances) - scale)


def tail_mean(distances: Array) -> Array:
    """The root of the mean eighth power of the distances: mostly of those farthest off."""
    return jnp.asarray(power_mean(distances, 8.0))


METHODS: tuple[AbstractMethod, ...] = (
    AdamSteps(robust_mean, steps=500, flights=128),
    GaussNewtonSteps(robust_mean, steps=120, flights=512),
    GaussNewtonSteps(power_mean, steps=80, flights=512, share=0.15),
    GaussNewtonSteps(tail_mean, steps=60, flights=512, share=0.1),
)
"""Methods of a training if none are given: a law from random weights, then one that is
exact for most flights, then one that is for all"""


@dataclasses.dataclass(frozen=True)
class TrainedLaw:
    """A scenario with the best weights of a training, and the course of the training."""

    scenario: Scenario
    course: list[Judged]
    best: int
    """Position of the best weights in the course"""
    final: Judged
    """The trained law on further flights, which have not selected its weights"""


@needs_float64
def train_neural_law(
    scenario: Scenario,
    dispersions: Mapping[str, Dispersion],
    key: Key[Array, ""],
    *,
    residuals: Residuals = ground_miss,
    methods: Sequence[AbstractMethod] = METHODS,
    widths: Sequence[float] | None = None,
    held_out: int = 2048,
    judge_every: int = 1024 * 10,
    judged_by: float = 99.0,
    patience: int | None = None,
    solver: AbstractSolver = FixedStep(),
    history: float | None = None,
    store: Path | str | None = None,
    labels: Mapping[str, Any] | None = None,
    segments: Segments | None = None,
    report: Callable[[Judged], None] = lambda judged: None,
) -> TrainedLaw:
    """Train the network of a `NeuralLaw` with exact derivatives of dispersed flights.

    In training the network is trusted everywhere, also beside another law. The trained law
    has the ranges of its inputs on `held_out` further flights, a tenth wider to both sides.

    **Arguments:**

    - `scenario`: scenario with a `NeuralLaw`; its weights are the start.
    - `residuals`: function of a scenario and its flight that returns numbers of order one
      which shall be zero. The loss is a statistic of their root sum of squares, the
      distance.
    - `methods`: methods in their order, each with its loss and its numbers of steps and
      flights.
    - `widths`: factor on the width of the dispersions with each method; ones if not given.
      Constants keep their value. Judgements are with the dispersions themselves.
    - `held_out`: number of flights of a judgement. All judgements in the course have equal
      draws, and the final one has others.
    - `judge_every`: number of flights with derivatives between judgements.
    - `judged_by`: percentile of the distance by which weights are better; one of
      `PERCENTILES`.
    - `patience`: number of judgements without a better one after which a method ends;
      None for all steps.
    - `solver`, `history`: as for `fly`.
    - `store`: file from which the same call resumes, with the same bits.
    - `labels`: further values that must be the same for a training to resume.
    - `segments`: cuts of each flight, through which it is differentiated; None for
        derivatives of whole flights. With segments each flight of a step has a second one,
        from which a value learns. It needs no derivatives, and is not counted.
    - `report`: function that is called with each judgement.

    **Raises:** `ValueError` for a scenario with another law, for methods and widths of
    different numbers, for segments with a history, for a file of another training, and if
    no flight of a step has finite derivatives, or none of the trained law an end.
    """
    widths = [1.0] * len(methods) if widths is None else list(widths)
    if not methods or len(widths) != len(methods):
        raise ValueError(
            f"there are {len(methods)} methods and {len(widths)} widths: give one of each "
            "for every part of the training"
        )
    for name, value in (("held_out", held_out), ("judge_every", judge_every)):
        if value < 1:
            raise ValueError(f"{name} is {value}: it must be at least 1")
    if judged_by not in PERCENTILES:
        raise ValueError(
            f"judged_by is {judged_by}: choose from {', '.join(map(str, PERCENTILES))}"
        )
    if patience is not None and patience < 1:
        raise ValueError(f"patience is {patience}: it must be at least 1, or None")
    if segments is not None and history is not None:
        raise ValueError(
            f"history is {history} s and segments are given: a value knows the end of a "
            "flight and not its history; leave one of them out, and see `Flight.peaks`"
        )
    scenario = _with_ranges(scenario, _EVERYWHERE)
    check(scenario)
    check_dispersions(scenario, dispersions)
    simulation = Simulation(residuals, solver, history)
    tables = [scaled_dispersions(dispersions, w) for w in widths]
    file = None
    if store is not None:
        asked = {
            **describe(scenario, dispersions, 0, solver, history),
            "seed": jax.random.key_data(key).tolist(),
            "residuals": told(residuals),
            "methods": [told(method) for method in methods],
            "widths": widths,
            "held out": held_out,
            "judge every": judge_every,
            "judged by": judged_by,
            "patience": patience,
            "own code": own_code(residuals, *(m.statistic for m in methods)),
            "labels": {n: str(x) for n, x in (labels or {}).items()},
        }
        if segments is not None:
            asked["segments"] = told(segments)
        file = TrainingFile(Path(store), asked)
    tables = [*tables, dispersions]
    training = _Training(scenario, simulation, tables, key, held_out, segments)
    progress = None if file is None else file.read()
    if progress is None:
        start = weights_of(scenario)
        progress = Progress(0, 0, start, methods[0].start(start), start, [])
    began = time.perf_counter() - progress.seconds

    def judge() -> None:
        progress.seconds = time.perf_counter() - began
        found = training.judged(progress)
        best = best_of(progress.course, judged_by)
        if best is None or found.better_than(progress.course[best], judged_by):
            progress.best = progress.weights
        progress.course.append(found)
        if file is not None:
            file.write(progress)
        report(found)

    if not progress.course:
        judge()
    while progress.method < len(methods):
        method = methods[progress.method]
        every = max(1, judge_every // method.flights)
        while progress.step < method.steps and not _is_spent(
            progress, patience, judged_by
        ):
            training.advance(progress, method)
            if progress.step % every == 0 or progress.step == method.steps:
                judge()
        progress.method, progress.step = progress.method + 1, 0
        if progress.method < len(methods):
            # The next method begins where this one was best.
            progress.weights = progress.best
            progress.state = methods[progress.method].start(progress.weights)
        if file is not None:
            file.write(progress)
    best = best_of(progress.course, judged_by)
    assert best is not None
    trained = training.with_ranges(with_weights(scenario, progress.best))
    final = training.on_held_out(trained, "final")
    if final.without_end == held_out:
        raise ValueError(
            f"none of {held_out} flights of the trained law has an end: train with "
            "smaller dispersions first, or start with other weights"
        )
    of_best = dataclasses.replace(progress.course[best], **final._asdict())
    return TrainedLaw(trained, progress.course, best, of_best)


def distances_of(
    scenario: Scenario, simulation: Simulation, inputs: dict[str, Any]
) -> HeldOut:
    """Percentiles of the distance of flights, and the number of those without an end."""
    residuals, finite = flown(scenario, simulation, inputs)
    off = distances(residuals[finite]) if np.any(finite) else np.array([np.inf])
    percentiles = tuple(float(x) for x in np.percentile(off, PERCENTILES))
    return HeldOut(percentiles, int(np.sum(~finite)))


def _with_ranges(scenario: Scenario, ranges: np.ndarray) -> Scenario:
    """The scenario with other ranges of the inputs, or with one range for all of them."""
    known = neural_law_of(scenario).network.input_ranges
    return eqx.tree_at(
        lambda s: s.guidance.network.input_ranges,
        scenario,
        jnp.asarray(np.broadcast_to(ranges, known.shape)),
    )


def _is_spent(progress: Progress, patience: int | None, judged_by: float) -> bool:
    """Whether the last judgements of the present method were not better."""
    if patience is None:
        return False
    own = [j.method == progress.method for j in progress.course]
    best = best_of(progress.course, judged_by)
    assert best is not None
    since = sum(own[best + 1 :])
    return since >= patience


class _Training:
    """Flies the steps and the judgements of a training."""

    def __init__(self, scenario, simulation, tables, key, held_out, segments=None):
        self._scenario, self._simulation = scenario, simulation
        self._tables, self._key, self._held_out = tables, key, held_out
        self._segments: Segments | None = segments

    def advance(self, progress: Progress, method: AbstractMethod) -> None:
        """Take the next step of a method."""
        step, place = progress.step, progress.method
        runs = step * method.flights + np.arange(method.flights)
        now = with_weights(self._scenario, progress.weights)
        inputs = self._drawn(place, f"steps of {place}", runs)
        if self._segments is None:
            flights = flown_with_derivatives(now, self._simulation, inputs)
        else:
            others = self._drawn(place, f"value of {place}", runs)
            flights = self._in_segments(progress, now, inputs, others)
        found = curved(flights, method.statistic, method.needs_matrix, method.large)
        trial: list[dict[str, np.ndarray]] = []

        def tried(weights: Weights) -> tuple[int, float]:
            if not trial:
                trial.append(self._drawn(place, f"trials of {place}", runs))
            there = with_weights(self._scenario, weights)
            residuals, finite = flown(there, self._simulation, trial[0])
            without = int(np.sum(~finite))
            if without == len(finite):
                return without, np.inf
            off = jnp.asarray(distances(residuals[finite]))
            return without, float(method.statistic(off))

        progress.weights, progress.state = method.step(
            step, progress.weights, progress.state, found, tried
        )
        progress.step += 1
        progress.flights += method.flights
        progress.left_out += int(np.sum(~flights.finite))
        progress.clipped += found.clipped
        progress.loss = found.loss

    def _in_segments(
        self,
        progress: Progress,
        scenario: Scenario,
        inputs: dict[str, Any],
        others: dict[str, Any],
    ) -> Flown:
        """Flights with derivatives through segments, by a value that first learns from
        other flights of the same weights."""
        segments, simulation = self._segments, self._simulation
        assert segments is not None
        key = jax.random.fold_in(self._key, zlib.crc32(b"value"))
        noise, first, more = jax.random.split(
            jax.random.fold_in(key, progress.flights), 3
        )
        fly = functools.partial(noisy_samples, scenario, simulation, segments, others)
        if progress.value:
            learner = Learner.of_arrays(segments, progress.value)
            samples = fly(noise, learner.value.reached)
        else:
            samples = fly(noise, fly(noise, 0).reached)
            learner = Learner.begun(segments, samples, first)
        learner = learner.taught(segments, samples, more)
        progress.value = learner.as_arrays()
        return flown_in_segments(
            scenario, simulation, segments.cycles, learner.value, inputs
        )

    def judged(self, progress: Progress) -> Judged:
        there = with_weights(self._scenario, progress.weights)
        return Judged(
            method=progress.method,
            step=progress.step,
            flights=progress.flights,
            seconds=progress.seconds,
            loss=progress.loss,
            left_out=progress.left_out,
            clipped=progress.clipped,
            **self.on_held_out(there, "judgement")._asdict(),
        )

    def on_held_out(self, scenario: Scenario, purpose: str) -> HeldOut:
        """Distances of flights that no step uses, for a purpose."""
        inputs = self._drawn(-1, purpose, np.arange(self._held_out))
        return distances_of(scenario, self._simulation, inputs)

    def with_ranges(self, scenario: Scenario) -> Scenario:
        """The scenario with the ranges of the inputs on the flights of its law."""
        inputs = self._drawn(-1, "ranges", np.arange(self._held_out))
        law, solver = neural_law_of(scenario), self._simulation.solver
        read = record_inputs(scenario, law, inputs, solver).inputs
        samples = read[np.all(np.isfinite(read), axis=-1)]
        ranges = ranges_of(samples)
        wider = _WIDER * (ranges[:, 1:] - ranges[:, :1]) * np.array([-1.0, 1.0])
        return _with_ranges(scenario, ranges + wider)

    def _drawn(self, method: int, purpose: str, runs: np.ndarray) -> dict[str, Any]:
        """Draws for a purpose, with the dispersions of a method, or of full width (-1)."""
        key = jax.random.fold_in(self._key, zlib.crc32(purpose.encode()))
        return drawn_inputs(self._scenario, self._tables[method], key, runs)
