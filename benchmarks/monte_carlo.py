"""How many guided Mars entries per second, on one core and on two, and against what?

    python benchmarks/monte_carlo.py --runs 1000 --rounds 5 --step 0.1
    python benchmarks/monte_carlo.py --space

The same dispersed flights by jentry and by four programs written without it (see
`comparators`). jentry, C and numba take the same steps; scipy and diffrax choose theirs,
with a tolerance that makes them about as accurate, which the table shows: the rms distance
of the end points from a reference solution. Each program lives in a process of its own
that is pinned to its cores. They take turns, round by round, so that a slow minute of the
machine is shared by all; the table has medians over the rounds.

With `--space` the same law flies in three dimensions, banked to the right all the way, by
jentry and by C. Their reference is that of C with a tenth of the step.
"""

import argparse
import dataclasses
import functools
import importlib.metadata
import multiprocessing
import os
import platform
import sys
import time
import traceback
from collections.abc import Callable
from typing import NamedTuple

import comparators
import numpy as np
from records import TIMINGS, Cell, processor, save


ADDRESSES = {
    "mass": "vehicle.mass",
    "density_scale": "planet.density_scale",
    "lift_scale": "vehicle.lift_scale",
    "drag_scale": "vehicle.drag_scale",
}


_WRONG = 10.0
"""m, rms; far more than any of the programs errs"""


class Problem(NamedTuple):
    """What every program is given."""

    mission: comparators.Mission
    reference: np.ndarray
    inputs: dict[str, np.ndarray]
    step: float
    tolerance: float
    space: bool = False
    """Whether it flies in three dimensions"""


class Program(NamedTuple):
    """A row of the table. `prepare(problem, cores)` returns a function that flies."""

    name: str
    cores: int
    prepare: Callable
    share: int = 1
    """It flies only so many times fewer flights: for the slow ones"""


def _scenario(space: bool = False):
    import jentry
    from jentry.motion.dynamics import EntryDynamics

    scenario = jentry.find_mission("mars-drag-tracking").scenario("energy-index")
    if space:
        scenario = dataclasses.replace(scenario, dynamics=EntryDynamics())
    return scenario


def prepare_jentry(problem: Problem, cores: int, fast: bool):
    """The only function that flies jentry."""
    import jentry

    jentry.setup(cores, fast=fast, cache=False)
    scenario = _scenario(problem.space)
    inputs = {ADDRESSES[name]: values for name, values in problem.inputs.items()}
    solver = jentry.FixedStep(problem.step)
    runs = len(problem.inputs["mass"])

    def fly():
        campaign = jentry.monte_carlo(scenario, inputs=inputs, runs=runs, solver=solver)
        time, state = campaign.flights.time, campaign.flights.state
        downrange = scenario.planet.radius * state.longitude
        return np.stack([time, state.altitude, downrange, state.velocity])

    return fly


def prepare_fast_jentry(problem: Problem, cores: int):
    return prepare_jentry(problem, cores, fast=True)


def prepare_plain_jentry(problem: Problem, cores: int):
    return prepare_jentry(problem, cores, fast=False)


def prepare_c(problem: Problem, cores: int):
    given = problem.mission, problem.reference
    how = {"step": problem.step, "threads": cores, "space": problem.space}
    return lambda: comparators.c_flights(*given, **problem.inputs, **how)


def prepare_numba(problem: Problem, cores: int, fastmath: bool = False):
    given = problem.mission, problem.reference
    return lambda: comparators.numba_flights(
        *given, **problem.inputs, step=problem.step, fastmath=fastmath, threads=cores
    )


def prepare_fast_numba(problem: Problem, cores: int):
    return prepare_numba(problem, cores, fastmath=True)


def prepare_diffrax(problem: Problem, cores: int):
    import jax

    jax.config.update("jax_enable_x64", True)
    given = problem.mission, problem.reference
    return lambda: comparators.diffrax_flights(
        *given, **problem.inputs, tolerance=problem.tolerance
    )


def prepare_scipy(problem: Problem, cores: int):
    given = problem.mission, problem.reference
    return lambda: comparators.scipy_flights(
        *given, **problem.inputs, tolerance=problem.tolerance
    )


PROGRAMS = (
    Program("jentry, fast", 1, prepare_fast_jentry),
    Program("jentry", 1, prepare_plain_jentry),
    Program("C, vectors", 1, prepare_c),
    Program("numba, scalar, fastmath", 1, prepare_fast_numba),
    Program("numba, scalar", 1, prepare_numba),
    Program("diffrax, vmap(diffeqsolve)", 1, prepare_diffrax),
    Program("scipy, solve_ivp", 1, prepare_scipy, share=50),
    Program("jentry, fast", 2, prepare_fast_jentry),
    Program("jentry", 2, prepare_plain_jentry),
    Program("C, vectors, two threads", 2, prepare_c),
    Program("numba, prange, fastmath", 2, prepare_fast_numba),
)


