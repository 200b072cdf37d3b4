"""How far does a statistic of one Monte Carlo set go from one set to another?

Flies 16 sets of 500 runs of each law of the CAV-H mission, 16 of 1000 of the Mars missions,
and smaller ones of the other missions, where the predictor-corrector flies beside the laws
of the papers: consecutive runs of one seed, which share no draw. Prints the mean of each
statistic over the sets and its standard deviation from set to set: the tables of the
pages of the missions. Campaigns are stored below --out, and are resumed or read again from
there.

    python benchmarks/populations.py cav-h
    python benchmarks/populations.py mars-range-tracking
    python benchmarks/populations.py mars-drag-tracking
    python benchmarks/populations.py sx-2
    python benchmarks/populations.py apollo-10
    python benchmarks/populations.py cav-h-glide
    python benchmarks/populations.py msl
    python benchmarks/populations.py mars-aerocapture
    python benchmarks/populations.py neptune-aerocapture

`populations.csv` beside this file has each statistic of each set: `--save` writes it
again. Its columns are mission, law with case and worlds, dispersions, heading, date, the
statistic of the first 8 runs of the first set, and that of each set. The pages take their
tables from it. The tests fly the first sets or, where these would take long, their first
runs, and compare them with it.
"""

import argparse
import csv
import datetime
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jentry
from jentry.campaign import open_campaign, run_campaign
from jentry.campaign.populations import finite_flights, population, sets_of
from jentry.flight import Outcome
from jentry.missions import find_mission
from jentry.missions.choice import Choice
from jentry.missions.x_33.scenario import corridor
from jentry.statistics.miss_ellipse import ellipse_of
from jentry.units import degree, km


SETS = 16

FIRST_RUNS = 8
"""So many of the first set have statistics of their own"""


class Column(NamedTuple):
    """A statistic of a set, over magnitudes in a unit."""

    heading: str
    variable: str
    size: float
    """SI units in the unit that is shown"""
    statistic: Callable[[np.ndarray], float]

    def of(self, results) -> float:
        return float(self.statistic(np.abs(results[self.variable].values) / self.size))


def percentile(percent: float) -> Callable[[np.ndarray], float]:
    return lambda magnitudes: np.percentile(magnitudes, percent)


def within(limit: float) -> Callable[[np.ndarray], float]:
    return lambda magnitudes: 100.0 * np.mean(magnitudes <= limit)


def deviation(variable: str, size: float = km) -> Callable[..., float]:
    return lambda results: float(np.std(results[variable].values, ddof=1) / size)


def mean(variable: str, size: float) -> Callable[..., float]:
    return lambda results: float(np.mean(results[variable].values) / size)


VELOCITY, ANGLE = "velocity_error", "flight_path_angle_error"
PRESSURE = "peak_dynamic_pressure"
DOWNRANGE, CROSSRANGE = "downrange_error", "crossrange_error"

_END = tuple(
    Column(f"{name}, {heading}, km", variable, km, statistic)
    for name, variable in (
        ("downrange error", DOWNRANGE),
        ("crossrange error", CROSSRANGE),
        ("altitude error", "altitude_error"),
    )
    for heading, statistic in (
        ("median", np.median),
        ("99th percentile", percentile(99)),
        ("maximum", np.max),
    )
)
"""Of a mission whose laws are compared by where they end"""

_PEAKS = (
    Column("heat rate, maximum, MW/m2", "peak_heat_rate", 1e6, np.max),
    Column("load factor, maximum", "peak_load_factor", 1.0, np.max),
    Column("dynamic pressure, maximum, kPa", PRESSURE, 1e3, np.max),
)
"""Of a mission with these limits"""

_APOAPSIS, _INCLINATION = "apoapsis_error", "inclination_error"
_INCREMENT = "velocity_increment"
_ORBIT = (
    Column("velocity increment, mean, m/s", _INCREMENT, 1.0, np.mean),
    Column("velocity increment, maximum, m/s", _INCREMENT, 1.0, np.max),
    Column("load factor, mean", "peak_load_factor", 1.0, np.mean),
    Column("load factor, maximum", "peak_load_factor", 1.0, np.max),
)
"""Of a mission whose target is an orbit"""

