"""What do a Latin hypercube and a Sobol sequence save, against plain draws?

Flies many campaigns of 256 runs, each of another seed, by each sampler, and takes the mean
and the 99th percentile of each campaign. Printed is their standard deviation from campaign
to campaign for plain draws, and by how much the variance is less with each sampler: as
many times more plain runs would do the same. Behind ± is one standard error.

    python benchmarks/sampling.py mars-drag-tracking
    python benchmarks/sampling.py sx-2

`sampling.csv` beside this file has each statistic of each campaign: `--save` writes it
again. The page `docs/how/batches.md` takes its table from it.
"""

import argparse
import csv
import datetime
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

import jentry
from jentry.campaign import AbstractSampler, LatinHypercube, Sobol
from jentry.campaign.campaign import drawn_inputs
from jentry.campaign.populations import finite_flights
from jentry.missions import find_mission
from jentry.units import km


CAMPAIGNS = 256
RUNS = 256

SAMPLERS: dict[str, AbstractSampler | None] = {
    "plain": None,
    "latin-hypercube": LatinHypercube(RUNS),
    "sobol": Sobol(),
}

READINGS = {"mars-drag-tracking": "lift-to-drag-held", "sx-2": "initial-errors"}


class Output(NamedTuple):
    """What statistics are taken of."""

    heading: str
    variable: str
    size: float
    """SI units in the unit that is shown"""


OUTPUTS = (
    Output("downrange error, magnitude, km", "downrange_error", km),
    Output("peak heat rate, kW/m2", "peak_heat_rate", 1e3),
)

STATISTICS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mean": lambda values: np.mean(values, axis=1),
    "99th percentile": lambda values: np.percentile(values, 99.0, axis=1),
}

SAVED = Path(__file__).with_suffix(".csv")

Rows = dict[tuple[str, str, str, str], np.ndarray]
"""By mission, output, statistic and sampler: the statistic of each campaign"""


def flown(mission: str, campaigns: int) -> Rows:
    """The statistics of all campaigns, the seeds of the samplers among them others."""
    chosen = find_mission(mission)
    scenario = chosen.scenario()
    table = chosen.dispersion_table(READINGS[mission])
    rows: Rows = {}
    for place, (name, sampler) in enumerate(SAMPLERS.items()):
        keys = map(jax.random.key, range(place * campaigns, (place + 1) * campaigns))
        runs = np.arange(RUNS)
        drawn = [drawn_inputs(scenario, table, key, runs, sampler) for key in keys]
        inputs = {a: np.concatenate([each[a] for each in drawn]) for a in drawn[0]}
        results = jentry.monte_carlo(scenario, inputs=inputs).to_xarray(scenario)
        left_out = results.sizes["run"] - finite_flights(results).sizes["run"]
        if left_out:
            raise RuntimeError(
                f"{left_out} flights have no end: choose other dispersions"
            )
        for output in OUTPUTS:
            values = np.abs(results[output.variable].values) / output.size
            for heading, statistic in STATISTICS.items():
                row = mission, output.heading, heading, name
                rows[row] = statistic(values.reshape(campaigns, RUNS))
    return rows


def variance(values: np.ndarray) -> tuple[float, float]:
    """Variance of many values, and its standard error in shares of it.

    That of normal values would be the root of 2 / (n - 1); where there are outliers it is
    larger, by their fourth moment.
    """
    n, away = len(values), values - np.mean(values)
    found = float(np.var(values, ddof=1))
    tails = float(np.mean(away**4)) / found**2
    return found, float(np.sqrt((tails - (n - 3) / (n - 1)) / n))


def saving(plain: np.ndarray, spread: np.ndarray) -> tuple[float, float]:
    """Variance of plain draws over that of a sampler, and its standard error."""
    (one, error), (other, more) = variance(plain), variance(spread)
    return one / other, one / other * float(np.hypot(error, more))


def save(rows: Rows) -> None:
    """Put the statistics of a mission into the file, each with its campaigns in a row."""
    missions = {row[0] for row in rows}
    kept = {row: x for row, x in saved().items() if row[0] not in missions}
    dates = {
        mission: date for mission, date in saved_on().items() if mission not in missions
    }
    with open(SAVED, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row, values in (kept | rows).items():
            date = dates.get(row[0], datetime.date.today().isoformat())
            writer.writerow([*row, date, *(f"{value:.12g}" for value in values)])


def saved() -> Rows:
    """All that was saved."""
    if not SAVED.exists():
        return {}
    with open(SAVED, newline="") as file:
        return {
            (row[0], row[1], row[2], row[3]): np.array(row[5:], float)
            for row in csv.reader(file)
        }


def saved_on() -> dict[str, str]:
    """Day on which the campaigns of each mission were flown, YYYY-MM-DD."""
    if not SAVED.exists():
        return {}
    with open(SAVED, newline="") as file:
        return {row[0]: row[4] for row in csv.reader(file)}


def with_error(value: float, error: float) -> str:
    """A number with its error, both to the second digit of that."""
    place = int(np.floor(np.log10(error))) - 1
    number, off = (f"{round(x, -place):_.{max(-place, 0)}f}" for x in (value, error))
    return f"{number} ± {off}".replace("_", " ")


def table_of(mission: str, rows: Rows) -> list[list[str]]:
    """Cells of the table of a mission."""
    table = []
    for row, plain in rows.items():
        if row[0] != mission or row[3] != "plain":
            continue
        deviation = float(np.std(plain, ddof=1))
        cells = [*row[1:3], with_error(float(np.mean(plain)), deviation)]
        for name in SAMPLERS:
            if name != "plain":
                spread = rows[mission, row[1], row[2], name]
                cells.append(with_error(*saving(plain, spread)))
        table.append(cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mission", choices=READINGS)
    parser.add_argument("--campaigns", type=int, default=CAMPAIGNS)
    parser.add_argument("--save", action="store_true", help=f"to {SAVED.name}")
    options = parser.parse_args()
    if options.save and options.campaigns != CAMPAIGNS:
        parser.error(f"--save is for {CAMPAIGNS} campaigns")
    jentry.setup()
    print(f"{options.mission}: {options.campaigns} campaigns of {RUNS} runs")
    samplers = [name for name in SAMPLERS if name != "plain"]
    headings = ["output", "statistic", "plain: mean ± spread", *samplers]
    print("| " + " | ".join(headings) + " |")
    print("|" + "---|" * len(headings))
    rows = flown(options.mission, options.campaigns)
    for cells in table_of(options.mission, rows):
        print("| " + " | ".join(cells) + " |")
    if options.save:
        save(rows)


if __name__ == "__main__":
    main()
