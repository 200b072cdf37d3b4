"""Ways to the weights of the neural law of the Mars lander, and what its flights cost.

    python benchmarks/neural_law.py through --seeds 0 1 2 --save
    python benchmarks/neural_law.py imitation --seeds 0 1 2 --save
    python benchmarks/neural_law.py evolution --seeds 0 1 2 --save
    python benchmarks/neural_law.py policy --seeds 0 1 2 --save
    python benchmarks/neural_law.py cost --save
    python benchmarks/neural_law.py tail --save
    python benchmarks/neural_law.py segments --save

All begin with the same random weights, and fly in the hard air of the mission. `through`
trains through the flight, with exact derivatives, as `jentry train` does. `imitation`
learns the banks of the predictor-corrector, and no more. `evolution` is a search without
derivatives: CMA-ES with a diagonal covariance matrix, by the package cmaes, with the
residuals and the robust mean of `through`. `policy` is a policy gradient, PPO, that needs
no derivatives of the flight, see `policy_gradient.py`: its flights have noise, and their
reward is minus the logarithm of the distance. The distance is that of the training: miss
over the ground and a share of the excess velocity, on 2048 flights that none of the ways
has used. All flights count: of `through` those with derivatives and those on which steps
are tried.

`cost` is the number of flights a second, over that of the predictor-corrector, each with
the step of its scenario. `tail` flies 100 000 flights of the law that comes with the
package. `segments` compares derivatives of whole flights with those through segments, with
a learned value at their ends, in a short training with Adam. Its flights with derivatives
are counted; through segments each has a second one without, from which the value learns.

`neural_law.csv` beside this file has what is saved.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import cmaes
import jax
import jax.numpy as jnp
import numpy as np
import policy_gradient
import records

import jentry
from jentry.campaign.campaign import drawn_inputs
from jentry.flight import Outcome
from jentry.learning import (
    AdamSteps,
    Segments,
    imitated,
    robust_mean,
    train_neural_law,
)
from jentry.learning.flight_residuals import (
    distances,
    flown,
    weights_of,
    with_weights,
)
from jentry.learning.law_training import random_law, train_law
from jentry.missions import find_mission
from jentry.tuning.batch_gradients import Simulation
from jentry.units import km


MISSION, LAW, WORLD = "mars-range-tracking", "neural", "hard-air"
SAVED = Path(__file__).with_suffix(".csv")
HEADINGS = "median, km", "95 %, km"
"""Columns of the course of a seed; a row has the number of its flights"""

HELD_OUT, JUDGED_BY = 2048, 987_654_321
"""Number of flights of a judgement, and the seed of their draws"""

POPULATION, FLIGHTS, GENERATIONS, FIRST_DEVIATION = 32, 128, 200, 0.1
"""Evolution: points in a generation, fresh flights of each, and the first deviation of the
weights. All points of a generation have the same draws. In all 800 000 flights"""


class Task:
    """The scenario with random weights of a seed, and its judgement."""

    def __init__(self, seed: int):
        training = find_mission(MISSION).law_training(LAW)
        # The first of the two: that with perfect navigation.
        assert training.before is not None
        self.training, self.seed = training.before, seed
        self.simulation = Simulation(
            self.training.residuals, self.training.solver, self.training.history
        )
        self.start, self.recording = random_law(self.training, seed)

    def off(self, scenario, draws: int, runs: np.ndarray) -> np.ndarray:
        """Distances of runs of a seed of draws; infinite without an end."""
        inputs = drawn_inputs(
            scenario, self.training.dispersions, jax.random.key(draws), runs
        )
        residuals, finite = flown(scenario, self.simulation, inputs)
        return np.where(finite, distances(residuals), np.inf)

    def judged(self, scenario) -> list[float]:
        """Median and 95 % of the distance, km."""
        off = self.off(scenario, JUDGED_BY, np.arange(HELD_OUT))
        return [float(x) for x in np.percentile(off, [50.0, 95.0], method="higher")]


def through(seed: int, folder: Path) -> list[tuple[int, list[float]]]:
    task = Task(seed)
    trained = train_law(task.training, seed, folder / f"through-{seed}", say=print)
    methods = task.training.methods
    before = [
        sum(_flights(m, m.steps) for m in methods[:place])
        for place in range(len(methods))
    ]
    course = [
        (before[j.method] + _flights(methods[j.method], j.step), list(j.distances[:2]))
        for j in trained.course[:-1]
    ]
    everything = sum(_flights(m, m.steps) for m in methods)
    return [*course, (everything, task.judged(trained.scenario))]


def _flights(method: Any, steps: int) -> int:
    """Flights of some steps: those with derivatives, and four trials of the same number."""
    return steps * method.flights * (5 if method.needs_matrix else 1)


def imitation(seed: int, folder: Path) -> list[tuple[int, list[float]]]:
    task = Task(seed)
    learn = jax.random.key(3000 + seed)
    learnt = imitated(task.start, task.recording, learn, report=print)
    return [(task.training.taught_flights, task.judged(learnt))]


def evolution(seed: int, folder: Path) -> list[tuple[int, list[float]]]:
    task = Task(seed)
    search = cmaes.SepCMA(
        mean=weights_of(task.start).copy(),
        sigma=FIRST_DEVIATION,
        seed=seed,
        population_size=POPULATION,
    )
    course = []
    for generation in range(GENERATIONS):
        runs = generation * FLIGHTS + np.arange(FLIGHTS)
        points = [search.ask() for _ in range(POPULATION)]
        losses = [
            # As in `through`, the loss leaves out flights without an end.
            float(robust_mean(jnp.asarray(off[np.isfinite(off)])))
            for off in (
                task.off(with_weights(task.start, p), 1000 + seed, runs) for p in points
            )
        ]
        search.tell(list(zip(points, losses, strict=True)))
        if (generation + 1) % 50 == 0:
            flights = (generation + 1) * POPULATION * FLIGHTS
            # The mean of the distribution is its best estimate.
            found = task.judged(with_weights(task.start, search.mean))
            course.append((flights, found))
            print(f"evolution, seed {seed}: {flights} flights, {found}", flush=True)
    return course


def policy(seed: int, folder: Path) -> list[tuple[int, list[float]]]:
    task = Task(seed)
    return policy_gradient.course_of(
        task.start, task.training.dispersions, task.simulation, seed, task.judged
    )


def cost(rounds: int = 3, runs: int = 8192) -> list[records.Cell]:
    mission = find_mission(MISSION)
    table = mission.dispersion_table(WORLD)
    laws = {n: mission.scenario(n, world=WORLD) for n in ("predictor-corrector", LAW)}
    rates: dict[str, list[float]] = {name: [] for name in laws}
    for turn in range(rounds + 1):
        for name, scenario in laws.items():
            began = time.perf_counter()
            jentry.monte_carlo(scenario, table, jax.random.key(turn), runs)
            if turn:
                rates[name].append(runs / (time.perf_counter() - began))
    ratios = np.array(rates[LAW]) / np.array(rates["predictor-corrector"])
    print({name: np.round(x) for name, x in rates.items()}, ratios)
    cores = len(jax.local_devices(backend="cpu"))
    return [
        records.Cell(
            LAW, "flights a second and core", np.median(rates[LAW]) / cores, 0
        ),
        records.Cell(
            LAW, "over those of the predictor-corrector", np.median(ratios), 1
        ),
    ]


def tail(runs: int = 100_000) -> list[records.Cell]:
    """Percentiles of the miss of many flights, and the runs that end farthest off."""
    mission = find_mission(MISSION)
    scenario = mission.scenario(LAW, world=WORLD)
    table = mission.dispersion_table(WORLD)
    flown = jentry.monte_carlo(scenario, table, jax.random.key(0), runs)
    off = np.hypot(flown.misses.downrange, flown.misses.crossrange) / km
    ended = np.asarray(flown.flights.outcome) == Outcome.REACHED
    off = np.where(ended, off, np.inf)
    beyond = np.asarray(flown.flights.caveats["decisions_beyond_training"]) > 0.0
    worst = np.argsort(-off)[:5]
    print("worst runs of seed 0:", dict(zip(worst.tolist(), off[worst], strict=True)))
    print("beyond the training:", beyond[worst])
    row = f"{runs} flights in hard air"
    named = [
        (f"miss, {p:g} %, km", np.percentile(off, p, method="higher"), 3)
        for p in (50.0, 95.0, 99.0, 99.9, 99.99)
    ]
    named += [
        ("largest, km", np.max(off), 3),
        ("flights farther than 1 km", np.sum(off > 1.0), 0),
        ("flights beyond the ranges of the training", np.sum(beyond), 0),
    ]
    return [records.Cell(row, heading, x, digits) for heading, x, digits in named]


SEGMENTS = {
    "whole flights": None,
    "segments of 60 cycles": Segments(60),
    "segments of 20 cycles": Segments(20),
}
STEPS, STEP_FLIGHTS = 120, 64
"""Of the trainings through segments, and of that through whole flights beside them"""


def segments(seeds: list[int]) -> list[records.Cell]:
    """Median and 95 % of the distance after equal numbers of flights with derivatives."""
    cells = []
    for seed in seeds:
        task = Task(seed)
        for name, cut in SEGMENTS.items():
            began = time.perf_counter()
            trained = train_neural_law(
                task.start,
                task.training.dispersions,
                jax.random.key(4000 + seed),
                residuals=task.training.residuals,
                methods=[AdamSteps(robust_mean, STEPS, STEP_FLIGHTS)],
                solver=task.training.solver,
                held_out=512,
                judge_every=STEPS * STEP_FLIGHTS // 4,
                segments=cut,
                report=lambda judged: print(judged.flights, judged.distances[:2]),
            )
            took = time.perf_counter() - began
            row = f"{name}, seed {seed}"
            course = {j.flights: j.distances for j in trained.course}
            for share in (4, 2, 1):
                flights = STEPS * STEP_FLIGHTS // share
                off = course[flights]
                cells += [
                    records.Cell(
                        row, f"median after {flights} flights, km", off[0], -1
                    ),
                    records.Cell(row, f"95 % after {flights}, km", off[1], -1),
                ]
            print(row, f"{took:.0f} s", [f"{c.value:.3g}" for c in cells[-6:]])
    return cells


def _saved(course: list[tuple[int, list[float]]]) -> list[tuple[int, list[float]]]:
    """Places of a course that are saved: each at about twice the flights of the last."""
    total = course[-1][0]
    places = [next(c for c in course if c[0] >= total / 2**k) for k in range(5, 0, -1)]
    return [c for n, c in enumerate([*places, course[-1]]) if c not in places[:n]]


WAYS = {
    "through": through,
    "imitation": imitation,
    "evolution": evolution,
    "policy": policy,
}


OTHERS = {"cost": lambda _: cost(), "tail": lambda _: tail(), "segments": segments}
"""Parts with one table for all seeds"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("part", choices=[*WAYS, *OTHERS])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--out", type=Path, default=Path("results/neural-law"))
    parser.add_argument("--save", action="store_true", help=f"to {SAVED.name}")
    options = parser.parse_args()
    jentry.setup()
    if options.part in OTHERS:
        cells = OTHERS[options.part](options.seeds)
        if options.save:
            records.save(SAVED, options.part, cells)
        return
    for seed in options.seeds:
        course = WAYS[options.part](seed, options.out)
        flights, (median, high) = course[-1]
        print(
            f"{options.part}, seed {seed}: {flights} flights, {median:.4g}, {high:.4g}"
        )
        cells = [
            records.Cell(f"{flights} flights", heading, value, -1)
            for flights, values in _saved(course)
            for heading, value in zip(HEADINGS, values, strict=True)
        ]
        if options.save:
            records.save(SAVED, f"{options.part}, seed {seed}", cells)


if __name__ == "__main__":
    main()
