"""What inertial navigation does to misses, triggers and time, in the world `inertial`.

    python benchmarks/navigation.py linear --missions mars-range-tracking --runs 10000
    python benchmarks/navigation.py reversals --missions apollo-10 --runs 3000
    python benchmarks/navigation.py miss --runs 2000
    python benchmarks/navigation.py trigger --runs 2000
    python benchmarks/navigation.py delivery --runs 2000
    python benchmarks/navigation.py tuning --runs 256 --seed 0
    python benchmarks/navigation.py cost --worlds inertial
    python benchmarks/navigation.py linear miss trigger delivery tuning cost --save

- `linear`: standard deviations of the end by linear covariance, over those of flights with
  the same draws, with the usual dispersions and those of knowledge at a tenth and at full
  size. The random walks of the navigation have a seed, and no output is linear in a seed:
  this part is without them. `--mode difference`, the default, takes mean slopes, which go
  across the jumps that bank reversals make; `--mode exact` takes derivatives.
- `reversals`: what linear covariance leaves out at a tenth: how well a linear function of
  the draws fits the errors of all flights, and of those whose reversals all fall in the
  same guidance cycles. Quartiles show whether tails are behind the difference.
- `miss`: the standard deviation of the miss, of the error of the navigation at the end and
  of the miss that the vehicle believes.
- `trigger`: a flight that the believed velocity ends, beside the same flight that the
  believed range to go ends. Both end at the same point without errors.
- `delivery`: what the knowledge of the mission `msl` does to its miss, independent of the
  delivery, and correlated with it as the error of a best estimate.
- `tuning`: the mean square of the miss before and after tuning with navigation errors, on
  4000 held-out draws: gains, observer and heading corridor of range tracking; memory and
  lateral logic of the predictor-corrector. Reversals jump, so gradients are differences.
- `cost`: flights a second and the time of the first answer from an empty cache, with a
  world over those without it. Campaigns with and without alternate; ratios are of medians.

`navigation.csv` beside this file has the tables, in the form of `records.py`: `--save`
replaces those that are measured.
"""

import argparse
import dataclasses
import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import numpy as np
import optimistix
from records import Cell, save

import jentry
from jentry import (
    InertialNavigation,
    believed_misses,
    linear_covariance,
    misses,
    navigation_errors,
)
from jentry.addresses import replace_leaves
from jentry.analysis.linear_models import draw_many, in_deviations
from jentry.campaign import Dispersion, monte_carlo
from jentry.campaign.dispersions import scaled_dispersions
from jentry.flight import (
    AltitudeBelow,
    FixedStep,
    RangeToGoBelow,
    VelocityBelow,
    has_end,
)
from jentry.flight.closed_loop import guidance_period
from jentry.missions import find_mission
from jentry.motion.constraints import DynamicPressure, MachNumber
from jentry.tuning import Draws, MeanSquare
from jentry.tuning.batch_gradients import Simulation
from jentry.tuning.draws import held_out
from jentry.tuning.judgement import judge
from jentry.units import km


SAVED = Path(__file__).with_suffix(".csv")
PARTS = "linear", "reversals", "miss", "trigger", "delivery", "tuning", "cost"
SEED = "navigation noise"
"""The dispersion of the seed of the random walks"""
USUAL = {
    "mars-range-tracking": "lift-to-drag-held",
    "sx-2": "everything",
    "apollo-10": "everything",
}
LINEAR = {"mars-range-tracking": "range-tracking", "apollo-10": "predictor-corrector"}
MISS = "range-tracking", "predictor-corrector"
TUNED = {
    "range-tracking": lambda s: (
        s.guidance.gains,
        s.guidance.observer,
        s.guidance.lateral.floor,
        s.guidance.lateral.widening,
    ),
    "predictor-corrector": lambda s: (
        s.guidance.estimator.time_constant,
        s.guidance.lateral.factor,
        s.guidance.lateral.tolerance,
    ),
}
"""Parameters that the part `tuning` varies"""
START = {
    "predictor-corrector": {
        "guidance.estimator.time_constant": 4.0,
        "guidance.lateral.tolerance": 100.0,
    }
}
"""Values at which it begins, where those of the mission have no scale: its estimator has no
memory, and its lateral logic no tolerance. Before tuning is the mission as it is"""
HELD_OUT = 4000
"""Draws on which the part `tuning` is judged"""
ALONG = "downrange", "crossrange", "altitude", "velocity"
TRIGGER_RANGE = 20.0 * km
"""Range to go at the end of the part `trigger`: larger than the crossrange errors, as a
flight that passes the target at a larger distance does not end"""
DELIVERY = {
    "independent": "everything-and-knowledge",
    "as estimated": "everything-and-estimated-knowledge",
}
"""Dispersions of the part `delivery`"""
REVERSING = ("apollo-10",)
"""Missions of the part `reversals`: all their flights end by one condition, and so have one
linear model"""
SIZES = {"a tenth": 0.1, "full size": 1.0}
ROUNDING = 1e-6
"""Standard deviation, m or m and s, below which an output is constant, such as the altitude
of a flight that ends at an altitude"""


