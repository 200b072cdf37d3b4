"""How does the Shuttle's cross-range come out by exact derivatives, and by search without?

Prints the latitude at the end by `jentry.optimize`, from several cold starts, and beside it
CMA-ES and Nelder-Mead with ten times the seconds, on the same 80 unknowns, with what the
end is off added to the objective. Search flies batches, compiled, from the first start.

    python benchmarks/cross_range.py --case limited-heating
"""

import argparse
import dataclasses
import time
import warnings

import cmaes
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

import jentry
from jentry.addresses import addresses_of, replace_leaves
from jentry.missions.shuttle.mission import cross_range
from jentry.missions.shuttle.scenario import END_ALTITUDE, END_PATH_ANGLE
from jentry.planning.flight_problem import FreeControl, best_flight
from jentry.units import deg, foot


STARTS = ((20, -45), (17, -60), (30, -45), (40, -30), (10, -45), (15, 0), (45, -80))
"""Angle of attack and bank at which the controls begin, deg"""

WEIGHT = 3.0
"""deg of latitude for the square of each 1000 ft that the altitude is off, of each degree
that the path is, and of each per cent of the heat rate above its limit"""

POPULATION = 64


def problem(angle_of_attack: float, bank: float):
    return dataclasses.replace(
        cross_range(),
        bank=FreeControl(bank * deg, -89.0 * deg, 1.0 * deg),
        angle_of_attack=FreeControl(angle_of_attack * deg, -90.0 * deg, 90.0 * deg),
    )


class Search:
    """The same flights, as a function of numbers between 0 and 1, with penalties."""

    def __init__(self, scenario):
        start = jentry.free_controls(scenario, -45.0 * deg, 20.0 * deg)
        addresses = addresses_of(start, jentry.control_coefficients)
        self.limit = scenario.constraints["wing_heat_rate"].limit

        def ends(numbers):
            angle, bank = jnp.split(numbers, 2)
            values = dict(
                zip(
                    addresses,
                    ((-89.0 + 90.0 * bank) * deg, (-90.0 + 180.0 * angle) * deg),
                    strict=True,
                )
            )
            flight = jentry.fly(replace_leaves(start, values))
            end = flight.state
            return jnp.stack(
                [
                    end.latitude / deg,
                    (end.altitude - END_ALTITUDE) / foot,
                    (end.flight_path_angle - END_PATH_ANGLE) / deg,
                    flight.peaks["wing_heat_rate"],
                ]
            )

        self._ends = eqx.filter_jit(jax.vmap(ends))
        self.first = np.concatenate([np.full(40, 110 / 180), np.full(40, 44 / 90)])
        self.flights = 0

    def ends(self, numbers: np.ndarray) -> np.ndarray:
        self.flights += len(numbers)
        return np.asarray(self._ends(jnp.asarray(np.clip(numbers, 0.0, 1.0))))

    def cost(self, numbers: np.ndarray) -> np.ndarray:
        latitude, altitude, path, heat = self.ends(numbers).T
        cost = -latitude + WEIGHT * ((altitude / 1e3) ** 2 + path**2)
        if self.limit is not None:
            above = np.maximum(heat / float(self.limit) - 1.0, 0.0)
            cost += WEIGHT * (100.0 * above) ** 2
        outside = np.sum(np.abs(numbers - np.clip(numbers, 0.0, 1.0)), axis=1)
        return np.where(np.isfinite(cost), cost, 1e6) + WEIGHT * outside


def by_cmaes(
    search: Search, seconds: float, seed: int, first_step: float
) -> np.ndarray:
    optimizer = cmaes.CMA(
        mean=search.first, sigma=first_step, seed=seed, population_size=POPULATION
    )
    best, least, end = search.first, np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        asked = [optimizer.ask() for _ in range(POPULATION)]
        costs = search.cost(np.array(asked))
        optimizer.tell(list(zip(asked, costs, strict=True)))
        if np.min(costs) < least:
            least, best = np.min(costs), asked[int(np.argmin(costs))]
    return best


def by_nelder_mead(search: Search, seconds: float) -> np.ndarray:
    best, least, end = search.first, np.inf, time.perf_counter() + seconds

    def cost(numbers):
        nonlocal best, least
        if time.perf_counter() > end:
            raise StopIteration
        here = float(search.cost(numbers[None])[0])
        if here < least:
            best, least = numbers.copy(), here
        return here

    try:
        scipy.optimize.minimize(
            cost,
            search.first,
            method="Nelder-Mead",
            options={"maxfev": 10**9, "maxiter": 10**9, "adaptive": True},
        )
    except StopIteration:
        pass
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", choices=["limited-heating"])
    parser.add_argument("--times", type=float, default=10.0)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-step", type=float, default=0.02)
    options = parser.parse_args()
    jentry.setup(workers=1)
    warnings.simplefilter("ignore", jentry.ResultWarning)
    scenario = jentry.find_mission("shuttle").scenario(case=options.case)
    taken = []
    for angle, bank in STARTS:
        begin = time.perf_counter()
        try:
            best = best_flight(scenario, problem(angle, bank))
        except ValueError as error:
            print(f"start {angle}, {bank}: {error}")
            continue
        taken.append(time.perf_counter() - begin)
        end = best.flight.state
        print(
            f"start {angle:3d}, {bank:4d}: {end.latitude / deg:.5f} deg at "
            f"{best.flight.time:.2f} s, off by {(end.altitude - END_ALTITUDE) / foot:.1e} "
            f"ft and {(end.flight_path_angle - END_PATH_ANGLE) / deg:.1e} deg; "
            f"{best.flights} flights with derivatives, {taken[-1]:.1f} s",
            flush=True,
        )
    print(f"optimize: median {np.median(taken):.1f} s, the first compiles")
    seconds = options.times * float(np.median(taken))
    runs = [("CMA-ES", seed) for seed in range(options.seeds)] + [("Nelder-Mead", None)]
    for name, seed in runs:
        search = Search(scenario)
        search.cost(np.tile(search.first, (POPULATION if seed is not None else 1, 1)))
        search.flights = 0
        found = (
            by_nelder_mead(search, seconds)
            if seed is None
            else by_cmaes(search, seconds, seed, options.first_step)
        )
        flights = search.flights
        latitude, altitude, path, heat = search.ends(found[None])[0]
        print(
            f"{name}: {latitude:.4f} deg, off by {altitude:.0f} ft and {path:.3f} deg, "
            f"heat rate {heat / 1e4:.2f} W/cm2; {flights} flights, {seconds:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