COLUMNS = {
    "cav-h": (
        Column("velocity error, mean, m/s", VELOCITY, 1.0, np.mean),
        Column("median", VELOCITY, 1.0, np.median),
        Column("maximum", VELOCITY, 1.0, np.max),
        Column("within 20 m/s, %", VELOCITY, 1.0, within(20.0)),
        Column("miss, maximum, m", "miss_distance", 1.0, np.max),
        Column("path angle, maximum, deg", ANGLE, degree, np.max),
        Column("azimuth, maximum, deg", "heading_error", degree, np.max),
        Column("dynamic pressure, mean peak, kPa", PRESSURE, 1e3, np.mean),
        Column("maximum peak", PRESSURE, 1e3, np.max),
    ),
    "mars-range-tracking": (
        Column("downrange error, median, km", DOWNRANGE, km, np.median),
        Column("95th percentile", DOWNRANGE, km, percentile(95)),
        Column("maximum", DOWNRANGE, km, np.max),
        Column("crossrange error, 95th percentile", CROSSRANGE, km, percentile(95)),
    ),
    "mars-drag-tracking": (),
    "sx-2": _END,
    "x-33": _END,
    "rlv": _END,
    "apollo-10": (
        *_END[:6],
        Column("miss, median, km", "miss_distance", km, np.median),
        Column("miss, 99th percentile, km", "miss_distance", km, percentile(99)),
        Column("miss, maximum, km", "miss_distance", km, np.max),
        Column("within 1 km, %", "miss_distance", km, within(1.0)),
        Column("within 10 km, %", "miss_distance", km, within(10.0)),
        *_PEAKS,
        Column("load factor, median", "peak_load_factor", 1.0, np.median),
    ),
    "cav-h-glide": (
        *_END,
        *_PEAKS,
        Column("velocity error, median, m/s", VELOCITY, 1.0, np.median),
        Column("velocity error, maximum, m/s", VELOCITY, 1.0, np.max),
    ),
    "msl": (
        *_END[:6],
        *_PEAKS,
        Column("load factor, median", "peak_load_factor", 1.0, np.median),
        Column("altitude at the end, median, km", "end_altitude", km, np.median),
        Column("Mach number at the end, median", "end_mach", 1.0, np.median),
        Column("time of the flight, median, s", "end_time", 1.0, np.median),
    ),
    "mars-aerocapture": _ORBIT,
    "neptune-aerocapture": _ORBIT,
}


def lost(results) -> float:
    """Share of the flights that did not reach the target, %"""
    return 100.0 * float(np.mean(results["outcome"].values != Outcome.REACHED))


def share_of_limit(name: str) -> Callable[..., float]:
    def share(results) -> float:
        limit = corridor()[name].limit
        return float(np.max(results[f"peak_{name}"].values) / limit)

    return share


def over_ground(statistic: Callable[[np.ndarray], float]) -> Callable[..., float]:
    """Of the distance from the target over the ground, km."""

    def of(results) -> float:
        errors = (results[name].values for name in (DOWNRANGE, CROSSRANGE))
        return float(statistic(np.hypot(*errors) / km))

    return of


def axis_of_ellipse(place: int) -> Callable[..., float]:
    """Length of the error ellipse of 99 % (0) or its width (1), from end to end, km."""

    def of(results) -> float:
        ellipse = ellipse_of(results, (99.0,))
        assert ellipse is not None
        return 2.0 * ellipse.scale(99.0) * ellipse.semi_axes[place] / km

    return of


def end_velocity(statistic: Callable[[np.ndarray], float]) -> Callable[..., float]:
    """Of the velocity at the end, m/s."""
    return lambda results: float(statistic(results["end_velocity"].values))


def beyond_limits(mission: str) -> Callable[..., float]:
    """Share of the flights that exceed a limit of a mission, %"""

    def share(results) -> float:
        over = [
            results[f"peak_{name}"].values > float(constraint.limit)
            for name, constraint in find_mission(mission).scenario().constraints.items()
            if constraint.limit is not None
        ]
        return 100.0 * float(np.mean(np.any(over, axis=0)))

    return share