def deviation(values) -> float:
    return float(np.std(np.asarray(values), ddof=1))


def dispersed(mission: str, world: str | None) -> dict[str, Dispersion]:
    """The usual dispersions of a mission, with those of knowledge in a world."""
    name = USUAL[mission] + ("" if world is None else "-and-knowledge")
    return dict(find_mission(mission).dispersions[name]())


def at_the_end(scenario, flight) -> dict[str, jax.Array]:
    """Errors at the end along and across the entry: actual, believed, and believed minus
    actual."""
    errors = {
        "true": misses(scenario, flight),
        "believed": believed_misses(scenario, flight),
        "navigation": navigation_errors(scenario, flight),
    }
    return {
        f"{who} {what}": getattr(found, what)
        for who, found in errors.items()
        for what in ALONG
    }


def without_walks(mission: str, size: str):
    """Scenario and dispersions of the parts `linear` and `reversals`."""
    scenario = find_mission(mission).scenario(LINEAR[mission], world="inertial")
    scenario = dataclasses.replace(scenario, navigation=InertialNavigation())
    dispersions = dispersed(mission, "inertial")
    del dispersions[SEED]
    return scenario, scaled_dispersions(dispersions, SIZES[size])


def linear(mission: str, runs: int, seed: int, mode: str, size: str) -> list[Cell]:
    scenario, dispersions = without_walks(mission, size)
    found = linear_covariance(
        scenario,
        dispersions,
        at_the_end,
        key=jax.random.key(seed),
        runs=runs,
        mode=mode,
    )
    print(
        f"{mission}, {size}: {found.runs} flights, {found.failed} failed, ends by "
        f"{list(found.models)}, without a model {found.without_model}"
    )
    heading = f"{size}, {mode}, {found.runs} flights"
    return [
        Cell(f"`{mission}`, {output}", f"{heading}, predicted over flown", x.ratio, 4)
        for output, x in found.spreads.items()
        if x.flown_standard_deviation > ROUNDING
    ]


def reversing(mission: str, runs: int, seed: int) -> list[Cell]:
    scenario, dispersions = without_walks(mission, "a tenth")
    key, period = jax.random.key(seed), guidance_period(scenario)
    found = linear_covariance(
        scenario, dispersions, at_the_end, key=key, mode="difference"
    )
    (model,) = found.models.values()
    pairs = tuple(dispersions.items())
    draws = in_deviations(pairs, draw_many(pairs, key, np.arange(runs)))
    campaign, have = ended(scenario, dispersions, seed, runs, period)
    side = np.sign(np.asarray(campaign.flights.history.controls.sin_bank))
    cells = []
    for what in "crossrange", "downrange":
        slopes = model.slopes[f"true {what}"]
        predicted = sum(slopes[name] * x for name, x in draws.items())
        flown = np.asarray(getattr(campaign.misses, what))
        cells += left_by_a_line(
            f"`{mission}`, {what}",
            flown[have],
            np.asarray(predicted)[have],
            np.stack([x[have] for x in draws.values()], axis=1),
            (side[:, 1:] * side[:, :-1] < 0.0)[have],
        )
    return cells


