"""What it is worth to know the wind: Apollo 10 in random winds, by what its law believes.

    python benchmarks/wind.py --save

Sets of one seed each, whose draws are the same in every row: what the mission disperses,
and a wind towards east and north with a standard deviation of 20 m/s and a correlation
length of 10 km. The law takes the air to be still, or knows the wind, or learns it from
flow sensors with errors: by the direction of the flow alone, or by its speed as well.

The flight ends at 15 km. Farther down the capsule falls so steeply that a head wind takes
it through the vertical, where the state has no heading: predictions end there, and flights.

`wind.csv` beside this file has each set. The page of the mission has its table from it.
"""

import argparse
import csv
import dataclasses
import datetime
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jentry
from jentry.campaign import (
    Dispersion,
    Normal,
    Uniform,
    monte_carlo,
    replace,
)
from jentry.missions import find_mission
from jentry.onboard import FlowSensors, WindEstimator, WindPrior
from jentry.units import degree, km
from jentry.world import RandomAltitudeProfile, RandomWind, StillAir


RUNS, SEEDS = 32, tuple(range(1, 9))
END = 15.0 * km
DEVIATION, LENGTH, CEILING = 20.0, 10.0 * km, 80.0 * km
"""m/s, m and m"""
ANGLE, SHARE = 0.5 * degree, 0.02
"""Three standard deviations of each lasting error and of the noise; one in the estimate,
which takes them all for noise"""
SAVED = Path(__file__).with_suffix(".csv")
COLUMNS = (
    "miss, median, km",
    "99th percentile",
    "maximum",
    "downrange error, median, km",
    "crossrange error, median, km",
    "without an end",
    "decisions without prediction, %",
)


def gusts() -> RandomWind:
    profile = RandomAltitudeProfile(LENGTH, 0.0, CEILING, nodes=21)
    return RandomWind(StillAir(), profile, profile, DEVIATION)


def nominal() -> jentry.Scenario:
    """The mission down to 15 km, in still air."""
    return eqx.tree_at(
        lambda s: (
            s.guidance.end.altitude,
            s.termination.conditions["altitude"].altitude,
            s.target.altitude,
        ),
        find_mission("apollo-10").scenario(),
        3 * (jnp.asarray(END),),
    )


def still_air():
    return nominal(), find_mission("apollo-10").dispersions["everything"]()


def blown():
    """The law knows nothing of the wind."""
    scenario, dispersions = still_air()
    planet = dataclasses.replace(scenario.planet, wind=gusts())
    winds = {
        "east wind": Dispersion(lambda s: s.planet.wind.east.seed, Uniform(0, 1)),
        "north wind": Dispersion(lambda s: s.planet.wind.north.seed, Uniform(0, 1)),
    }
    return dataclasses.replace(scenario, planet=planet), dispersions | winds


def known():
    """The model of the law has the wind that blows."""
    scenario, dispersions = blown()
    law = scenario.guidance
    planet = dataclasses.replace(law.model.planet, wind=gusts())
    model = dataclasses.replace(law.model, planet=planet)
    winds = {
        "east wind": Dispersion(
            lambda s: (
                s.planet.wind.east.seed,
                s.guidance.model.planet.wind.east.seed,
            ),
            Uniform(0, 1),
        ),
        "north wind": Dispersion(
            lambda s: (
                s.planet.wind.north.seed,
                s.guidance.model.planet.wind.north.seed,
            ),
            Uniform(0, 1),
        ),
    }
    believing = dataclasses.replace(law, model=model)
    return dataclasses.replace(scenario, guidance=believing), dispersions | winds


def learnt(speed: bool):
    scenario, dispersions = blown()
    prior = WindPrior(DEVIATION, LENGTH)
    estimator = WindEstimator(prior, ANGLE, SHARE if speed else None)
    law = dataclasses.replace(scenario.guidance, wind=estimator)
    sensors = FlowSensors(noise=ANGLE / 3)
    angle = Normal(0.0, ANGLE / 3)
    errors = {
        "flow speed": Dispersion(
            lambda s: s.flow_sensors.speed_scale_error, Normal(0.0, SHARE / 3), replace
        ),
        "flow side": Dispersion(lambda s: s.flow_sensors.side_error, angle, replace),
        "flow rise": Dispersion(lambda s: s.flow_sensors.rise_error, angle, replace),
        "flow noise": Dispersion(lambda s: s.flow_sensors.noise_seed, Uniform(0, 1)),
    }
    sensing = dataclasses.replace(scenario, guidance=law, flow_sensors=sensors)
    return sensing, dispersions | errors


def learnt_perfectly():
    """From flow sensors without errors that sense all the way."""
    scenario, dispersions = blown()
    estimator = WindEstimator(WindPrior(DEVIATION, LENGTH), 1e-4, 1e-4)
    law = dataclasses.replace(scenario.guidance, wind=estimator)
    sensors = FlowSensors(largest_mach=100.0, least_dynamic_pressure=0.0)
    sensing = dataclasses.replace(scenario, guidance=law, flow_sensors=sensors)
    return sensing, dispersions


ROWS = {
    "still air": still_air,
    "not known": blown,
    "by the direction of the flow": lambda: learnt(speed=False),
    "by its speed too": lambda: learnt(speed=True),
    "by perfect sensors": learnt_perfectly,
    "known": known,
}


def flown(scenario, dispersions, seed: int) -> list[float]:
    campaign = monte_carlo(scenario, dispersions, jax.random.key(seed), RUNS)
    flights, misses = campaign.flights, campaign.misses
    ended = np.asarray(flights.outcome) == jentry.Outcome.REACHED
    miss, down, across = (
        np.abs(np.asarray(x))[ended] / km
        for x in (misses.distance, misses.downrange, misses.crossrange)
    )
    blind = np.asarray(flights.caveats["decisions_without_prediction"])
    return [
        float(np.median(miss)),
        float(np.percentile(miss, 99)),
        float(np.max(miss)),
        float(np.median(down)),
        float(np.median(across)),
        float(np.sum(~ended)),
        100.0 * float(np.mean(blind)),
    ]


def saved() -> dict[str, np.ndarray]:
    """Values of the sets by row, shape (sets, columns)."""
    with SAVED.open() as file:
        lines = [line for line in csv.reader(file)][1:]
    return {
        row: np.array([line[3:] for line in lines if line[0] == row], float)
        for row in dict.fromkeys(line[0] for line in lines)
    }


def saved_on() -> str:
    """Day on which the sets were flown, YYYY-MM-DD."""
    with SAVED.open() as file:
        return next(line[2] for line in list(csv.reader(file))[1:])


def table_of(values: np.ndarray) -> list[float]:
    """Of a row of the table: means over the sets, the largest maximum, and all that are
    without an end."""
    means = np.mean(values, axis=0)
    together = {2: np.max, 5: np.sum}
    return [
        float(together[i](values[:, i]) if i in together else mean)
        for i, mean in enumerate(means)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="to wind.csv")
    arguments = parser.parse_args()
    jentry.setup()
    found, today = [], datetime.date.today().isoformat()
    for name, made in ROWS.items():
        scenario, dispersions = made()
        sets = [flown(scenario, dispersions, seed) for seed in SEEDS]
        found += [
            [name, seed, today, *map(repr, one)]
            for seed, one in zip(SEEDS, sets, strict=True)
        ]
        print(
            f"{name:30}", *(f"{x:9.3f}" for x in table_of(np.array(sets))), flush=True
        )
    if arguments.save:
        with SAVED.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(
                [["row", "seed", "date", *COLUMNS], *found]
            )


if __name__ == "__main__":
    main()