CROSSINGS = {
    "x-33": (
        "tracking",
        "state-drag-tracking",
        "observer-drag-tracking",
        "modulation",
        "shuttle",
        "feedback-linearization",
    ),
    "rlv": (
        "bank-alone",
        "state-drag-tracking",
        "observer-drag-tracking",
        "pseudospectral",
        "pseudospectral-with-range",
        "feedback-linearization",
    ),
}
"""The laws that fly beside the mission's own one, which is the first for the X-33"""

_LOST = Column("lost, %", "outcome", 1.0, lambda codes: 100.0 * np.mean(codes != 0))
_DRAG = (
    Column("drag deviation, median, g", "peak_drag_deviation", 1.0, np.median),
    Column("drag deviation, maximum, g", "peak_drag_deviation", 1.0, np.max),
)

MORE = {
    **{
        ("cav-h", choice): (
            *_END,
            Column("heat rate, maximum, MW/m2", "peak_heat_rate", 1e6, np.max),
            Column("load factor, maximum", "peak_load_factor", 1.0, np.max),
        )
        for choice in ("predictor-corrector", "neural")
    },
    ("mars-aerocapture", "predictor-corrector world random-air"): (
        Column("velocity increment, median, m/s", _INCREMENT, 1.0, np.median),
        Column(
            "velocity increment, 95th percentile, m/s", _INCREMENT, 1.0, percentile(95)
        ),
    ),
    **{("x-33", choice): (_LOST,) for choice in CROSSINGS["x-33"]},
    **{
        ("rlv", choice): (_LOST, *_DRAG) for choice in ("modulation", *CROSSINGS["rlv"])
    },
}
"""Columns of one flight of a mission beside those of its mission"""

_OF_AN_ORBIT = {
    "velocity increment, std, m/s": deviation(_INCREMENT, 1.0),
    "apoapsis error, mean, km": mean(_APOAPSIS, km),
    "apoapsis error, std, km": deviation(_APOAPSIS),
    "lost, %": lost,
}

OTHERS = {
    "mars-aerocapture": {
        **_OF_AN_ORBIT,
        "inclination error, mean, deg": mean(_INCLINATION, degree),
        "inclination error, std, deg": deviation(_INCLINATION, degree),
    },
    "neptune-aerocapture": _OF_AN_ORBIT,
    "cav-h": {
        "velocity error, std, m/s": lambda results: float(
            np.std(results[VELOCITY].values, ddof=1)
        ),
        "lost, %": lost,
    },
    "mars-range-tracking": {
        "downrange std, km": deviation(DOWNRANGE),
        "crossrange std": deviation(CROSSRANGE),
        "altitude std": deviation("altitude_error"),
    },
    "sx-2": {"lost, %": lost},
    "x-33": {
        f"{name}, maximum, share of the limit": share_of_limit(name)
        for name in ("heat_rate", "normal_load_factor")
    },
    "rlv": {"downrange std, km": deviation(DOWNRANGE)},
    "apollo-10": {"lost, %": lost},
    "cav-h-glide": {
        "miss over ground, median, km": over_ground(np.median),
        "miss over ground, 99th percentile, km": over_ground(percentile(99)),
        "miss over ground, maximum, km": over_ground(np.max),
        "lost, %": lost,
        "beyond a limit, %": beyond_limits("cav-h-glide"),
    },
    "msl": {
        "ellipse of 99 %, length, km": axis_of_ellipse(0),
        "ellipse of 99 %, width, km": axis_of_ellipse(1),
        "miss over ground, maximum, km": over_ground(np.max),
        "lost, %": lost,
    },
    "mars-drag-tracking": {
        value.name: value.statistic
        for value in find_mission("mars-drag-tracking").published
    },
}