def left_by_a_line(row: str, flown, predicted, draws, turns) -> list[Cell]:
    """How well lines fit an error: of the draws, of shape (runs, dispersions), and where
    `turns`, of shape (runs, cycles), is the same."""
    _, group, sizes = np.unique(turns, axis=0, return_inverse=True, return_counts=True)
    alike = np.ravel(group) == np.argmax(sizes)
    count = np.sum(turns, axis=1)
    row = f"{row}, {flown.size} flights with {count.min()} to {count.max()} reversals"

    def left(which) -> float:
        rows = np.column_stack([np.ones(np.sum(which)), draws[which]])
        fit, *_ = np.linalg.lstsq(rows, flown[which], rcond=None)
        off = flown[which] - rows @ fit
        return float(np.sqrt(np.sum(off**2) / (off.size - rows.shape[1])))

    def quartiles(x) -> float:
        return float(np.subtract(*np.percentile(x, [75.0, 25.0])))

    spread = deviation(predicted) / deviation(flown)
    robust = quartiles(predicted) / quartiles(flown)
    return [
        Cell(row, "std, m", deviation(flown), 1),
        Cell(row, "predicted over flown", spread, 3),
        Cell(row, "quartiles, predicted over flown", robust, 3),
        Cell(row, "left by a line, m", left(np.full(flown.size, True)), 1),
        Cell(row, "flights with the same reversals", float(np.sum(alike)), 0),
        Cell(row, "std of these, m", deviation(flown[alike]), 1),
        Cell(row, "left by a line of these, m", left(alike), 1),
    ]


def ended(scenario, dispersions, seed: int, runs: int, history: float | None = None):
    """A campaign, and which of its flights have an end."""
    key = jax.random.key(seed)
    campaign = monte_carlo(scenario, dispersions, key, runs, history=history)
    return campaign, np.asarray(has_end(campaign.flights.outcome))


def miss(law: str, runs: int, seed: int) -> list[Cell]:
    mission = "mars-range-tracking"
    scenario = find_mission(mission).scenario(law, world="inertial")
    campaign, have = ended(scenario, dispersed(mission, "inertial"), seed, runs)
    cells = []
    for what in ("downrange", "crossrange"):
        row = f"{law}, {what}, {np.sum(have)} flights"
        actual, believed, errors = (
            deviation(np.asarray(getattr(found, what))[have])
            for found in (
                campaign.misses,
                campaign.believed_misses,
                campaign.navigation_errors,
            )
        )
        cells += [
            Cell(row, "miss, std, m", actual, 1),
            Cell(row, "navigation error, std, m", errors, 1),
            Cell(row, "believed miss, std, m", believed, 1),
            Cell(row, "miss over navigation error", actual / errors, 4),
        ]
    return cells


def triggered(ranged: bool):
    """The Mars flight with each of the two triggers, by trigger.

    `ranged` leaves the law its control of the range; otherwise it tracks its drag over the
    energy alone, by a scale that is held from the start.
    """
    scenario = find_mission("mars-range-tracking").scenario(
        "range-tracking", world="inertial"
    )
    law = scenario.guidance
    if not ranged:
        held = dataclasses.replace(law.limits, last_range=scenario.target.downrange * 2)
        law = dataclasses.replace(law, limits=held)
    target, start = scenario.target, scenario.initial_state
    # The entry is due east over the equator of a planet at rest.
    longitude = start.longitude + target.downrange / scenario.planet.radius
    to_go = RangeToGoBelow(TRIGGER_RANGE, longitude, start.latitude, by="navigation")
    constraints = {"mach": MachNumber(), "dynamic_pressure": DynamicPressure()}

    def ending(condition):
        conditions = dict(scenario.termination.conditions)
        del conditions["velocity"]
        conditions |= {"trigger": condition, "altitude": AltitudeBelow(2.0 * km)}
        return dataclasses.replace(
            scenario,
            guidance=law,
            constraints=constraints,
            values_at_end=tuple(constraints),
            termination=dataclasses.replace(
                scenario.termination, conditions=conditions
            ),
        )

    by_range = ending(to_go)
    velocity = jentry.fly(by_range).state.velocity
    by_velocity = ending(VelocityBelow(velocity, by="navigation"))
    return {"velocity": by_velocity, "range to go": by_range}