_IN_SPACE = prepare_fast_jentry, prepare_plain_jentry, prepare_c


def draw_inputs(runs: int) -> dict[str, np.ndarray]:
    """The mission's dispersions: mass, density, one factor on both coefficients."""
    random = np.random.default_rng(0)
    coefficients = random.uniform(0.7, 1.3, runs)
    return {
        "mass": 992.0 * random.uniform(0.95, 1.05, runs),
        "density_scale": random.uniform(0.8, 1.2, runs),
        "lift_scale": coefficients,
        "drag_scale": coefficients,
    }


def jentry_mission() -> tuple[comparators.Mission, np.ndarray]:
    """jentry's mission in plain numbers, and the table of its reference drag."""
    import jentry

    jentry.setup(1)
    scenario = _scenario()
    planet, vehicle, start = scenario.planet, scenario.vehicle, scenario.initial_state
    law, conditions = scenario.guidance, scenario.termination.conditions
    mission = comparators.Mission(
        planet_radius=planet.radius,
        gravitational_parameter=planet.gravity.gravitational_parameter,
        surface_density=planet.atmosphere.surface_density,
        scale_height=planet.atmosphere.scale_height,
        reference_area=vehicle.reference_area,
        lift_coefficient=vehicle.aerodynamics.lift_coefficient,
        drag_coefficient=vehicle.aerodynamics.drag_coefficient,
        altitude=start.altitude,
        velocity=start.velocity,
        flight_path_angle=start.flight_path_angle,
        end_velocity=conditions["velocity"].velocity,
        end_altitude=conditions["altitude"].altitude,
        time_limit=scenario.termination.time_limit,
        epsilon0=law.gains.epsilon0,
        a=law.gains.a,
        b=law.gains.b,
        epsilon=law.observer.epsilon,
        l1=law.observer.l1,
        l2=law.observer.l2,
        reference_start=law.reference.drag.start,
        reference_spacing=law.reference.drag.spacing,
    )
    plain = comparators.Mission(*(float(number) for number in mission))
    return plain, np.asarray(law.reference.drag.coefficients)


def true_ends(problem: Problem) -> np.ndarray:
    """By scipy's method of order 8 with a tolerance of 1e-12; in space by the program in C
    with a tenth of the step."""
    if problem.space:
        return np.array(prepare_c(problem._replace(step=0.1 * problem.step), 1)())
    given = problem.mission, problem.reference
    ends = comparators.scipy_flights(
        *given, **problem.inputs, tolerance=1e-12, method="DOP853"
    )
    return np.array(ends)