ROWS = {
    "cav-h": (
        ("stored", "normal"),
        ("model-inversion", "normal"),
        ("adjusted-once", "normal"),
        ("network-once", "normal"),
        ("state-network-once", "normal"),
        ("adjusted-at-epochs", "normal"),
        ("newton", "normal"),
        ("newton", "uniform"),
        ("newton", "normal-sensed"),
        ("newton-network", "normal-sensed"),
        ("newton", "waves-sensed"),
        ("learning", "waves-sensed"),
        ("learning-correlated", "waves-sensed"),
        ("learning", "normal-sensed"),
        ("learning-correlated", "normal-sensed"),
        ("newton world us-1976", "normal-sensed"),
        ("predictor-corrector", "normal-sensed"),
        ("predictor-corrector", "uniform-sensed"),
        ("predictor-corrector", "waves-sensed"),
        ("neural", "normal-sensed"),
        ("neural", "waves-sensed"),
    ),
    "mars-range-tracking": (
        ("range-tracking", "lift-to-drag-held"),
        ("range-tracking", "independent"),
        ("predictor-corrector", "lift-to-drag-held"),
        ("predictor-corrector", "independent"),
        ("predictor-corrector world in-plane", "independent"),
        ("predictor-corrector-network world in-plane", "independent"),
        ("predictor-corrector-network", "independent"),
        ("terminal-point", "lift-to-drag-held"),
        ("terminal-point", "independent"),
        ("range-tracking world hard-air", "hard-air-without-noise"),
        ("predictor-corrector world hard-air", "hard-air"),
        ("neural world hard-air", "hard-air"),
        ("neural world hard-air", "hard-air-wider"),
        ("predictor-corrector world hard-air", "hard-air-wider"),
        *(
            (f"{law} world fitted-air world hard-air", "hard-air-without-scale-height")
            for law in ("predictor-corrector", "neural")
        ),
        ("predictor-corrector world aided world hard-air", "hard-air-and-knowledge"),
        ("neural world aided world hard-air", "hard-air-and-knowledge"),
        ("range-tracking world inertial", "lift-to-drag-held-and-knowledge"),
        ("predictor-corrector world inertial", "lift-to-drag-held-and-knowledge"),
        ("range-tracking world aided", "lift-to-drag-held-and-knowledge"),
        ("predictor-corrector world aided", "lift-to-drag-held-and-knowledge"),
    ),
    "sx-2": (
        *(
            (choice, dispersions)
            for dispersions in ("initial-errors", "air-and-vehicle")
            for choice in ("full", "predictor-corrector")
        ),
        ("predictor-corrector world inertial", "everything-and-knowledge"),
        ("predictor-corrector world aided", "everything-and-knowledge"),
    ),
    "x-33": tuple(
        (choice, dispersions)
        for dispersions in ("initial-errors", "air-and-vehicle")
        for choice in (
            "with-range",
            "predictor-corrector",
            "predictor-corrector-limited",
            "predictor-corrector world three-dimensional",
            *CROSSINGS["x-33"],
        )
    ),
    "rlv": (
        *(
            (choice, "table-1")
            for choice in ("modulation", "predictor-corrector", *CROSSINGS["rlv"])
        ),
        ("predictor-corrector world inertial", "table-1-and-knowledge"),
        ("predictor-corrector world aided", "table-1-and-knowledge"),
    ),
    "apollo-10": (
        ("predictor-corrector", "everything"),
        ("predictor-corrector", "entry-errors"),
        ("predictor-corrector", "air-and-vehicle"),
        ("predictor-corrector case skip", "everything"),
        ("unlimited", "everything"),
        ("predictor-corrector world us-1976", "everything"),
        ("predictor-corrector world inertial", "everything-and-knowledge"),
        ("predictor-corrector world aided", "everything-and-knowledge"),
        ("apollo", "everything"),
        ("apollo-steered", "everything"),
        ("apollo case skip", "everything"),
        ("apollo-steered case skip", "everything"),
        ("apollo world us-1976", "everything"),
        ("neural", "everything"),
    ),
    "cav-h-glide": (
        ("predictor-corrector", "everything"),
        ("predictor-corrector", "entry-errors"),
        ("predictor-corrector", "air-and-vehicle"),
        ("two-ended", "everything"),
        ("undamped", "everything"),
        ("undamped-unlimited", "everything"),
        ("predictor-corrector world at-rest", "everything"),
        ("predictor-corrector world us-1976", "everything"),
        ("predictor-corrector world inertial", "everything-and-knowledge"),
        ("predictor-corrector world aided", "everything-and-knowledge"),
    ),
    "msl": (
        ("terminal-point", "everything"),
        ("terminal-point", "entry-errors"),
        ("terminal-point", "air-and-vehicle"),
        ("terminal-point world wind-and-waves", "wind"),
        ("terminal-point world wind-and-waves", "waves"),
        ("terminal-point world wind-and-waves", "everything-with-wind"),
        ("terminal-point world inertial", "knowledge"),
        ("terminal-point world inertial", "everything-and-knowledge"),
        (
            "terminal-point world wind-and-waves world inertial",
            "everything-with-wind-and-knowledge",
        ),
        (
            "terminal-point world wind-and-waves world inertial world range-trigger",
            "everything-with-wind-and-knowledge",
        ),
        ("terminal-point world fitted-air", "everything"),
        ("predictor-corrector", "everything"),
    ),
    "mars-aerocapture": (
        ("predictor-corrector", "everything"),
        ("predictor-corrector world random-air", "random-air"),
    ),
    "neptune-aerocapture": (("predictor-corrector", "everything"),),
    "mars-drag-tracking": tuple(
        (choice, "lift-to-drag-held")
        for choice in (
            "table-3",
            "energy-index",
            "state-feedback",
            "observer-feedback",
            "pseudospectral",
            "pseudospectral-with-range",
        )
    ),
}