def trigger(ranged: bool, runs: int, seed: int) -> list[Cell]:
    dispersions = dispersed("mars-range-tracking", "inertial")
    law = "range tracking" if ranged else "drag tracking"
    cells = []
    for name, scenario in triggered(ranged).items():
        campaign, have = ended(scenario, dispersions, seed, runs)
        flights = campaign.flights
        place = scenario.termination.names.index("trigger")
        have &= np.asarray(flights.ended_by) == place
        row = f"{law}, {name}, {np.sum(have)} of {runs} flights"
        for column, values, unit, decimals in (
            ("downrange, std, km", campaign.misses.downrange, km, 3),
            ("altitude, std, km", flights.state.altitude, km, 3),
            ("Mach number, std", flights.at_end["mach"], 1.0, 4),
            (
                "dynamic pressure, std, Pa",
                flights.at_end["dynamic_pressure"],
                1.0,
                1,
            ),
        ):
            of_trigger = np.asarray(values)[have] / unit
            cells.append(Cell(row, column, deviation(of_trigger), decimals))
    return cells


def delivery(known: str, runs: int, seed: int) -> list[Cell]:
    mission = find_mission("msl")
    scenario = mission.scenario(world="inertial")
    table = mission.dispersion_table(DELIVERY[known])
    campaign, have = ended(scenario, table, seed, runs)
    start = scenario.initial_state
    across = (scenario.planet.radius + start.altitude) * np.cos(start.latitude)
    inputs = {name: np.asarray(x)[have] for name, x in campaign.inputs.items()}
    off = (inputs["initial_state.longitude"] - start.longitude) * across
    unknown = inputs["navigation.knowledge.east"]
    row = f"knowledge {known}, {np.sum(have)} flights"
    cells = [
        Cell(row, "correlation", float(np.corrcoef(off, unknown)[0, 1]), 3),
        Cell(row, "actual start, east, std, km", deviation(off / km), 3),
        Cell(row, "believed start, east, std, km", deviation((off + unknown) / km), 3),
    ]
    for what in ("downrange", "crossrange"):
        for words, found in (
            ("miss", campaign.misses),
            ("believed miss", campaign.believed_misses),
        ):
            values = np.asarray(getattr(found, what))[have] / km
            cells.append(Cell(row, f"{words}, {what}, std, km", deviation(values), 3))
    return cells


def tuning(law: str, world: str, runs: int, seed: int) -> list[Cell]:
    mission = "mars-range-tracking"
    shipped = find_mission(mission).scenario(law, world=world)
    loss = MeanSquare(lambda misses: (misses.downrange / km, misses.crossrange / km))
    # What is judged below is the mission as it is, and not where tuning begins.
    draws = Draws(dispersed(mission, world), jax.random.key(seed), runs, held_out=2)
    tuned = jentry.tune(
        replace_leaves(shipped, START.get(law, {})),
        TUNED[law],
        loss,
        optimistix.LBFGS(rtol=1e-6, atol=1e-6),
        draws,
        gradient=jentry.CentralDifferences(step=0.02),
        budget=jentry.Budget(steps=20, patience=10),
    )
    unseen = draws.dispersions, held_out(draws.key)
    judgement = judge(
        shipped,
        tuned.scenario,
        *unseen,
        HELD_OUT,
        loss,
        Simulation(misses, FixedStep()),
    )
    print(law, world, tuned.stopped, {n: x.tolist() for n, x in tuned.values.items()})
    turns = [reversals(of, *unseen) for of in (shipped, tuned.scenario)]
    row, cells = f"{law}, `{world}`, seed {seed}", []
    for name, size, words in (
        (("loss", ""), 1.0, "mean square of the miss, km2"),
        (("downrange", "95 % of |.|"), km, "95 % of downrange, km"),
        (("crossrange", "95 % of |.|"), km, "95 % of crossrange, km"),
    ):
        found = judgement[name]
        cells.append(Cell(row, f"{words}, before", found.before.value / size, -1))
        cells.append(Cell(row, f"{words}, after", found.after.value / size, -1))
        if not cells[2:]:
            for end in ("low", "high"):
                of = getattr(found.change, end)
                cells.append(Cell(row, f"{words}, change, {end}", of, -1))
    for when, count in zip(("before", "after"), turns, strict=True):
        cells.append(Cell(row, f"bank reversals, {when}", count, 1))
    return cells


def reversals(scenario, dispersions, key: jax.Array) -> float:
    """Mean number of changes of the sign of the bank, over 200 flights."""
    flights = monte_carlo(scenario, dispersions, key, 200, history=1.0).flights
    side = np.sign(flights.history.controls.sin_bank)
    return float(np.sum(side[:, 1:] * side[:, :-1] < 0.0) / len(side))