def pin(cores: int) -> None:
    """Keep this process, and what it starts, on the last cores of those it may use."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-cores:])


def available_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def serve(pipe, cores: int, prepare: Callable, *given) -> None:
    """Life of a process: prepare, fly once for the result, then fly and time each round."""
    pin(cores)
    try:
        began = time.perf_counter()
        fly = prepare(*given)
        result = fly()
        pipe.send((time.perf_counter() - began, result))
        while pipe.recv():
            began = time.perf_counter()
            fly()
            pipe.send(time.perf_counter() - began)
    except Exception:
        pipe.send((traceback.format_exc(), None))


class Worker:
    """A process of its own, with its own XLA options, devices and cores."""

    def __init__(self, cores: int, prepare: Callable, *given):
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        arguments = other, cores, prepare, *given
        context.Process(target=serve, args=arguments, daemon=True).start()
        self.seconds, self.result = self.pipe.recv()
        if isinstance(self.seconds, str):
            raise RuntimeError(self.seconds)

    def time(self) -> float:
        """Seconds for one more round."""
        self.pipe.send(True)
        return self.pipe.recv()

    def stop(self) -> None:
        self.pipe.send(False)


def in_own_process(function: Callable, *given):
    """Result of one call that leaves this process untouched."""
    worker = Worker(1, functools.partial, function, *given)
    worker.stop()
    return worker.result


def first_flights(problem: Problem, count: int) -> Problem:
    inputs = {name: values[:count] for name, values in problem.inputs.items()}
    return problem._replace(inputs=inputs)


def available_programs(space: bool = False) -> list[Program]:
    """Those for which there are cores, and a C compiler if they need one.

    Raises `comparators.NoCProgramError` in space without a C compiler, which all are
    compared with there.
    """
    programs = [p for p in PROGRAMS if p.cores <= available_cores()]
    if space:
        comparators.c_program(space=space)
        return [p for p in programs if p.prepare in _IN_SPACE]
    try:
        comparators.c_program(space=False)
    except comparators.NoCProgramError as error:
        print(f"without the programs in C: {error}")
        programs = [p for p in programs if p.prepare is not prepare_c]
    return programs


def machine() -> str:
    """Processor and versions, on one line each."""
    packages = "jax", "diffrax", "numba", "scipy", "numpy"
    versions = ", ".join(f"{p} {importlib.metadata.version(p)}" for p in packages)
    return f"{processor()}\nPython {platform.python_version()}, {versions}"


def check_errors(programs, errors) -> None:
    """Raises `SystemExit` for a program that has flown another mission."""
    for program, error in zip(programs, errors, strict=True):
        if not error < _WRONG:
            sys.exit(
                f"{program.name} ends {error:.3g} m from the reference solution, more than "
                f"{_WRONG:g} m: it flies something else, and its speed says nothing"
            )


def print_table(programs, speeds, starts, errors) -> None:
    """Speeds: (programs, rounds) in flights/s; each compared on as many cores."""
    print(f"{'':30s}{'cores':>6s}{'flights/s':>11s}{'range':>14s}", end="")
    print(f"{'jentry is':>11s}{'error, m':>10s}{'start, s':>10s}")
    for i, program in enumerate(programs):
        fast = next(j for j, p in enumerate(programs) if p.cores == program.cores)
        ratio = np.median(speeds[fast] / speeds[i])
        spread = f"{speeds[i].min():.0f}..{speeds[i].max():.0f}"
        print(f"{program.name:30s}{program.cores:6d}", end="")
        speed = np.median(speeds[i])
        print(f"{speed:11.{0 if speed > 100.0 else 1}f}{spread:>14s}", end="")
        print(f"{ratio:10.2f}x{errors[i]:10.2g}{starts[i]:10.1f}")


def save_table(programs, speeds, errors) -> None:
    """Write the table of the page `docs/how/speed.md`; speeds as in `print_table`."""
    cells = []
    for i, program in enumerate(programs):
        fast = next(j for j, p in enumerate(programs) if p.cores == program.cores)
        cores = f", {program.cores} cores" if program.cores > 1 else ""
        row = f"{program.name}{cores}"
        ratio = float(np.median(speeds[fast] / speeds[i]))
        cells += [
            Cell(row, "flights/s", float(np.median(speeds[i])), -1),
            Cell(row, "slowest round", float(speeds[i].min()), -1),
            Cell(row, "fastest round", float(speeds[i].max()), -1),
            Cell(row, "jentry on as many cores is faster by", ratio, 2),
            Cell(row, "error of the end, m", float(errors[i]), 3),
        ]
    save(TIMINGS, "monte-carlo", cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000, help="flights in a round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--step", type=float, default=0.1, help="of the fixed steps, s")
    parser.add_argument(
        "--tolerance", type=float, default=1e-8, help="of the adaptive steps"
    )
    parser.add_argument("--judged", type=int, default=16, help="flights for the error")
    parser.add_argument("--space", action="store_true", help="in three dimensions")
    parser.add_argument("--save", action="store_true", help=f"to {TIMINGS.name}")
    options = parser.parse_args()
    os.environ["JAX_PLATFORMS"] = "cpu"

    print(machine())
    mission, reference = in_own_process(jentry_mission)
    inputs = draw_inputs(options.runs)
    how = options.step, options.tolerance, options.space
    problem = Problem(mission, reference, inputs, *how)
    programs = available_programs(options.space)
    truth = in_own_process(true_ends, first_flights(problem, options.judged))

    workers, flights, errors = [], [], []
    for program in programs:
        count = max(min(options.judged, options.runs), options.runs // program.share)
        given = first_flights(problem, count)
        workers.append(Worker(program.cores, program.prepare, given, program.cores))
        flights.append(count)
        miss = np.array(workers[-1].result)[1:3, : options.judged] - truth[1:3]
        errors.append(np.sqrt(np.mean(np.sum(miss**2, axis=0))))
    check_errors(programs, errors)

    seconds = np.array([[w.time() for w in workers] for _ in range(options.rounds)]).T
    speeds = np.array(flights)[:, None] / seconds
    starts = [worker.seconds for worker in workers]
    for worker in workers:
        worker.stop()
    print(f"{options.runs} flights, {options.rounds} rounds, float64, ", end="")
    where = "in space, " if options.space else ""
    print(f"{where}steps of {options.step} s, tolerance {options.tolerance:g}\n")
    print_table(programs, speeds, starts, errors)
    if options.save:
        save_table(programs, speeds, errors)


if __name__ == "__main__":
    main()