HARD_AIR = {
    **{
        f"miss over ground, {name}, km": over_ground(statistic)
        for name, statistic in (
            ("median", np.median),
            ("95th percentile", percentile(95)),
            ("99.9th percentile", percentile(99.9)),
            ("maximum", np.max),
        )
    },
    "velocity at the end, median, m/s": end_velocity(np.median),
    "velocity at the end, 95th percentile, m/s": end_velocity(percentile(95)),
}
"""Headings of flights in hard air beside those of their mission"""


def beyond_training(results) -> float:
    """Share of the flights of a neural law with a decision beyond its training, %"""
    shares = results["decisions_beyond_training"].values
    return 100.0 * float(np.mean(shares > 0.0))


BEYOND = {
    ("apollo-10", "predictor-corrector"),
    ("apollo-10", "apollo"),
    ("apollo-10", "apollo-steered"),
    ("apollo-10", "neural"),
    ("cav-h", "neural"),
}
"""What has the share of its flights beyond a limit beside the statistics of its mission"""

RUNS = {
    "cav-h": 500,
    "mars-range-tracking": 1000,
    "mars-drag-tracking": 1000,
    "sx-2": 100,
    "x-33": 50,
    "rlv": 25,
    "apollo-10": 50,
    "cav-h-glide": 50,
    "msl": 100,
    "mars-aerocapture": 100,
    "neptune-aerocapture": 100,
}
"""In a set"""

OTHER_RUNS = {
    ("cav-h", "predictor-corrector"): 50,
    ("apollo-10", "neural"): 625,
    ("msl", "predictor-corrector"): 25,
}
"""In a set of a law that takes longer, or of one that is fast"""


def runs_of(mission: str, choice: str) -> int:
    """Runs in a set."""
    return OTHER_RUNS.get((mission, choice), RUNS[mission])


SAVED = Path(__file__).with_suffix(".csv")


class Statistic(NamedTuple):
    """One statistic, as it is saved."""

    first_runs: float
    """Its value for the first runs of the first set"""
    sets: np.ndarray
    """Its value for each set, shape (sets,)"""
    date: str
    """Day on which the sets were flown, YYYY-MM-DD"""