def first_answer(mission: str, world: str | None, runs: int) -> float:
    """Seconds of a process that begins with an empty cache."""
    name = USUAL[mission] + ("" if world is None else "-and-knowledge")
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "jentry", "monte-carlo", mission]
        command += ["--runs", str(runs), "--dispersions", name, "--no-figures"]
        command += ["--out", str(Path(folder) / "campaign")]
        command += [] if world is None else ["--world", world]
        environment = {**os.environ, "JENTRY_CACHE": str(Path(folder) / "cache")}
        begin = time.perf_counter()
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return time.perf_counter() - begin


def seconds_of(mission: str, world: str | None, runs: int) -> Callable[[int], float]:
    """Function of a seed that returns the seconds of a campaign; compiled already."""
    scenario = find_mission(mission).scenario(world=world)
    dispersions = dispersed(mission, world)
    monte_carlo(scenario, dispersions, jax.random.key(0), runs)

    def seconds(seed: int) -> float:
        begin = time.perf_counter()
        monte_carlo(scenario, dispersions, jax.random.key(seed), runs)
        return time.perf_counter() - begin

    return seconds


def cost(mission: str, world: str, runs: int, rounds: int, first: bool) -> list[Cell]:
    timed = {name: seconds_of(mission, name, runs) for name in (None, world)}
    spent = {name: [] for name in timed}
    answers = {name: [] for name in timed}
    for number in range(rounds):
        for name, seconds in timed.items():
            spent[name].append(seconds(1 + number))
    for _ in range(rounds if first else 0):
        for name in timed:
            answers[name].append(first_answer(mission, name, 64))
    without, within = (statistics.median(x) for x in spent.values())
    row = f"`{mission}`, `{world}`"
    cells = [Cell(row, f"flights a second, ratio, {runs} flights", without / within, 3)]
    if first:
        without, within = (statistics.median(x) for x in answers.values())
        cells.append(Cell(row, "first answer, ratio", within / without, 3))
    return cells


def measured(options: argparse.Namespace) -> Iterator[tuple[str, list[Cell]]]:
    """Names of tables and their cells, each as soon as it is measured."""
    missions, runs, seed = options.missions or list(USUAL), options.runs, options.seed
    for part in options.parts or PARTS:
        if part == "linear":
            for mission in (m for m in missions if m in LINEAR):
                for size in SIZES:
                    cells = linear(mission, runs, seed, options.mode, size)
                    yield f"linear, {mission}, {size}", cells
        elif part == "reversals":
            for mission in (m for m in missions if m in REVERSING):
                yield f"reversals, {mission}", reversing(mission, runs, seed)
        elif part == "miss":
            for law in MISS:
                yield f"miss, {law}", miss(law, runs, seed)
        elif part == "trigger":
            for ranged in (False, True):
                law = "range tracking" if ranged else "drag tracking"
                yield f"trigger, {law}", trigger(ranged, runs, seed)
        elif part == "delivery":
            for known in DELIVERY:
                yield f"delivery, {known}", delivery(known, runs, seed)
        elif part == "tuning":
            for law in options.laws:
                for world in options.worlds:
                    cells = tuning(law, world, runs, seed)
                    yield f"tuning, {law}, {world}, seed {seed}", cells
        else:
            for mission, world in itertools.product(missions, options.worlds):
                of = cost(mission, world, runs, options.rounds, not options.no_first)
                yield f"cost, {mission}, {world}", of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--missions", nargs="+", choices=list(USUAL), metavar="MISSION")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mode", choices=("exact", "difference"), default="difference")
    for name, known, of in (
        ("laws", list(TUNED), "the part tuning"),
        ("worlds", ["inertial", "aided"], "the parts tuning and cost"),
    ):
        given = {"nargs": "+", "choices": known, "default": known}
        parser.add_argument(f"--{name}", **given, help=f"of {of}")
    parser.add_argument("--rounds", type=int, default=3, help="of the part cost")
    parser.add_argument(
        "--no-first", action="store_true", help="part cost without first answers"
    )
    parser.add_argument("--save", action="store_true", help=f"to {SAVED.name}")
    options = parser.parse_args()
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"no such part: {unknown}; there are {list(PARTS)}")
    jentry.setup()
    for name, cells in measured(options):
        for cell in cells:
            print(f"{cell.row:60} {cell.column:50} {cell.value:12.5g}", flush=True)
        if options.save:
            save(SAVED, name, cells)


if __name__ == "__main__":
    main()
