"""How many flights and seconds does tuning by gradient need, beside Nelder-Mead and CMA-ES?

    python benchmarks/tuning.py --runs 256 --held-out 5000 --seeds 3
    python benchmarks/tuning.py --problem sx-2 --runs 256 --held-out 2000 --seeds 1

Six numbers of the Mars drag-tracking law (epsilon0, a, b of the error dynamics; epsilon,
l1, l2 of the observer), for the mean square downrange miss; or the 42 eigenvalues of the
gain schedule of SX-2, for the fourth power of the radial miss. They are in their logarithms
for all methods. The loss is of the same 256 draws, flown by the same compiled program. A
flight with its gradient counts as one flight; the seconds tell what it costs. Programs are
compiled before the clock starts.

Every method's best points so far are flown again on other draws. The first table has that
held-out loss when each method is stopped at the flights, and at the seconds, that the first
gradient method took; and at its own end. The second has the flights and the seconds after
which a method has, on held-out draws, 99 % of what the better derivative-free method gains
in the end.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import jentry


class Tuning(NamedTuple):
    """What is tuned, and for what."""

    mission: str
    choice: str
    where: Callable[[Any], Any]
    statistic: Callable[..., Any]
    """Of values of shape (runs,) that are zero on the target"""
    unit: str
    lengths: Callable[[Any], tuple]
    """Of the misses"""
    step: float | None = None
    """Of integration (s), if not that of the mission"""


def drag_tracking() -> Tuning:
    from jentry.tuning.losses import mean_square
    from jentry.units import km

    return Tuning(
        "mars-drag-tracking",
        "table-3",
        lambda s: (s.guidance.gains, s.guidance.observer),
        mean_square,
        "km2",
        lambda misses: (misses.downrange / km,),
    )


def sx_2() -> Tuning:
    from jentry.tuning.losses import power_mean
    from jentry.units import nautical_mile

    return Tuning(
        "sx-2",
        "scheduled",
        lambda s: (s.guidance.gains.downrange, s.guidance.gains.crossrange),
        power_mean,
        "n mile",
        lambda m: (m.downrange / nautical_mile, m.crossrange / nautical_mile),
        step=2.0,
    )


PROBLEMS = {"mars-drag-tracking": drag_tracking, "sx-2": sx_2}


class Point(NamedTuple):
    """A new best point of a method."""

    flights: int
    seconds: float
    gains: np.ndarray
    """The free numbers, zero at the start"""


class Run(NamedTuple):
    points: list[Point]
    flights: int
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=256)
    parser.add_argument("--held-out", type=int, default=5000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--steps", type=int, default=150, help="of the gradient methods"
    )
    parser.add_argument("--evaluations", type=int, default=600, help="of the others")
    parser.add_argument("--problem", choices=PROBLEMS, default="mars-drag-tracking")
    options = parser.parse_args()
    jentry.setup(fast=True)

    import cmaes
    import jax
    import jax.numpy as jnp
    import optax
    import optimistix
    import scipy.optimize

    from jentry.addresses import addresses_of
    from jentry.campaign.campaign import drawn_inputs
    from jentry.flight import misses
    from jentry.parameters.parameters import Parameters
    from jentry.tuning import Budget, Draws, tune
    from jentry.tuning.batch_gradients import Problem, Simulation
    from jentry.tuning.draws import held_out
    from jentry.tuning.gradients import fly_at
    from jentry.tuning.losses import OfDistance

    tuning = PROBLEMS[options.problem]()
    mission = jentry.find_mission(tuning.mission)
    scenario = mission.scenario_of(tuning.choice)
    dispersions = mission.dispersion_table()
    where = tuning.where
    loss = OfDistance(tuning.statistic, tuning.lengths)
    addresses = addresses_of(scenario, where)
    solver = jentry.FixedStep(tuning.step)
    simulation = Simulation(misses, solver)
    parameters = Parameters.of(scenario, where)
    problem = Problem(parameters, simulation)
    count = parameters.count
    sizes = [x.size for x in parameters.zeros().values()]

    def loss_over(key, runs):
        inputs = drawn_inputs(scenario, dispersions, key, np.arange(runs))

        def evaluate(gains):
            parts = np.split(gains, np.cumsum(sizes)[:-1])
            zeros = parameters.zeros()
            free = {
                a: jnp.asarray(x).reshape(zeros[a].shape)
                for a, x in zip(addresses, parts, strict=True)
            }
            outputs, finite = fly_at(problem, free, inputs)
            return float(loss(outputs)) if finite.all() else np.inf

        return evaluate

    def by_gradient(optimizer, patience):
        def search(key, seed, steps=options.steps):
            tuned = tune(
                scenario,
                where,
                loss,
                optimizer,
                Draws(dispersions, key, options.runs, held_out=2),
                solver=solver,
                budget=Budget(steps, patience),
            )
            points, best = [], None
            for entry in tuned.course:
                if best is None or entry.better_than(best):
                    best = entry
                    gains = np.concatenate([np.ravel(entry.free[a]) for a in addresses])
                    points.append(Point(entry.flights, entry.seconds, gains))
            last = tuned.course[-1]
            return Run(points, last.flights, last.seconds)

        return search

    def without_gradient(search_with):
        def search(key, seed, evaluations=options.evaluations):
            evaluate = loss_over(key, options.runs)
            points, begin, flown, least = [], time.perf_counter(), 0, np.inf

            def counted(gains):
                nonlocal flown, least
                value = evaluate(gains)
                flown += options.runs
                if value < least:
                    least = value
                    when = flown, time.perf_counter() - begin
                    points.append(Point(*when, np.array(gains)))
                return value

            search_with(counted, seed, evaluations)
            return Run(points, flown, time.perf_counter() - begin)

        return search

    def nelder_mead(evaluate, seed, evaluations):
        first = 0.3 * np.vstack([np.zeros(count), np.eye(count)])
        scipy.optimize.minimize(
            evaluate,
            np.zeros(count),
            method="Nelder-Mead",
            options={
                "maxfev": evaluations,
                "initial_simplex": first,
                "xatol": 1e-4,
                "fatol": 1e-4,
                "adaptive": True,
            },
        )

    def cma_es(evaluate, seed, evaluations):
        search = cmaes.CMA(mean=np.zeros(count), sigma=0.3, seed=seed)
        done = 0
        while done + search.population_size <= evaluations and not search.should_stop():
            asked = [search.ask() for _ in range(search.population_size)]
            search.tell([(gains, evaluate(gains)) for gains in asked])
            done += search.population_size

    methods = {
        "L-BFGS": by_gradient(optimistix.LBFGS(rtol=1e-6, atol=1e-6), 60),
        "Adam, 0.1": by_gradient(optax.adam(0.1), 20),
        "Nelder-Mead": without_gradient(nelder_mead),
        "CMA-ES": without_gradient(cma_es),
    }
    gradient = list(methods)[:2]

    key = jax.random.key(0)
    for name, search in methods.items():  # compiles
        search(key, 0, **({"steps": 2} if name in gradient else {"evaluations": 8}))

    found: dict[str, list[tuple[Run, np.ndarray, float]]] = {m: [] for m in methods}
    for seed in range(options.seeds):
        key = jax.random.key(seed)
        judge = loss_over(held_out(key), options.held_out)
        start = judge(np.zeros(count))
        for name, search in methods.items():
            run = search(key, seed)
            losses = np.array([judge(point.gains) for point in run.points])
            found[name].append((run, losses, start))

    print(
        f"{options.runs} draws, judged on {options.held_out} others, {options.seeds} seeds,"
        f" {len(jax.devices())} cores, jax {jax.__version__}; medians over the seeds"
    )
    print_stopped(found, next(iter(methods)), tuning.unit)
    print_reached(found, gradient)


def stopped_at(run: Run, losses: np.ndarray, flights=np.inf, seconds=np.inf) -> float:
    """Held-out loss of the best point by then."""
    there = [
        value
        for point, value in zip(run.points, losses, strict=True)
        if point.flights <= flights and point.seconds <= seconds
    ]
    return there[-1] if there else np.nan


def print_stopped(found, first: str, unit: str) -> None:
    print(f"{'held-out loss, ' + unit:22}{'at flights':>12}{'at seconds':>12}", end="")
    print(f"{'at its end':>12}{'flights':>10}{'seconds':>9}")
    starts = [start for _, _, start in found[first]]
    print(f"{'the gains at the start':22}{'':24}{np.median(starts):12.4f}")
    for name, runs in found.items():
        rows = []
        for (run, losses, _), (reference, _, _) in zip(runs, found[first], strict=True):
            rows.append(
                (
                    stopped_at(run, losses, flights=reference.flights),
                    stopped_at(run, losses, seconds=reference.seconds),
                    stopped_at(run, losses),
                    run.flights,
                    run.seconds,
                )
            )
        a, b, c, flights, seconds = np.median(rows, axis=0)
        print(f"{name:22}{a:12.4f}{b:12.4f}{c:12.4f}{flights:10.0f}{seconds:9.1f}")


def print_reached(found, gradient: list[str]) -> None:
    others = [name for name in found if name not in gradient]
    seeds = range(len(found[others[0]]))
    print(f"\n{'to 99 % of the gain':22}{'flights':>10}{'seconds':>9}", end="")
    print(f"{'share of the flights':>22}  of the seeds")
    needed: dict[str, list[tuple[float, float]]] = {name: [] for name in found}
    for seed in seeds:
        start = found[others[0]][seed][2]
        least = min(found[name][seed][1][-1] for name in others)
        target = least + 0.01 * (start - least)
        for name, runs in found.items():
            run, losses, _ = runs[seed]
            hits = [
                (point.flights, point.seconds)
                for point, value in zip(run.points, losses, strict=True)
                if value <= target
            ]
            needed[name].append(hits[0] if hits else (np.inf, np.inf))
    fewest = np.array([min(needed[name][seed][0] for name in others) for seed in seeds])
    for name, hits in needed.items():
        flights, seconds = np.median(hits, axis=0)
        shares = np.array([hit[0] for hit in hits]) / fewest
        each = ", ".join(f"{share:.2f}" for share in shares)
        print(
            f"{name:22}{flights:10.0f}{seconds:9.1f}{np.median(shares):22.2f}  {each}"
        )


if __name__ == "__main__":
    main()