def save(mission: str, rows: dict[tuple[str, str, str], Statistic]) -> None:
    """Put statistics of a mission into the file, each in a row."""
    flown = {(mission, *row[:2]) for row in rows}
    kept = []
    if SAVED.exists():
        with open(SAVED, newline="") as file:
            kept = [row for row in csv.reader(file) if tuple(row[:3]) not in flown]
    kept += [
        [mission, *row, found.date]
        + [f"{x:.9g}" for x in (found.first_runs, *found.sets)]
        for row, found in rows.items()
    ]
    with open(SAVED, "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(kept)


def statistics_of(mission: str, choice: str) -> dict[str, Callable[..., float]]:
    """By heading; each takes the results of a set."""
    columns = COLUMNS[mission] + MORE.get((mission, choice), ())
    others = dict(HARD_AIR) if "hard-air" in choice else {}
    if "hard-air" in choice and choice.startswith("neural"):
        others["beyond the ranges of the training, %"] = beyond_training
    if (mission, choice) in BEYOND:
        others["beyond a limit, %"] = beyond_limits(mission)
    return {c.heading: c.of for c in columns} | OTHERS[mission] | others


def statistics() -> dict[tuple[str, ...], Statistic]:
    """All that was saved: by mission, what is flown of it, dispersions and heading."""
    found = {}
    with open(SAVED, newline="") as file:
        for row in csv.reader(file):
            name = tuple(row[:4])
            if name in found:
                raise ValueError(
                    f"{SAVED.name} has two rows {', '.join(name)}: keep the later one"
                )
            found[name] = Statistic(float(row[5]), np.array(row[6:], float), row[4])
    return found


def saved() -> dict[tuple[str, ...], np.ndarray]:
    """Of each set: by mission, what is flown of it, dispersions and heading."""
    return {row: found.sets for row, found in statistics().items()}


def first_runs_of(results):
    """The finite flights among the first runs of a campaign."""
    (first,) = sets_of(results.isel(run=slice(FIRST_RUNS)), FIRST_RUNS)
    return first


def flown(mission: str, choice: str, dispersions: str, runs: int, seed: int, out: Path):
    """The stored campaign, of which what is missing is flown."""
    chosen = find_mission(mission)
    folder = out / f"{mission}-{Choice.of(choice).folder}-{dispersions}-{seed}"
    labels = {"mission": mission, **Choice.of(choice).labels}
    table = chosen.dispersion_table(dispersions)
    run_campaign(folder, chosen.scenario_of(choice), table, seed, runs, **labels)
    return open_campaign(folder, runs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mission", choices=ROWS)
    parser.add_argument(
        "--only",
        nargs="*",
        help="what is flown, such as `newton world us-1976`; all if not given",
    )
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/populations"))
    parser.add_argument("--save", action="store_true", help=f"to {SAVED.name}")
    options = parser.parse_args()
    if options.save and (options.sets != SETS or options.seed != 0):
        parser.error("--save is for 16 sets of seed 0")
    jentry.setup()
    mission = options.mission
    print(f"{mission}: {options.sets} sets, seed {options.seed}; mean over the sets")
    print("± standard deviation of a set; of maxima also median, largest")
    rows, headings, today = {}, None, datetime.date.today().isoformat()
    for choice, dispersions in ROWS[mission]:
        if options.only and choice not in options.only:
            continue
        size = runs_of(mission, choice)
        runs = options.sets * size
        results = flown(mission, choice, dispersions, runs, options.seed, options.out)
        cells = {}
        first, sets = first_runs_of(results), sets_of(results, size)
        for heading, statistic in statistics_of(mission, choice).items():
            ours = population(statistic, sets)
            found = Statistic(float(statistic(first)), ours.values, today)
            rows[choice, dispersions, heading] = found
            cells[heading] = f"{ours.mean:.3g} ± {ours.spread:.2g}"
            if "maximum" in heading:
                middle, largest = np.median(ours.values), np.max(ours.values)
                cells[heading] += f"; {middle:.3g}, {largest:.3g}"
        cells["reached"] = str(np.sum(results["outcome"].values == Outcome.REACHED))
        cells["left out"] = str(runs - finite_flights(results).sizes["run"])
        told = {"flown": choice, "dispersions": dispersions, "runs": str(size)} | cells
        if told.keys() != headings:
            headings = told.keys()
            print("| " + " | ".join(headings) + " |")
            print("|" + "---|" * len(headings))
        print("| " + " | ".join(told.values()) + " |", flush=True)
    if options.save:
        save(mission, rows)


if __name__ == "__main__":
    main()
